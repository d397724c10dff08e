//! MuJoCo's wire against the rod: `compare_engines FOLDER SWEEPS [DAMPING_S [ARMATURE_S2]]` prints
//! statics at 10 to 80 links and the difference on the same sweeps against the speed (SIMULATED);
//! FOLDER keeps the convex parts. Needs wcal-mujoco in its folder or in WCAL_MUJOCO.
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::convex::Convex;
use wcal_lab_sweeps::rod_comparison::ComparisonSum;
use wcal_lab_sweeps::rod_engine::LINKS;
use wcal_lab_sweeps::{CableEngine, RodEngine, Sweep, SweepPlan, objects};
use wcal_mujoco::MujocoEngine;
use wcal_mujoco::compare::statics;
use wcal_mujoco::mjcf::MjcfOptions;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [folder, sweeps, rest @ ..] = &words[..] else {
        return Err("expected FOLDER SWEEPS [DAMPING_S [ARMATURE_S2]]".into());
    };
    let whisker = WhiskerSpec::nominal();
    let mut options = MjcfOptions::default();
    if let Some(damping) = rest.first() {
        options.damping_s = damping.parse()?;
    }
    if let Some(armature) = rest.get(1) {
        options.armature_s2 = armature.parse()?;
    }
    let mut engine = MujocoEngine::start()?;
    println!(
        "MuJoCo {}; SIMULATED; damping {} s, armature {} s^2",
        engine.version, options.damping_s, options.armature_s2
    );
    println!("{:>6} {:>12} {:>12}", "links", "point", "base moment");
    for links in [10, 20, 40, 80] {
        let found = statics(
            &mut engine,
            &whisker,
            &MjcfOptions {
                links,
                ..options.clone()
            },
        )?;
        println!(
            "{links:>6} {:>11.4}% {:>11.4}%",
            found.point_error * 100.0,
            found.moment_error * 100.0
        );
    }
    let mut bodies = Vec::new();
    for name in ["ball", "can", "star-bar"] {
        let mesh = objects::built_in(name)?;
        let convex = Convex::of(&mesh, folder.as_ref())?;
        println!(
            "{name}: {} convex parts, {:.3} mm beyond the mesh, {:.3} mm short of it",
            convex.parts.len(),
            convex.beyond_mm,
            convex.short_mm
        );
        bodies.push((mesh, convex));
    }
    const SPEEDS_MM_S: [f64; 4] = [3.2, 5.0, 7.7, 14.0];
    let rod = RodEngine::new(&whisker, LINKS)?;
    let mut cable = CableEngine::start(&whisker, &options)?;
    let mut sum = ComparisonSum::new(SPEEDS_MM_S.map(|v| [v; 2]).to_vec());
    for speed in SPEEDS_MM_S {
        let plan = SweepPlan {
            speed_mm_s: [speed; 2],
            acceleration_mm_s2: 0.0,
            ..SweepPlan::default()
        };
        for (mesh, convex) in &bodies {
            for index in 0..sweeps.parse()? {
                let Some(sweep) = Sweep::draw(mesh, &plan, 1, index, rod.reach_mm()) else {
                    continue;
                };
                let quasi = rod.run(mesh, &sweep, &plan);
                let dynamic = cable.run(mesh, &convex.corners(), &sweep, &plan)?;
                sum.add(&dynamic, &quasi);
            }
        }
    }
    print!("{}", sum.table());
    Ok(())
}
