//! Scratch: verdict of the search on folders.
use wcal_core::SessionData;
use wcal_trace::candidate::System;
use wcal_trace::engine::{fit, search};
use wcal_trace::whisker::WhiskerSystem;
fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    for folder in args {
        let t0 = std::time::Instant::now();
        let truth = std::path::Path::new(&folder).parent().unwrap().join("truth.json");
        let name = std::path::Path::new(&folder).file_name().unwrap().to_string_lossy().to_string();
        let truth: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(truth).unwrap()).unwrap();
        let t = &truth[&name];
        let Ok(loaded) = wcal_session::load(std::path::Path::new(&folder)) else {
            println!("{name} load error {}", t["label"]);
            continue;
        };
        let SessionData::Whisker(data) = &loaded.data else { panic!() };
        let rows: Vec<_> = data.rows.iter().collect();
        let system = WhiskerSystem::new(data, &rows).expect("system");
        let Some(f) = search::search(&system, &fit::Weights::equal(rows.len()), &search::Options::default())
        else {
            println!("{name} none");
            continue;
        };
        let id = |h: &search::Hypothesis| {
            h.effects(Some(15)).iter().map(|&e| system.catalogue()[e].id()).collect::<Vec<_>>().join("+")
        };
        println!(
            "{name} {} {} d {} TRUE {} {} | best [{}] {:?} s {:.3}/{:.3} gate0 {:.1e} {:.1e} {:.1e} gate1 {:.1e} {:.1e} {:.1e} drv {:?} wins {} t {:.1}",
            t["design"],
            t["label"],
            t["projected_size_in_noises"],
            t["effects"],
            t["noise_pm"],
            id(&f.best),
            f.best.fit.terms.iter().map(|t| t.values.clone()).collect::<Vec<_>>(),
            f.base.fit.variance().sqrt(),
            f.best.fit.variance().sqrt(),
            f.first_gate.p_catalogue,
            f.first_gate.p_drivers,
            f.first_gate.p_serial,
            f.last_gate.p_catalogue,
            f.last_gate.p_drivers,
            f.last_gate.p_serial,
            f.last_gate.drivers.first().map(|d| (d.driver.clone(), d.shape)),
            f.driver_beats_catalogue,
            t0.elapsed().as_secs_f64()
        );
        for (k, e) in f.evidence.iter().take(4).enumerate() {
            println!(
                "      {k} {} {:?} gain {:.1} behind {:.1}",
                e.effects.join("+"),
                e.laws,
                e.gain,
                e.behind
            );
        }
    }
}
