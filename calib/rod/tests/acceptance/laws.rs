//! Stiffness laws against quadrature of the small-deflection cantilever: taper, softening, weight.

use crate::{LENGTH_MM, spec, straight, straight_shape};
use nalgebra::Vector3;
use std::f64::consts::PI;
use wcal_rod::{Equilibrium, Guess, Rod, Softening, Tangential};

/// Tip deflection (mm) under the tip force `force_n` by Simpson's rule of the integral of kappa(s)
/// (L - s).
fn deflection_mm(force_n: f64, curvature: impl Fn(f64, f64) -> f64) -> f64 {
    let n = 3000;
    let h = LENGTH_MM / f64::from(n);
    let f = |s: f64| curvature(s, force_n * (LENGTH_MM - s)) * (LENGTH_MM - s);
    (0..n)
        .map(|i| {
            let s = f64::from(i) * h;
            h / 6.0 * (f(s) + 4.0 * f(s + 0.5 * h) + f(s + h))
        })
        .sum()
}

/// Transverse force that the rod needs at its tip for `deflection_mm`, shortening left free.
fn tip_force_n(rod: &Rod, deflection_mm: f64) -> f64 {
    let mut guess = Guess {
        force_n: Vector3::y() * (3.0 * rod.section.ei_nmm2 * deflection_mm / LENGTH_MM.powi(3)),
        arclength_mm: LENGTH_MM - 1e-3,
    };
    guess.arclength_mm -= 0.6 * deflection_mm.powi(2) / LENGTH_MM;
    // Frictionless contact at constant x: the arc length moves by a part in 1e6 only.
    let point = Vector3::new(guess.arclength_mm, deflection_mm, 0.0);
    rod.solve(&point, &guess, Tangential::Frictionless)
        .unwrap()
        .force_n
        .y
}

#[test]
fn taper_follows_the_fourth_power_of_the_diameter() {
    let force = 1e-6;
    for taper in [-0.3, 0.3] {
        let mut rod = straight(1.0);
        rod.section.taper = taper;
        let ei = rod.section.ei_nmm2;
        let end = (1.0_f64 + taper).powf(0.25);
        let exact = deflection_mm(force, |s, m| {
            m / (ei * (1.0 + (end - 1.0) * s / LENGTH_MM).powi(4))
        });
        // Contact 1 um short of the tip: that alone changes the force by 5e-5.
        let error = tip_force_n(&rod, exact) / force - 1.0;
        println!("taper {taper}: tip force off by {error:.1e}");
        assert!(error.abs() < 1e-4);
        rod.section.taper = 1.05 * taper;
        assert!(
            (tip_force_n(&rod, exact) / force - 1.0).abs() > 1e-3,
            "a taper off by 5 % went unseen"
        );
    }
}

/// Moment over EI times onset of a round section whose stress is flat past the onset strain: sum
/// over strips.
fn plateau_moment(x: f64) -> f64 {
    let n = 20_000;
    let h = 1.0 / f64::from(n);
    // y = sin(t) takes the square-root edge of the chord away.
    let sum: f64 = (0..n)
        .map(|i| {
            let t = 0.5 * PI * (f64::from(i) + 0.5) * h;
            let y = t.sin();
            (x * y).min(1.0) * y * t.cos().powi(2)
        })
        .sum();
    sum * h * 0.5 * PI * 16.0 / PI
}

#[test]
fn softening_laws_match_fibre_sums_and_quadrature() {
    let onset_per_m = 0.02;
    let ei = straight(1.0).section.ei_nmm2;
    let onset = onset_per_m * 1e-3;
    // Root moment 1.4 times onset: the outer 2/7 of the lever arm is past it.
    let force = 1.4 * ei * onset / LENGTH_MM;
    let hardening = 0.2;
    let invert = |y: f64| {
        let (mut low, mut high) = (1.0, 60.0);
        for _ in 0..50 {
            let x = 0.5 * (low + high);
            let m = (1.0 - hardening) * plateau_moment(x) + hardening * x;
            if m < y { low = x } else { high = x }
        }
        0.5 * (low + high)
    };
    // The fibre sum is slow: tabulated and interpolated.
    let knots: Vec<f64> = (0..=80)
        .map(|k| invert(1.0 + 0.4 * f64::from(k) / 80.0))
        .collect();
    let section_curvature = |_s: f64, m: f64| {
        let y = m / (ei * onset);
        if y <= 1.0 {
            return m / ei;
        }
        let position = ((y - 1.0) / 0.4 * 80.0).clamp(0.0, 79.999);
        let j = position as usize;
        onset * (knots[j] + (knots[j + 1] - knots[j]) * (position - j as f64))
    };
    let bilinear_curvature = |_s: f64, m: f64| {
        let y = m / (ei * onset);
        onset * if y <= 1.0 { y } else { 1.0 + (y - 1.0) / 0.3 }
    };
    let check = |name: &str, law: Softening, exact_mm: f64| {
        let mut rod = straight(0.5);
        rod.section.softening = Some(law);
        let error = tip_force_n(&rod, exact_mm) / force - 1.0;
        println!("{name}: tip force off by {error:.1e}");
        assert!(error.abs() < 2e-4, "{name}: {error:e}");
        rod.section.softening = None;
        assert!(
            (tip_force_n(&rod, exact_mm) / force - 1.0).abs() > 0.02,
            "{name}: softening went unseen"
        );
    };
    check(
        "bilinear",
        Softening::Bilinear {
            onset_per_m,
            ratio: 0.3,
        },
        deflection_mm(force, bilinear_curvature),
    );
    check(
        "section",
        Softening::Section {
            onset_per_m,
            hardening,
        },
        deflection_mm(force, section_curvature),
    );
}

