//! Prints poses, base moments and the time of one solve as JSON for tests/peers/rod_peers.py.
//!
//! Each pose is solved from the equilibrium of the pose 0.3 mm before it, as a calibration sweep
//! does.

use nalgebra::Vector3;
use std::io::Write;
use std::time::Instant;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_rod::{Guess, Line, Rod, Tangential, WORKING_STEP_MM};

const STRAIGHT_MM: f64 = 30.0;
const RADIUS_MM: f64 = 20.0;
const LENGTH_MM: f64 = 60.0;
const FINE_STEP_MM: f64 = 0.125;
const APART_MM: f64 = 0.3;

fn triple(v: &Vector3<f64>) -> String {
    format!("[{:e}, {:e}, {:e}]", v.x, v.y, v.z)
}

/// Median time of a solve, us: the machine may be shared.
fn median_us(mut solve: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..301)
        .map(|_| {
            let start = Instant::now();
            solve();
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let spec = WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc {
            straight_mm: STRAIGHT_MM,
            arc_radius_mm: RADIUS_MM,
            length_mm: LENGTH_MM,
        },
        gravity_direction: None,
    };
    let (rod, fine) = (
        Rod::new(&spec, WORKING_STEP_MM)?,
        Rod::new(&spec, FINE_STEP_MM)?,
    );
    let mut poses = Vec::new();
    for (touch_mm, direction, depth_mm) in [
        (34.0, Vector3::new(0.0, 0.6, 0.8), 6.0),
        (38.0, Vector3::new(0.0, 1.0, 0.0), 8.0),
        (42.0, Vector3::new(0.0, -0.6, 0.8), 10.0),
        (46.0, Vector3::new(0.0, 0.0, 1.0), 12.0),
        (50.0, Vector3::new(-0.36, 0.48, 0.8), 12.0),
    ] {
        let line = Line {
            origin_mm: fine.shape.rest_point(touch_mm),
            direction,
        };
        let near = rod.follow(&line, &[depth_mm - APART_MM])[0];
        let near = near.equilibrium().ok_or("the neighbour pose is not held")?;
        let guess = Guess::from(near);
        let point = line.point(depth_mm);
        let solve = |rod: &Rod| {
            rod.solve(&point, &guess, Tangential::Frictionless)
                .map_err(|why| format!("{why:?} at {point}"))
        };
        let (found, exact) = (solve(&rod)?, solve(&fine)?);
        let time_us = median_us(|| {
            let _ = std::hint::black_box(rod.solve(
                std::hint::black_box(&point),
                &guess,
                Tangential::Frictionless,
            ));
        });
        poses.push(format!(
            "{{\"point_mm\": {}, \"neighbour_point_mm\": {}, \"neighbour_force_n\": {}, \"neighbour_arclength_mm\": {:e}, \
             \"moment_nmm\": {}, \"fine_moment_nmm\": {}, \"iterations\": {}, \"microseconds\": {:.3}}}",
            triple(&point),
            triple(&near.point_mm),
            triple(&near.force_n),
            near.arclength_mm,
            triple(&found.moment_nmm),
            triple(&exact.moment_nmm),
            found.iterations,
            time_us,
        ));
    }
    writeln!(
        std::io::stdout(),
        "{{\"straight_mm\": {STRAIGHT_MM}, \"radius_mm\": {RADIUS_MM}, \"length_mm\": {LENGTH_MM}, \"ei_nmm2\": {:e}, \
         \"gj_nmm2\": {:e}, \"step_mm\": {WORKING_STEP_MM}, \"fine_step_mm\": {FINE_STEP_MM}, \"poses\": [{}]}}",
        rod.section.ei_nmm2,
        rod.section.gj_nmm2,
        poses.join(", ")
    )?;
    Ok(())
}
