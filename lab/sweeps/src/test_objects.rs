//! Built-in objects set aside for tests (2026-11-25): no setting, network or threshold may be
//! chosen by looking at results on them, and `wcal train` refuses them
//! (fixtures/test_objects/README.md). Other kinds of shape than those of [`crate::objects::NAMES`].

use crate::solids::{Parts, half_circle, prism_from, revolved, smooth};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Names of the objects set aside for tests; `--object all` has none of them.
pub const TEST_NAMES: [&str; 6] = [
    "capsule",
    "ellipsoid",
    "hourglass",
    "l-profile",
    "ridged-bar",
    "stepped-shaft",
];

/// Points and triangles; none for another name.
pub(crate) fn parts(name: &str) -> Option<Parts> {
    Some(match name {
        "capsule" => revolved(&capsule(22.0, 70.0)),
        "ellipsoid" => {
            let (points, triangles) = revolved(&half_circle(1.0, 64));
            let stretch = Vector3::new(42.0, 28.0, 34.0);
            (
                points.iter().map(|p| p.component_mul(&stretch)).collect(),
                triangles,
            )
        }
        "hourglass" => revolved(&smooth(&[
            [32.0, -60.0],
            [31.0, -48.0],
            [22.0, -22.0],
            [14.0, 0.0],
            [22.0, 22.0],
            [31.0, 48.0],
            [32.0, 60.0],
        ])),
        // Two flanges of 50 mm, 15 mm thick; the middle of the corner sees the whole outline.
        "l-profile" => prism_from(
            &[
                [-25.0, -25.0],
                [25.0, -25.0],
                [25.0, -10.0],
                [-10.0, -10.0],
                [-10.0, 25.0],
                [-25.0, 25.0],
            ],
            90.0,
            [-17.5, -17.5],
        ),
        "ridged-bar" => revolved(&ridged(24.0, 4.0, 20.0, 120.0)),
        "stepped-shaft" => revolved(&[
            [0.0, -70.0],
            [30.0, -70.0],
            [30.0, -35.0],
            [20.0, -35.0],
            [20.0, 15.0],
            [12.0, 15.0],
            [12.0, 70.0],
            [0.0, 70.0],
        ]),
        _ => return None,
    })
}

/// Profile of a cylinder between two half spheres.
fn capsule(radius_mm: f64, length_mm: f64) -> Vec<[f64; 2]> {
    let ends = half_circle(radius_mm, 48);
    let shifted = |z_mm: f64| move |p: &[f64; 2]| [p[0], p[1] + z_mm];
    let (below, above) = ends.split_at(ends.len() / 2 + 1);
    let mut profile: Vec<[f64; 2]> = below.iter().map(shifted(-length_mm / 2.0)).collect();
    // The equator belongs to both half spheres.
    profile.push([radius_mm, length_mm / 2.0]);
    profile.extend(above.iter().map(shifted(length_mm / 2.0)));
    profile
}

/// Profile of a bar whose radius goes up and down along it.
fn ridged(radius_mm: f64, height_mm: f64, pitch_mm: f64, length_mm: f64) -> Vec<[f64; 2]> {
    const STEP_MM: f64 = 1.0;
    let steps = (length_mm / STEP_MM).round() as usize;
    let at = |k: usize| {
        let z = length_mm * (k as f64 / steps as f64 - 0.5);
        [radius_mm + height_mm * (TAU * z / pitch_mm).cos(), z]
    };
    (0..=steps).map(at).collect()
}
