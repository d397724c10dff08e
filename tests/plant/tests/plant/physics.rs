//! The plant's wire against a closed solution, under refinement, and against the practice sessions'
//! truth.

use nalgebra::Vector3;
use std::sync::Arc;
use wcal_plant::bench::Bench;
use wcal_plant::friction::{Grip, friction_drags};
use wcal_plant::rod::Wire;
use wcal_plant::section::{MomentLaw, WireSection};
use wcal_plant::table::Table;

fn straight(elements: [usize; 2]) -> Wire {
    let mut wire = Wire::new(0.3, 60.0, 59.0, 20.0, 75.0, 28.0);
    wire.elements = elements;
    wire
}

/// Elastica with the force normal to the wire at the contact, by quadrature of
/// `EI b' = sqrt(2 F EI sin b)`: contact in the root's plane, and base moment, for an end turned by
/// `turn` rad under force `force`.
fn elastica(ei: f64, force: f64, turn: f64) -> ([f64; 2], f64) {
    let n = 20_000;
    let (mut along, mut across) = (0.0, 0.0);
    for i in 0..n {
        // b = t^2 takes the root singularity out.
        let t = turn.sqrt() * (f64::from(i) + 0.5) / f64::from(n);
        let b = t * t;
        let ds = 2.0 * t * (ei / (2.0 * force * b.sin())).sqrt() * turn.sqrt() / f64::from(n);
        along += b.cos() * ds;
        across += b.sin() * ds;
    }
    // From the contact's frame (tangent, normal) into the root's.
    let (c, s) = (turn.cos(), turn.sin());
    (
        [c * along + s * across, s * along - c * across],
        (2.0 * force * ei * s).sqrt(),
    )
}

#[test]
fn cantilever_agrees_with_the_elastica() {
    let wire = straight([60, 4]);
    for (force, turn) in [(0.1, 0.1_f64), (0.1, 0.4), (0.3, 0.8)] {
        let (at, moment) = elastica(wire.ei_nmm2, force, turn);
        let point = Vector3::new(at[0], 0.0, at[1]);
        let start = wire.touch(at[0], &Vector3::new(0.0, 0.0, 0.3 * at[1]));
        let mut e = start;
        for i in 1..=10 {
            let p = Vector3::new(at[0], 0.0, at[1] * f64::from(i) / 10.0);
            e = wire.solve(&p, 0.0, &e, &mut None).unwrap();
        }
        assert!((point.cross(&e.force_n) - e.moment_nmm).norm() < 1e-10);
        assert!(
            (e.force_n.norm() / force - 1.0).abs() < 1e-6,
            "{} {force}",
            e.force_n.norm()
        );
        assert!(
            (-e.moment_nmm.y / moment - 1.0).abs() < 1e-6,
            "{} {moment}",
            e.moment_nmm.y
        );
        // Negative control: a stiffer wire is found out.
        assert!((1.01 * e.force_n.norm() / force - 1.0).abs() > 1e-3);
    }
}

#[test]
fn extrapolated_scheme_is_fourth_order() {
    let moment = |elements: usize| {
        let mut wire = Wire::new(0.3, 60.0, 28.0, 20.0, 75.0, 28.0);
        wire.elements = [elements, elements];
        let (origin, tangent) = wire.rest(38.0);
        let push = Vector3::new(-tangent.z, 0.0, tangent.x) * 0.6 + Vector3::y() * 0.8;
        let mut e = wire.touch(38.0, &push);
        for i in 1..=8 {
            e = wire
                .solve(&(origin + push * f64::from(i)), 0.0, &e, &mut None)
                .unwrap();
        }
        e.moment_nmm
    };
    let (a, b, c, d) = (moment(4), moment(8), moment(16), moment(64));
    let (ea, eb, ec) = ((a - d).norm(), (b - d).norm(), (c - d).norm());
    assert!((12.0..22.0).contains(&(ea / eb)), "{ea} {eb} {ec}");
    assert!((10.0..24.0).contains(&(eb / ec)), "{ea} {eb} {ec}");
    // The working mesh has 9 and 7 elements.
    assert!(eb / d.norm() < 1e-5, "{}", eb / d.norm());
}