/// The free wire in the form that `loaded_shape` takes.
fn free_wire() -> Equilibrium {
    Equilibrium {
        point_mm: Vector3::zeros(),
        force_n: Vector3::zeros(),
        arclength_mm: LENGTH_MM,
        tangent: Vector3::x(),
        moment_nmm: Vector3::zeros(),
        determinant: 1.0,
        iterations: 0,
    }
}

#[test]
fn own_weight_bends_the_cantilever_as_known() {
    let spec = spec(straight_shape());
    let rod = Rod::new(&spec, 1.0).unwrap().with_weight(&spec, 1.2);
    let area_m2 = PI * (0.3e-3_f64).powi(2) / 4.0;
    let w = (6450.0 - 1.2) * area_m2 * 9.806_65 * 1e-3;
    let moment = rod.rest_moment_nmm();
    // r x w with r along +x and w along -z turns about +y.
    let exact_moment = Vector3::y() * (0.5 * w * LENGTH_MM.powi(2));
    let sag = rod.loaded_shape(&free_wire()).last().unwrap().1.z;
    let exact_sag = -w * LENGTH_MM.powi(4) / (8.0 * rod.section.ei_nmm2);
    let (m, d) = (
        (moment - exact_moment).norm() / exact_moment.norm(),
        sag / exact_sag - 1.0,
    );
    println!(
        "weight: root moment {:.6} N mm off by {m:.1e}, sag {sag:.6} mm off by {d:.1e}",
        moment.y
    );
    assert!(m < 1e-5 && d.abs() < 1e-4);
    // The sag shortens the lever by 6.6e-6, and with the weight squared: the ratio is linear only
    // to that.
    let in_water = Rod::new(&spec, 1.0)
        .unwrap()
        .with_weight(&spec, 998.0)
        .rest_moment_nmm();
    assert!(((in_water.y / moment.y) - (6450.0 - 998.0) / (6450.0 - 1.2)).abs() < 1e-5);
    assert!(
        (in_water - exact_moment).norm() / exact_moment.norm() > 0.1,
        "buoyancy went unseen"
    );
}

#[test]
fn weight_and_contact_balance_at_the_base() {
    let spec = spec(crate::bent_shape());
    let rod = Rod::new(&spec, 1.0).unwrap().with_weight(&spec, 1.2);
    let bare = crate::bent(1.0);
    let point = rod.shape.rest_point(35.0) + Vector3::new(0.0, 1.0, 2.0);
    let guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: 35.0,
    };
    let held = rod.solve(&point, &guess, Tangential::Frictionless).unwrap();
    // Base moment = P x F + integral of r x w over the whole wire, by the trapezoid on the loaded
    // nodes.
    let nodes = rod.loaded_shape(&held);
    let weight: Vector3<f64> = nodes
        .windows(2)
        .map(|n| (n[0].1 + n[1].1).cross(&rod.weight_n_per_mm) * (0.5 * (n[1].0 - n[0].0)))
        .sum();
    let error = (held.moment_nmm - point.cross(&held.force_n) - weight).norm();
    let contact = nodes.iter().min_by(|a, b| {
        (a.0 - held.arclength_mm)
            .abs()
            .total_cmp(&(b.0 - held.arclength_mm).abs())
    });
    let gap = (contact.unwrap().1 - point).norm();
    println!("weight with contact: balance {error:.1e} N mm, contact off by {gap:.1e} mm");
    assert!(error < 1e-5 && gap < 1e-8);
    let without = bare
        .solve(&point, &guess, Tangential::Frictionless)
        .unwrap();
    assert!(
        (without.moment_nmm - held.moment_nmm).norm() > 1e-4,
        "weight went unseen"
    );
}
