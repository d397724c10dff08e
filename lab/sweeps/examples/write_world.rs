//! One sweep's MuJoCo model: `write_world FOLDER OUT.xml`; FOLDER keeps the convex parts. Used by
//! tests/peers/mujoco_rate.py.

use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::CableEngine;
use wcal_lab_sweeps::convex::Convex;
use wcal_lab_sweeps::{Sweep, SweepPlan, objects};
use wcal_mujoco::mjcf::MjcfOptions;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out] = &words[..] else {
        return Err("expected FOLDER OUT.xml".into());
    };
    let whisker = WhiskerSpec::nominal();
    let mesh = objects::built_in("star-bar")?;
    let parts = Convex::of(&mesh, folder.as_ref())?.corners();
    let engine = CableEngine::start(&whisker, &MjcfOptions::default())?;
    let sweep =
        (0..).find_map(|k| Sweep::draw(&mesh, &SweepPlan::default(), 1, k, engine.reach_mm()));
    std::fs::write(out, engine.world(&parts, &sweep.ok_or("no sweep")?)?)?;
    Ok(())
}
