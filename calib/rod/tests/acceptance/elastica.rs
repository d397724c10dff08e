//! Exact solutions: the elastica under an end load, the circle under a pure moment.

use crate::elliptic::{complete_agm, first_kind, second_kind};
use crate::{LENGTH_MM, straight};
use nalgebra::{Rotation3, Vector3};
use wcal_rod::integrate::{Load, MomentTable, to_arclength};
use wcal_rod::se3::{Pose, rows_of};
use wcal_rod::{Guess, Rod, Tangential, WORKING_STEP_MM};

/// Cantilever under a dead transverse end load: tip (along, across) over L, and F L^2/EI, for a tip
/// slope `angle`. Bisshopp & Drucker, Quart. Appl. Math. 3 (1945) 272, eqs. 9-13.
pub(crate) fn end_loaded(angle: f64) -> (f64, f64, f64) {
    let p = (0.5 * (1.0 + angle.sin())).sqrt();
    let phi = (1.0 / (p * 2.0_f64.sqrt())).asin();
    let alpha = complete_agm(p) - first_kind(phi, p);
    let complete_e = second_kind(std::f64::consts::FRAC_PI_2, p);
    let across = 1.0 - 2.0 / alpha * (complete_e - second_kind(phi, p));
    ((2.0 * angle.sin()).sqrt() / alpha, across, alpha * alpha)
}

/// Relative error of force, and of the base moment, for a tip slope, in a plane turned about x.
pub(crate) fn elastica_errors(rod: &Rod, angle: f64, plane: f64) -> (f64, f64) {
    let (along, across, load) = end_loaded(angle);
    let up = Rotation3::from_axis_angle(&Vector3::x_axis(), plane) * Vector3::y();
    let point = (Vector3::x() * along + up * across) * LENGTH_MM;
    let exact = up * (load * rod.section.ei_nmm2 / LENGTH_MM.powi(2));
    // Walk from the small-deflection answer: Newton from far away may find another elastica.
    let mut guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: LENGTH_MM,
    };
    for k in 1..=40 {
        let (a, c, l) = end_loaded(angle * f64::from(k) / 40.0);
        let on_way = (Vector3::x() * a + up * c) * LENGTH_MM;
        guess.force_n = up * (l * rod.section.ei_nmm2 / LENGTH_MM.powi(2));
        guess = Guess::from(
            &rod.solve(&on_way, &guess, Tangential::Stick(LENGTH_MM))
                .unwrap(),
        );
    }
    let found = rod
        .solve(&point, &guess, Tangential::Stick(LENGTH_MM))
        .unwrap();
    let moment = point.cross(&exact);
    (
        (found.force_n - exact).norm() / exact.norm(),
        (found.moment_nmm - moment).norm() / moment.norm(),
    )
}

const ANGLES_DEG: [f64; 4] = [5.0, 30.0, 60.0, 80.0];

#[test]
fn end_loaded_cantilever_to_1e_8_under_refinement_and_1e_5_at_the_working_mesh() {
    for degrees in ANGLES_DEG {
        for (step_mm, bound) in [(WORKING_STEP_MM, 1e-5), (0.25, 1e-8)] {
            let (force, moment) =
                elastica_errors(&straight(step_mm), f64::to_radians(degrees), 0.4);
            println!(
                "tip slope {degrees} deg, step {step_mm} mm: force {force:.1e}, moment {moment:.1e}"
            );
            // An inextensible wire at 5 deg is 0.3 % shorter along its chord: the force follows
            // that small difference.
            let force_bound = if degrees < 10.0 { 10.0 * bound } else { bound };
            assert!(
                force < force_bound && moment < bound,
                "{degrees} deg, {step_mm} mm: {force:e} {moment:e}"
            );
        }
    }
}

#[test]
fn elastica_check_sees_a_stiffness_off_by_1e_6_and_a_point_off_by_10_um() {
    let mut rod = straight(0.25);
    let (along, across, load) = end_loaded(0.8);
    let point = Vector3::new(along, across, 0.0) * LENGTH_MM;
    let exact = Vector3::y() * (load * rod.section.ei_nmm2 / LENGTH_MM.powi(2));
    let guess = Guess {
        force_n: exact,
        arclength_mm: LENGTH_MM,
    };
    let error = |rod: &Rod, p: &Vector3<f64>| {
        let e = rod.solve(p, &guess, Tangential::Stick(LENGTH_MM)).unwrap();
        (e.force_n - exact).norm() / exact.norm()
    };
    assert!(error(&rod, &point) < 1e-8);
    assert!(error(&rod, &(point + Vector3::new(0.0, 0.01, 0.0))) > 1e-5);
    rod.section.ei_nmm2 *= 1.0 + 1e-6;
    assert!(error(&rod, &point) > 5e-7);
}

#[test]
fn pure_moment_gives_a_circle_to_rounding() {
    let rod = straight(2.0);
    let curvature = 0.05;
    let circle_error = |moment_nmm: f64| {
        let table = MomentTable {
            step_mm: LENGTH_MM,
            moments_nmm: vec![Vector3::new(0.0, 0.0, moment_nmm); 2],
        };
        let load = Load {
            point: [0.0; 3],
            force: [0.0; 3],
            distributed: Some(&table),
        };
        let root = Pose {
            frame: rows_of(&rod.shape.root),
            position: [0.0; 3],
        };
        let mut worst: f64 = 0.0;
        to_arclength(&rod.section, &rod.shape, root, &load, LENGTH_MM, |s, g| {
            let (sin, cos) = (curvature * s).sin_cos();
            let exact = Vector3::new(sin, 1.0 - cos, 0.0) / curvature;
            worst = worst.max((Vector3::from(g.position) - exact).norm() / LENGTH_MM);
        });
        worst
    };
    let exact_moment = rod.section.ei_nmm2 * curvature;
    let error = circle_error(exact_moment);
    println!(
        "circle of {:.2} rad: largest position error / L {error:.1e}",
        curvature * LENGTH_MM
    );
    assert!(error < 1e-12);
    assert!(circle_error(exact_moment * (1.0 + 1e-9)) > 1e-10);
}