#[test]
fn tables_hold_one_part_in_a_hundred_thousand() {
    use rand::SeedableRng;
    let bench = Bench::draw(&mut rand_chacha::ChaCha8Rng::seed_from_u64(5));
    let wire = bench.wire();
    let mut fine = wire.clone();
    fine.elements = [36, 28];
    for t in bench
        .trajectories()
        .iter()
        .filter(|t| [1, 5, 9, 102, 106].contains(&t.id))
    {
        let table = Table::build(&wire, &t.path, t.reach_mm, &friction_drags(), 11).unwrap();
        for drag in [-0.37, 0.0, 0.21] {
            let exact = Table::build(&fine, &t.path, t.reach_mm, &[drag], 26).unwrap();
            let top = exact.at(t.reach_mm, drag);
            let top = top[0].hypot(top[1]);
            for i in 0..=40 {
                let x = t.reach_mm * f64::from(i) / 40.0;
                let (a, b) = (table.at(x, drag), exact.at(x, drag));
                let error = (a[0] - b[0]).hypot(a[1] - b[1]) / top;
                assert!(
                    error < 1e-5,
                    "trajectory {} stage {x} drag {drag}: {error:.1e}",
                    t.id
                );
            }
        }
    }
}

/// Rows copied from the practice sessions (simulated data, physics code of another hand): case,
/// trajectory, stage in mm, direction, true moments in N mm.
const PRACTICE: [(&str, usize, f64, i32, [f64; 2]); 28] = [
    ("case-003", 101, 4.648057, 1, [-0.546034, -0.25462]),
    ("case-003", 102, 4.918186, 1, [-0.055283, -0.631889]),
    ("case-003", 103, 5.562981, 1, [-0.580112, 0.406199]),
    ("case-003", 104, 8.755380, 1, [-0.376522, -0.15972]),
    ("case-003", 105, 9.293400, 1, [-0.05923, -0.427797]),
    ("case-003", 106, 8.756809, 1, [-0.344296, 0.21842]),
    ("case-004", 101, 3.737658, 1, [-0.557132, -0.259795]),
    ("case-004", 102, 5.268944, 1, [-0.073523, -0.840376]),
    ("case-004", 103, 4.827270, 1, [-0.638582, 0.44714]),
    ("case-004", 104, 7.781782, 1, [-0.444108, -0.170975]),
    ("case-004", 105, 6.820757, 1, [-0.063985, -0.403801]),
    ("case-004", 106, 7.450360, 1, [-0.392446, 0.226664]),
    ("case-007", 101, 5.813822, 1, [-0.763155, -0.355865]),
    ("case-007", 102, 3.005185, 1, [-0.039629, -0.452967]),
    ("case-007", 104, 7.771305, 1, [-0.405563, -0.16737]),
    ("case-007", 106, 8.605695, 1, [-0.407705, 0.249434]),
    ("case-008", 101, 4.991338, 1, [-0.586969, -0.273708]),
    ("case-008", 101, 4.230719, -1, [-0.497355, -0.231921]),
    ("case-008", 102, 5.619131, 1, [-0.062795, -0.717752]),
    ("case-008", 104, 8.638270, 1, [-0.373997, -0.157082]),
    ("case-008", 105, 7.954375, 1, [-0.050272, -0.375298]),
    ("case-008", 106, 4.308062, -1, [-0.178414, 0.114871]),
    ("case-011", 101, 4.723066, 1, [-0.580883, -0.248742]),
    ("case-011", 102, 3.728133, 1, [-0.072854, -0.479706]),
    ("case-011", 103, 4.879086, 1, [-0.542238, 0.367407]),
    ("case-011", 104, 6.231398, 1, [-0.291516, -0.113159]),
    ("case-011", 105, 9.234868, 1, [-0.078789, -0.421049]),
    ("case-011", 106, 9.907953, 1, [-0.40143, 0.234671]),
];

fn practice_errors(case: &str, effects: bool) -> f64 {
    use rand::SeedableRng;
    let mut bench = Bench::draw(&mut rand_chacha::ChaCha8Rng::seed_from_u64(1));
    (bench.straight_mm, bench.arc_radius_mm, bench.youngs_gpa) = match case {
        "case-003" => (32.0, 20.0, 60.0),
        "case-004" => (28.0, 18.0, 75.0),
        "case-007" => (30.0, 20.0, 75.0),
        "case-008" => (30.0, 22.0, 60.0),
        _ => (28.0, 22.0, 60.0),
    };
    bench.shear_gpa = bench.youngs_gpa / 2.66;
    let mut wire = bench.wire();
    let mut offset_mm = Vector3::zeros();
    let mut friction = 0.0;
    if effects {
        match case {
            "case-007" => wire.root_compliance = [0.02560939268661749; 2],
            "case-008" => friction = 0.17458044643838683,
            "case-011" => {
                offset_mm =
                    Vector3::new(0.018431133502527702, 0.06488728790552971, 0.229263670367781);
            }
            _ => {}
        }
    }
    let trajectories = bench.trajectories();
    let mut worst = 0.0_f64;
    for (_, id, stage, direction, truth) in PRACTICE.iter().filter(|p| p.0 == case) {
        let t = trajectories.iter().find(|t| t.id == *id).unwrap();
        let mut path = t.path;
        path.offset_mm = offset_mm;
        let drag = friction * f64::from(*direction);
        let m = Table::build(&wire, &path, t.reach_mm, &[drag], 12)
            .unwrap()
            .at(*stage, drag);
        worst = worst
            .max((m[0] - truth[0]).abs())
            .max((m[1] - truth[1]).abs());
    }
    worst
}

