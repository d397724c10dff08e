//! Scratch: trains.
use wcal_track::make::{Making, make_model};
use wcal_track::train::TrainSettings;
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let card: wcal_track::model_file::Card =
        serde_json::from_str(&std::fs::read_to_string(format!("{}/model.json", a[2]))?)?;
    let mut s = serde_json::to_value(TrainSettings::default())?;
    let over: serde_json::Value = serde_json::from_str(&a[4])?;
    for (k, v) in over.as_object().unwrap() {
        s[k] = v.clone();
    }
    let making = Making {
        sweeps: a[1].as_ref(),
        whisker: card.whisker,
        preset: "default",
        settings: serde_json::from_value(s)?,
        held_out: None,
        unseen: None,
        out: a[3].as_ref(),
    };
    let card = make_model(&making, &wcal_track::Device::flex(), |p| println!("{p:?}"))?;
    println!("{:?} {:?}", card.sd_factors, card.objects.unseen);
    Ok(())
}
