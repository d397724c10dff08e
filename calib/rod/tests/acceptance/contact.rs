//! Contact: statics at the base, reversibility, friction, the giving root, symmetry.

use crate::{bent, straight};
use nalgebra::{Rotation3, Vector3};
use wcal_rod::{Equilibrium, Guess, Line, Rod, Tangential};

const MU: f64 = 0.2;

fn line() -> Line {
    Line {
        origin_mm: bent(0.5).shape.rest_point(31.0),
        direction: Vector3::new(0.0, 0.6, 0.8),
    }
}

fn stations() -> Vec<f64> {
    (1..=24).map(|k| 0.5 * f64::from(k)).collect()
}

/// Solves along `xs` from `start`, each from its neighbour.
fn walk(
    rod: &Rod,
    xs: &[f64],
    start: &Guess,
    law: impl Fn(&Guess) -> Tangential,
) -> Vec<Equilibrium> {
    let mut guess = *start;
    let mut out = Vec::new();
    for &x in xs {
        let e = rod.solve(&line().point(x), &guess, law(&guess)).unwrap();
        guess = Guess::from(&e);
        out.push(e);
    }
    out
}

fn first_guess() -> Guess {
    Guess {
        force_n: Vector3::zeros(),
        arclength_mm: 31.0,
    }
}

#[test]
fn base_moment_is_position_times_force() {
    let rod = bent(2.0);
    for e in walk(&rod, &stations(), &first_guess(), |_| {
        Tangential::Frictionless
    }) {
        let nodes = rod.loaded_shape(&e);
        let j = nodes
            .iter()
            .position(|n| (n.0 - e.arclength_mm).abs() < 1e-9)
            .expect("contact is a node");
        let (position, frame) = (nodes[j].1, nodes[j].2);
        assert!((e.moment_nmm - position.cross(&e.force_n)).norm() < 1e-10);
        assert!(e.force_n.dot(&frame.column(0)).abs() < 1e-10 * e.force_n.norm().max(1e-3));
        let shifted = position + Vector3::new(0.0, 1e-6, 0.0);
        assert!(
            (e.moment_nmm - shifted.cross(&e.force_n)).norm() > 1e-10,
            "a point off by 1 nm went unseen"
        );
    }
}

#[test]
fn loading_equals_unloading_without_friction() {
    let rod = bent(2.0);
    let up = stations();
    let down: Vec<f64> = up.iter().rev().copied().collect();
    let loading = walk(&rod, &up, &first_guess(), |_| Tangential::Frictionless);
    let unloading = walk(&rod, &down, &Guess::from(loading.last().unwrap()), |_| {
        Tangential::Frictionless
    });
    let worst = loading
        .iter()
        .zip(unloading.iter().rev())
        .map(|(a, b)| (a.moment_nmm - b.moment_nmm).norm())
        .fold(0.0, f64::max);
    println!("frictionless loop: largest moment difference {worst:.1e} N mm");
    assert!(worst < 1e-9);
}

/// Share of the force along the wire: F.t / |F_perp|.
fn ratio(e: &Equilibrium) -> f64 {
    let along = e.force_n.dot(&e.tangent);
    along / (e.force_n - e.tangent * along).norm()
}

#[test]
fn friction_ratio_is_honoured_and_stick_remembers_the_path() {
    let rod = bent(2.0);
    let up = stations();
    // The groove drags the wire along its sliding: with ds_c/dx > 0 wire runs rootward through the
    // groove, so friction points to the tip.
    let free = walk(&rod, &up, &first_guess(), |_| Tangential::Frictionless);
    let sign = (free[1].arclength_mm - free[0].arclength_mm).signum();
    let loading = walk(&rod, &up, &first_guess(), |_| Tangential::Ratio(sign * MU));
    let worst = loading
        .iter()
        .map(|e| (ratio(e) - sign * MU).abs())
        .fold(0.0, f64::max);
    println!("friction ratio off by at most {worst:.1e}");
    assert!(worst < 1e-9);
    assert!(
        ratio(&free[10]).abs() < 1e-10,
        "frictionless contact carried a tangential force"
    );
    // The stick zone of this wire is about 0.01 mm of travel. A small way back the wire sticks:
    // inside the cone, the contact where it was, the moment not the loading one.
    let top = loading.last().unwrap();
    let back_mm = up[up.len() - 1] - 0.005;
    let stuck = rod
        .solve(
            &line().point(back_mm),
            &Guess::from(top),
            Tangential::Stick(top.arclength_mm),
        )
        .unwrap();
    let same_place = rod
        .solve(
            &line().point(back_mm),
            &Guess::from(top),
            Tangential::Ratio(sign * MU),
        )
        .unwrap();
    assert_eq!(stuck.arclength_mm, top.arclength_mm);
    assert!(
        ratio(&stuck).abs() < MU,
        "stick left the cone: {}",
        ratio(&stuck)
    );
    let split = (stuck.moment_nmm - same_place.moment_nmm).norm();
    println!("0.005 mm back from the top: stick and slip differ by {split:.1e} N mm");
    assert!(split > 1e-5);
    // Unloading with the friction reversed: the loop takes work, and none is taken without
    // friction.
    let down: Vec<f64> = up.iter().rev().copied().collect();
    let unloading = walk(&rod, &down, &Guess::from(top), |_| {
        Tangential::Ratio(-sign * MU)
    });
    let work = |path: &[Equilibrium]| -> f64 {
        path.windows(2)
            .map(|w| 0.5 * (w[0].force_n + w[1].force_n).dot(&(w[1].point_mm - w[0].point_mm)))
            .sum()
    };
    let lost = work(&loading) + work(&unloading);
    let kept = work(&free)
        + work(&walk(
            &rod,
            &down,
            &Guess::from(free.last().unwrap()),
            |_| Tangential::Frictionless,
        ));
    println!("work lost in the loop {lost:.3e} N mm with friction, {kept:.1e} without");
    assert!(lost > 1e-3 && kept.abs() < 1e-9);
}