#[test]
fn moments_agree_with_the_practice_truth() {
    for case in ["case-003", "case-004", "case-007", "case-008", "case-011"] {
        let worst = practice_errors(case, true);
        assert!(worst < 1e-4, "{case}: {worst:.1e} N mm");
    }
    // Negative control: without its effect a session does not agree.
    for case in ["case-007", "case-008", "case-011"] {
        let worst = practice_errors(case, false);
        assert!(worst > 1e-3, "{case}: {worst:.1e} N mm");
    }
}

#[test]
fn friction_slides_both_ways_and_sticks_between() {
    let wire = Wire::new(0.3, 60.0, 30.0, 20.0, 75.0, 28.2);
    let (origin_mm, _) = wire.rest(18.0);
    let path = wcal_plant::table::Path {
        origin_mm,
        direction: Vector3::z(),
        arclength_mm: 18.0,
        offset_mm: Vector3::zeros(),
    };
    let table = Table::build(&wire, &path, 5.0, &friction_drags(), 12).unwrap();
    let mut grip = Grip::default();
    let mut last = 0.0;
    for i in 1..=100 {
        last = grip.step(&table, 0.04 * f64::from(i), 0.3).1;
    }
    assert_eq!(last, 0.3);
    // The stick zone after a reversal is narrow: the wire is far stiffer along itself than across.
    let mut width = 0.0;
    while grip.step(&table, 4.0 - width, 0.3).1 > -0.3 {
        width += 2e-5;
        assert!(width < 0.1);
    }
    println!("stick zone after a reversal at 4 mm: {:.2} um", 1e3 * width);
    assert!(width > 5e-5, "{width}");
    // Back and forth inside the cone, the state is as if nothing had been.
    let at = 4.0 - width;
    let (a, _) = grip.step(&table, at + 0.3 * width, 0.3);
    let (b, inside) = grip.step(&table, at + 0.1 * width, 0.3);
    let (c, _) = grip.step(&table, at + 0.3 * width, 0.3);
    assert!(inside.abs() < 0.3 && (a[0] - c[0]).abs() < 1e-9 && (a[0] - b[0]).abs() > 1e-7);
}

#[test]
fn softened_wire_carries_less_moment_but_never_beyond_the_plateau() {
    let mut wire = Wire::new(0.3, 60.0, 30.0, 20.0, 60.0, 22.6);
    let (origin_mm, _) = wire.rest(18.0);
    let path = wcal_plant::table::Path {
        origin_mm,
        direction: Vector3::z(),
        arclength_mm: 18.0,
        offset_mm: Vector3::zeros(),
    };
    let linear = Table::build(&wire, &path, 5.2, &[0.0], 12).unwrap();
    for law in [
        MomentLaw::Bilinear {
            onset_per_mm: 0.03,
            ratio: 0.6,
        },
        MomentLaw::Plateau { onset_per_mm: 0.03 },
    ] {
        wire.section = Some(Arc::new(WireSection {
            law,
            ..WireSection::default()
        }));
        let soft = Table::build(&wire, &path, 5.2, &[0.0], 20).unwrap();
        let onset = 0.03 * wire.ei_nmm2;
        for i in 1..=26 {
            let x = 0.2 * f64::from(i);
            let (m, full) = (-soft.at(x, 0.0)[0], -linear.at(x, 0.0)[0]);
            assert!(m < full + 1e-4 && m < 1.7 * onset, "{law:?} {x} {m} {full}");
            if full < 0.95 * onset {
                assert!((m - full).abs() < 2e-4, "{law:?} {x} {m} {full}");
            }
        }
        assert!(-soft.at(5.2, 0.0)[0] < -0.99 * linear.at(5.2, 0.0)[0]);
    }
}
