//! One sweep's MuJoCo model: `write_world FOLDER OUT.xml`; FOLDER keeps the convex parts. Used by tests/peers/mujoco_rate.py.

use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mujoco::convex::Convex;
use wcal_mujoco::mjcf::MjcfOptions;
use wcal_mujoco::{CableEngine, Sweep, SweepPlan, objects};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [folder, out] = &words[..] else { return Err("expected FOLDER OUT.xml".into()) };
    let whisker = WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 },
        gravity_direction: None,
    };
    let mesh = objects::built_in("star-bar")?;
    let parts = Convex::of(&mesh, folder.as_ref())?.corners();
    let engine = CableEngine::start(&whisker, &MjcfOptions::default())?;
    let sweep = (0..).find_map(|k| Sweep::draw(&mesh, &SweepPlan::default(), 1, k, engine.reach_mm()));
    std::fs::write(out, engine.world(&parts, &sweep.ok_or("no sweep")?)?)?;
    Ok(())
}