const COMPLIANCE: f64 = 0.02;

fn held(rod: &Rod, point: &Vector3<f64>) -> Equilibrium {
    let guess = walk(&bent(2.0), &[1.0, 2.0, 3.0, 4.0], &first_guess(), |_| {
        Tangential::Frictionless
    })[3];
    rod.solve(point, &Guess::from(&guess), Tangential::Frictionless)
        .unwrap()
}

#[test]
fn giving_root_equals_a_turned_root() {
    let mut rod = bent(2.0);
    let point = line().point(4.0);
    let rigid = held(&rod, &point);
    rod.compliance_rad_per_nmm = COMPLIANCE;
    let soft = held(&rod, &point);
    let mut turned = bent(2.0);
    // The root turns about each base axis in proportion to the moment that it carries.
    let turn = soft.moment_nmm.component_mul(&rod.compliance_axes) * COMPLIANCE;
    turned.shape.root = Rotation3::new(turn).matrix() * rod.shape.root;
    let same = held(&turned, &point);
    assert!((same.moment_nmm - soft.moment_nmm).norm() < 1e-10);
    assert!(
        (rigid.moment_nmm - soft.moment_nmm).norm() > 1e-3,
        "compliance went unseen"
    );
}

#[test]
fn small_compliance_acts_as_the_derivative_says() {
    let point = line().point(4.0);
    let rod = bent(2.0);
    let rigid = held(&rod, &point);
    // Turning the root by theta is turning the groove back by theta, seen in turned axes.
    let h = 1e-4;
    let stiffness = |direction: Vector3<f64>| {
        (held(&rod, &(point + direction * h)).moment_nmm
            - held(&rod, &(point - direction * h)).moment_nmm)
            / (2.0 * h)
    };
    let theta = rigid.moment_nmm.component_mul(&rod.compliance_axes);
    let shift = -theta.cross(&point);
    let expected = theta.cross(&rigid.moment_nmm) + stiffness(shift.normalize()) * shift.norm();
    let with = |c: f64| {
        let mut soft = bent(2.0);
        soft.compliance_rad_per_nmm = c;
        held(&soft, &point).moment_nmm
    };
    let c = 1e-5;
    let derivative = (with(c) - with(-c)) / (2.0 * c);
    let error = (derivative - expected).norm() / expected.norm();
    println!("dm/dC: relative difference from the turned groove {error:.1e}");
    assert!(error < 1e-6);
    let one_axis = Vector3::new(0.0, rigid.moment_nmm.y, 0.0);
    assert!(
        (one_axis - theta).norm() > 1e-2,
        "the check would not see an axis left out"
    );
}

#[test]
fn turning_the_problem_about_a_straight_wire_turns_the_answer() {
    let rod = straight(2.0);
    let guess = Guess {
        force_n: Vector3::zeros(),
        arclength_mm: 40.0,
    };
    let solve = |angle: f64| {
        let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), angle);
        let mut guess = guess;
        for k in 1..=10 {
            let point = turn * Vector3::new(39.5, 0.8 * f64::from(k), 0.0);
            guess = Guess::from(&rod.solve(&point, &guess, Tangential::Frictionless).unwrap());
        }
        (turn.inverse() * guess.force_n, guess.arclength_mm)
    };
    let (force, s) = solve(0.0);
    for angle in [0.3, 1.2, 2.9, -2.0] {
        let (f, t) = solve(angle);
        assert!(
            (f - force).norm() < 1e-10 * force.norm() && (s - t).abs() < 1e-9,
            "{angle}"
        );
    }
    assert!(force.z.abs() < 1e-10 && force.y > 1e-2);
    // A wire bent in one plane has no such symmetry.
    let arc = bent(2.0);
    let push = |d: Vector3<f64>| {
        let p = arc.shape.rest_point(40.0) + d;
        let g = Guess {
            force_n: Vector3::zeros(),
            arclength_mm: 40.0,
        };
        arc.solve(&p, &g, Tangential::Frictionless)
            .unwrap()
            .moment_nmm
    };
    let (a, b, c) = (push(Vector3::y()), push(-Vector3::y()), push(Vector3::z()));
    assert!(
        (a - Vector3::new(-b.x, b.y, -b.z)).norm() < 1e-10,
        "mirror symmetry in y lost"
    );
    assert!(
        (a.norm() - c.norm()).abs() > 1e-3,
        "the negative control is blind"
    );
}
