//! A whisker's MJCF and an equilibrium of the continuous rod to compare with:
//! `write_mjcf LINKS OUT.xml` prints JSON. Used by tests/peers/mujoco_statics.py.
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use nalgebra::Vector3;
use wcal_core::observation::WhiskerSpec;
use wcal_mujoco::mjcf::{MjcfOptions, mjcf};
use wcal_rod::{Guess, Rod, Tangential};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [links, out] = &words[..] else {
        return Err("expected LINKS OUT.xml".into());
    };
    let whisker = WhiskerSpec::nominal();
    let options = MjcfOptions {
        links: links.parse()?,
        ..MjcfOptions::default()
    };
    std::fs::write(out, mjcf(&whisker, &options)?)?;
    let rod = Rod::new(&whisker, 0.5)?;
    let s_mm = 40.0;
    let from = rod.shape.rest_point(s_mm);
    let mut guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: s_mm,
    };
    let mut held = None;
    for leg in 1..=10 {
        let point = from + Vector3::new(0.0, 3.0, 4.0) * (f64::from(leg) / 10.0);
        let found = rod
            .solve(&point, &guess, Tangential::Frictionless)
            .map_err(|e| format!("{e:?}"))?;
        guess = Guess::from(&found);
        held = Some(found);
    }
    let held = held.ok_or("no equilibrium")?;
    let rest = rod.shape.rest_point(held.arclength_mm);
    println!(
        "{{\"length_mm\":60.0,\"arclength_mm\":{},\"force_n\":{:?},\"point_mm\":{:?},\"rest_mm\":{:?},\"moment_nmm\":{:?}}}",
        held.arclength_mm,
        held.force_n.as_slice(),
        held.point_mm.as_slice(),
        rest.as_slice(),
        held.moment_nmm.as_slice()
    );
    Ok(())
}
