//! Fits (and keeps where they hold on other objects) the maps of the probability of several contacts of a model that was trained before there were any, on sweeps over its held-out objects
//! (SIMULATED), and writes them into its card: what `wcal train` does at its end. With sweeps over its unseen objects the maps are judged there.
//!
//! `cargo run --release -p wcal-track --example several_maps MODEL SWEEPS [UNSEEN]`
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use std::path::Path;
use wcal_track::model_file::load;
use wcal_track::sweep_series::read_sweep_series;
use wcal_track::train_model::several_maps;
use wcal_track::two_contacts::reliability::{PlattMap, Reliability, several_calls};
use wcal_track::{Device, SweepSeries, Tracker};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let (Some(model), Some(sweeps)) = (words.next(), words.next()) else {
        return Err("expected MODEL and SWEEPS".into());
    };
    let (tracker, card) = load(Path::new(&model), &Device::flex())?;
    let held_out = series(&sweeps, &card.objects.held_out)?;
    let kept = several_maps(&tracker, &held_out);
    if kept.is_none() {
        println!(
            "no map is better than the network's own probability on objects that were not in its fit: none is written"
        );
    }
    // What was fitted is judged all the same.
    let fitted = |known: bool| PlattMap::fitted(&several_calls(&tracker, held_out.iter(), known));
    let maps = kept.unwrap_or([fitted(false).unwrap_or_default(), fitted(true).unwrap_or_default()]);
    judge("held-out objects", &tracker, &held_out, &maps)?;
    if let Some(unseen) = words.next() {
        judge("unseen objects", &tracker, &series(&unseen, &card.objects.unseen)?, &maps)?;
    }
    let Some(maps) = kept else { return Ok(()) };
    // The rest of the card stays as it is written, old names too.
    let path = Path::new(&model).join("model.json");
    let mut document: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path)?)?;
    document["several_maps"] = serde_json::to_value(maps)?;
    std::fs::write(&path, serde_json::to_string_pretty(&document)?)?;
    Ok(())
}

fn series(folder: &str, objects: &[String]) -> Result<Vec<SweepSeries>, Box<dyn std::error::Error>> {
    Ok(read_sweep_series(Path::new(folder), objects)?.into_values().flatten().collect())
}

/// Prints how far the probabilities can be trusted without and with the maps.
fn judge(
    objects: &str,
    tracker: &Tracker,
    all: &[SweepSeries],
    maps: &[PlattMap; 2],
) -> Result<(), Box<dyn std::error::Error>> {
    println!("SIMULATED: {} sweeps over {objects}", all.len());
    for (k, (name, map)) in ["base's speed not known", "known"].into_iter().zip(maps).enumerate() {
        let calls = several_calls(tracker, all.iter(), k == 1);
        let of = |map: &PlattMap| Reliability::of(&calls, map).ok_or("no sample with contact");
        let (before, after) = (of(&PlattMap::default())?, of(map)?);
        println!(
            "{name}: slope {:.3}, offset {:.3}; {} samples, {:.1} % several; Brier {:.4} -> {:.4} (base rate {:.4}), calibration error {:.3} -> {:.3}",
            map.slope,
            map.offset,
            before.samples,
            100.0 * before.share,
            before.brier,
            after.brier,
            before.brier_base_rate,
            before.expected_calibration_error,
            after.expected_calibration_error
        );
        for b in &after.bins {
            println!(
                "  stated {:.1} to {:.1}: {:.3}, observed {:.3} of {}",
                b.from, b.to, b.stated, b.observed, b.samples
            );
        }
    }
    Ok(())
}
