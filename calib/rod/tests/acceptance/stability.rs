//! Second variation: Euler's strut, positivity on ordinary poses, zero at a fold and at a branching point.

use crate::{LENGTH_MM, bent, straight};
use nalgebra::Vector3;
use std::f64::consts::PI;
use wcal_rod::{Equilibrium, Hold, Line, Outcome, Rod};

/// Straight strut pressed along its axis with `load` EI/L^2 at a tip that cannot move.
fn strut(rod: &Rod, load: f64) -> Equilibrium {
    Equilibrium {
        point_mm: Vector3::x() * LENGTH_MM,
        force_n: -Vector3::x() * (load * rod.section.ei_nmm2 / LENGTH_MM.powi(2)),
        arclength_mm: LENGTH_MM,
        tangent: Vector3::x(),
        moment_nmm: Vector3::zeros(),
        determinant: 1.0,
        iterations: 0,
    }
}

/// Load (in EI/L^2) at which the held strut loses stability.
fn critical_load(rod: &Rod) -> f64 {
    let (mut low, mut high) = (15.0, 25.0);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if rod.smallest_eigenvalue_as(&strut(rod, middle), Hold::Held) > 0.0 {
            low = middle
        } else {
            high = middle
        }
    }
    0.5 * (low + high)
}

#[test]
fn clamped_pinned_strut_buckles_at_eulers_load() {
    // First root of tan(x) = x, squared.
    let exact = 4.493_409_457_909_064_f64.powi(2);
    let found = critical_load(&straight(2.5));
    println!("critical load {found:.6} EI/L^2, exact {exact:.6}");
    assert!((found / exact - 1.0).abs() < 1e-5);
    let mut soft = straight(2.5);
    soft.section.ei_nmm2 *= 0.99;
    // In units of the nominal EI: one per cent less.
    let softer = critical_load(&soft) * 0.99;
    assert!(
        (softer / exact - 1.0).abs() > 5e-3,
        "a stiffness off by 1 % went unseen"
    );
}

#[test]
fn unloaded_strut_is_softest_in_torsion() {
    let rod = straight(2.5);
    let found = rod.smallest_eigenvalue_as(&strut(&rod, 0.0), Hold::Held);
    let exact = rod.section.gj_nmm2 * (0.5 * PI / LENGTH_MM).powi(2);
    assert!((found / exact - 1.0).abs() < 1e-6, "{found} {exact}");
}

#[test]
fn a_giving_root_buckles_earlier() {
    let mut rod = straight(2.5);
    rod.compliance_rad_per_nmm = 0.02;
    let soft = critical_load(&rod);
    // Pinned end, root spring k: tan(x) = x / (1 + x^2 EI/(k L)).
    let beta = rod.section.ei_nmm2 * rod.compliance_rad_per_nmm / LENGTH_MM;
    let f = |x: f64| x.sin() * (1.0 + beta * x * x) - x * x.cos();
    let (mut low, mut high) = (3.2_f64, 4.49_f64);
    for _ in 0..60 {
        let x = 0.5 * (low + high);
        if f(x) * f(low) > 0.0 {
            low = x
        } else {
            high = x
        }
    }
    println!(
        "root spring: critical load {soft:.6}, exact {:.6}",
        low * low
    );
    assert!((soft / (low * low) - 1.0).abs() < 1e-5);
}

#[test]
fn ordinary_poses_are_stable_on_every_mesh() {
    for (touch_mm, direction) in [
        (31.0, Vector3::new(0.0, 0.6, 0.8)),
        (36.0, Vector3::y()),
        (42.0, Vector3::new(0.0, -0.6, 0.8)),
    ] {
        let xs: Vec<f64> = (1..=8).map(f64::from).collect();
        let scan = |h: f64| {
            let rod = bent(h);
            let line = Line {
                origin_mm: bent(0.5).shape.rest_point(touch_mm),
                direction,
            };
            let held = |outcome: &Outcome| match outcome {
                Outcome::Held(e) => Some(rod.smallest_eigenvalue(e)),
                _ => None,
            };
            rod.follow(&line, &xs)
                .iter()
                .filter_map(held)
                .collect::<Vec<f64>>()
        };
        let (coarse, fine) = (scan(3.0), scan(1.5));
        assert_eq!((coarse.len(), fine.len()), (8, 8));
        for (a, b) in coarse.iter().zip(&fine) {
            assert!(*a > 0.0 && (a / b - 1.0).abs() < 2e-3, "{a:?} {b:?}");
        }
    }
}
