//! The scheme's order, mesh independence, and rest shapes given as polylines.

use crate::elastica::elastica_errors;
use crate::{LENGTH_MM, bent, spec, straight};
use nalgebra::Vector3;
use wcal_core::observation::RestShape;
use wcal_rod::{Guess, Line, Rod, Tangential};

const STEPS_MM: [f64; 4] = [6.0, 3.0, 1.5, 0.75];

#[test]
fn fourth_order_on_the_elastica() {
    let errors: Vec<f64> = STEPS_MM
        .iter()
        .map(|&h| elastica_errors(&straight(h), 60_f64.to_radians(), 0.4).1)
        .collect();
    for (j, pair) in errors.windows(2).enumerate() {
        let order = (pair[0] / pair[1]).log2();
        println!(
            "step {} -> {} mm: {:.2e} -> {:.2e}, order {order:.2}",
            STEPS_MM[j],
            STEPS_MM[j + 1],
            pair[0],
            pair[1]
        );
        assert!(
            (3.6..4.6).contains(&order),
            "order {order} between steps {j} and {}",
            j + 1
        );
    }
}

/// Base moment of a bent wire held out of its plane at a fixed arc length: exercises torsion and
/// the mesh break.
fn held_out_of_plane(rod: &Rod) -> Vector3<f64> {
    let s = 54.0;
    let rest = rod.shape.rest_point(s);
    let mut guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: s,
    };
    for k in 1..=12 {
        let point = rest + Vector3::new(-6.0, 9.0, 4.0) * (f64::from(k) / 12.0);
        guess = Guess::from(&rod.solve(&point, &guess, Tangential::Stick(s)).unwrap());
    }
    (rest + Vector3::new(-6.0, 9.0, 4.0)).cross(&guess.force_n)
}

#[test]
fn fourth_order_in_space_by_richardson() {
    // rest_point interpolates between nodes: s = 54 mm is a node of every mesh here, so the rest
    // wire is exact there.
    let moments: Vec<_> = STEPS_MM
        .iter()
        .map(|&h| held_out_of_plane(&bent(h)))
        .collect();
    let jumps: Vec<f64> = moments.windows(2).map(|w| (w[1] - w[0]).norm()).collect();
    for pair in jumps.windows(2) {
        let order = (pair[0] / pair[1]).log2();
        println!(
            "successive differences {:.2e}, {:.2e} N mm: order {order:.2}",
            pair[0], pair[1]
        );
        assert!((3.5..4.7).contains(&order), "order {order}");
    }
}

#[test]
fn meshes_agree_along_a_trajectory() {
    let xs: Vec<f64> = (1..=20).map(|k| 0.8 * f64::from(k)).collect();
    let moments = |h: f64| -> Vec<Vector3<f64>> {
        let rod = bent(h);
        let line = Line {
            origin_mm: bent(0.25).shape.rest_point(31.0),
            direction: Vector3::new(0.0, 0.6, 0.8),
        };
        let out = rod.follow(&line, &xs);
        out.iter()
            .map(|o| o.equilibrium().expect("held").moment_nmm)
            .collect()
    };
    let fine = moments(0.25);
    for (h, bound_nmm) in [(4.0, 1e-4), (2.0, 6e-6), (1.0, 5e-7)] {
        let worst = moments(h)
            .iter()
            .zip(&fine)
            .map(|(a, b)| (a - b).norm())
            .fold(0.0, f64::max);
        println!("step {h} mm: largest moment difference from 0.25 mm {worst:.1e} N mm");
        assert!(worst < bound_nmm, "step {h}: {worst:e}");
    }
}

/// The straight-and-arc wire sampled at `count` equal arc lengths.
fn sampled(count: usize) -> RestShape {
    let (straight_mm, radius) = (30.0, 20.0);
    let at = |s: f64| {
        let turn = (s - straight_mm).max(0.0) / radius;
        let x = s.min(straight_mm) + radius * turn.sin();
        Vector3::new(x, 0.0, -radius * (1.0 - turn.cos()))
    };
    RestShape::Polyline(
        (0..count)
            .map(|k| at(LENGTH_MM * k as f64 / (count - 1) as f64))
            .collect(),
    )
}

#[test]
fn polyline_converges_to_the_arc() {
    let line = Line {
        origin_mm: bent(0.5).shape.rest_point(40.0),
        direction: Vector3::new(0.0, 0.6, 0.8),
    };
    let moment = |rod: &Rod| {
        rod.follow(&line, &[4.0])[0]
            .equilibrium()
            .expect("held")
            .moment_nmm
    };
    let exact = moment(&bent(0.5));
    let errors: Vec<f64> = [31, 61, 121, 241]
        .iter()
        .map(|&n| {
            (moment(&Rod::new(&spec(sampled(n)), 0.5).unwrap()) - exact).norm() / exact.norm()
        })
        .collect();
    println!("polyline of 31, 61, 121, 241 points: relative moment errors {errors:?}");
    assert!(errors.windows(2).all(|w| w[1] < 0.45 * w[0]), "{errors:?}");
    // Second order in the chord: 0.25 mm chords of a 20 mm arc leave 1.3e-4.
    assert!(errors[3] < 2e-4);
}
