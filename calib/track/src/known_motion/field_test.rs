//! The table of moments against the rod.

use super::*;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Line, Outcome};

fn rod() -> Rod {
    Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap()
}

/// Largest difference to the rod followed along lines, as a share of the moment.
fn largest_off(field: &MomentField, rod: &Rod) -> f64 {
    let mut largest: f64 = 0.0;
    for (s_mm, reach_mm) in [(14.0, 4.0), (24.0, 7.0), (38.0, 11.0), (57.0, 14.0)] {
        for turn in [0.0, -1.1, 0.7_f64] {
            let (origin_mm, tangent) = field.free(s_mm);
            let normal = Vector3::new(-tangent.z, 0.0, tangent.x);
            let line = Line {
                origin_mm,
                direction: normal * turn.cos() + Vector3::y() * turn.sin(),
            };
            let xs: Vec<f64> = (1..=9).map(|k| reach_mm * f64::from(k) / 9.0).collect();
            for (x, outcome) in xs.iter().zip(rod.follow(&line, &xs)) {
                let Outcome::Held(e) = outcome else { continue };
                let held = field.held(&line.point(*x), 0.0).unwrap();
                let m = MomentAxes::default().components_nmm(&e.moment_nmm);
                let off = (m[0] - held.moment_nmm[0]).hypot(m[1] - held.moment_nmm[1]);
                largest = largest.max(off / (m[0].hypot(m[1]) + 0.02));
                assert!(
                    (held.arclength_mm - e.arclength_mm).abs() < 0.02,
                    "{s_mm} {x}: {held:?}"
                );
            }
        }
    }
    largest
}

#[test]
fn the_table_is_the_rod() {
    let rod = rod();
    let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
    let off = largest_off(&field, &rod);
    assert!(off < 1e-3, "{off}");
    // Control: another wire is another table.
    let mut stiff = rod.clone();
    stiff.section.ei_nmm2 *= 1.01;
    assert!(largest_off(&field, &stiff) > 5e-3);
}

#[test]
fn the_rate_is_the_difference_of_neighbours() {
    let friction = Friction {
        coefficient: 0.2,
        moving_share: 1.0,
    };
    let field = MomentField::new(&rod(), &MomentAxes::default(), friction);
    let at = Vector3::new(33.3, -3.1, 2.4);
    for ratio in [-0.2, 0.0, 0.1] {
        let (held, rate) = field.held_and_rate(&at, ratio).unwrap();
        let plain = field.held(&at, ratio).unwrap();
        let off = |c: usize| (held.moment_nmm[c] - plain.moment_nmm[c]).abs();
        assert!(off(0) + off(1) + (held.arclength_mm - plain.arclength_mm).abs() < 1e-12);
        for k in 0..3 {
            let step = Vector3::from_fn(|i, _| if i == k { 1e-4 } else { 0.0 });
            let [a, b] = [at - step, at + step].map(|p| field.held(&p, ratio).unwrap().moment_nmm);
            for c in 0..2 {
                let expected = (b[c] - a[c]) / 2e-4;
                assert!(
                    (rate[(c, k)] - expected).abs() < 1e-6,
                    "{k} {c}: {rate} {expected}"
                );
            }
        }
    }
    // Control: elsewhere it is another.
    let [here, there] =
        [at, at + Vector3::x() * 3.0].map(|p| field.held_and_rate(&p, 0.0).unwrap().1);
    assert!((here - there).norm() > 1e-3);
}

#[test]
fn what_lies_beyond_the_tip_or_behind_the_root_holds_nothing() {
    let field = MomentField::new(&rod(), &MomentAxes::default(), Friction::NONE);
    let (tip, tangent) = field.free(60.0);
    assert!(field.held(&(tip - tangent * 0.5), 0.0).is_some());
    assert!(field.held(&(tip + tangent * 0.5), 0.0).is_none());
    assert!(field.held(&Vector3::new(-5.0, 0.0, 3.0), 0.0).is_none());
    assert!(
        field.held(&Vector3::new(2e4, 0.0, 4e4), 0.0).is_none(),
        "metres away"
    );
}

#[test]
fn friction_moves_the_contact_both_ways() {
    let friction = Friction {
        coefficient: 0.2,
        moving_share: 1.0,
    };
    let field = MomentField::new(&rod(), &MomentAxes::default(), friction);
    let at = Vector3::new(30.0, -4.0, 3.0);
    let [low, free, high] = [-0.2, 0.0, 0.2].map(|r| field.held(&at, r).unwrap().arclength_mm);
    assert!(
        (low - free) * (high - free) < 0.0 && (high - low).abs() > 1e-4,
        "{low} {free} {high}"
    );
}

#[test]
fn a_cubic_and_its_slope_are_exact() {
    let f = |x: f64| 0.3 * x.powi(3) - x * x + 2.0 * x - 1.0;
    let slope = |x: f64| 0.9 * x * x - 2.0 * x + 2.0;
    let nodes = [-1.0, 0.0, 1.0, 2.0].map(f);
    let sum = |weights: [f64; 4]| weights.iter().zip(nodes).map(|(w, f)| w * f).sum::<f64>();
    for u in [0.0, 0.3, 0.71, 1.0] {
        assert!(
            (sum(cubic(u)) - f(u)).abs() < 1e-12 && (sum(cubic_rate(u)) - slope(u)).abs() < 1e-12
        );
    }
    // Control: a quartic is not.
    let nodes = [-1.0, 0.0, 1.0, 2.0_f64].map(|x| x.powi(4));
    let off = cubic(0.3)
        .iter()
        .zip(nodes)
        .map(|(w, f)| w * f)
        .sum::<f64>()
        - 0.3_f64.powi(4);
    assert!(off.abs() > 0.1, "{off}");
}
