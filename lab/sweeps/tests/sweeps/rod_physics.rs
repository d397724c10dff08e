//! Friction, softening and distributed loads of the links: against the continuous rod, Coulomb's
//! law and integrals in closed form.

use super::discrete_contact::{Ball, rod};
use super::{LENGTH_MM, bent, spec, straight_shape};
use nalgebra::Vector3;
use wcal_lab_sweeps::contact::{Contact, ContactRod, ContactState, FrictionStep};
use wcal_rod::{Equilibrium, Guess, Rod, Section, Shape, Softening, Tangential, WORKING_STEP_MM};

/// Steps of the ball, each half a millimetre upward; further on a rough ball throws the wire aside.
const LAST: usize = 26;
/// The same for a ball nearer to the root, which touches later.
const DEEP: usize = 38;

/// A ball comes from below into the straight part, `y_mm` off the wire's plane, and goes `drag_mm`
/// along it toward the root.
fn rubbed(
    discrete: &ContactRod,
    coefficient: f64,
    [x_mm, y_mm]: [f64; 2],
    drag_mm: f64,
    steps: usize,
) -> Vec<ContactState> {
    let from = Vector3::new(x_mm + drag_mm / 2.0, y_mm, -18.0);
    let moved_mm = Vector3::new(-drag_mm, 0.0, 15.0) / 30.0;
    let (mut links, mut known) = (discrete.at_rest(), Vec::<Contact>::new());
    let mut all = Vec::new();
    for k in 0..=steps {
        let ball = Ball {
            centre_mm: from + moved_mm * k as f64,
            radius_mm: 5.0,
        };
        let how = FrictionStep {
            coefficient,
            before: &links,
            moved_mm,
        };
        let pressed = discrete.solve_frictional_contact(&ball, &known, &how, false, 60);
        assert!(pressed.converged, "step {k}: {:?}", pressed.contacts);
        (links, known) = (pressed.links.clone(), pressed.contacts.clone());
        all.push(pressed);
    }
    all
}

/// The continuous rod held where the links are held.
fn rod_at(pressed: &ContactState, rod: &Rod, tangential: Tangential) -> Equilibrium {
    let c = pressed.contacts[0];
    let guess = Guess {
        force_n: c.normal * c.force_n + c.friction_n,
        arclength_mm: c.arclength_mm,
    };
    rod.solve(&c.centre_mm, &guess, tangential).unwrap()
}

#[test]
fn a_sliding_contact_pulls_at_the_cones_edge_and_bends_the_rod_as_it_should() {
    let discrete = rod(40);
    let mu = 0.2;
    let before = rubbed(&discrete, mu, [42.0, 0.0], 10.0, LAST);
    let (last, earlier) = (&before[LAST], &before[LAST - 1]);
    let c = last.contacts[0];
    assert!(
        (c.friction_n.norm() - mu * c.force_n).abs() < 1e-3 * mu * c.force_n,
        "{c:?}"
    );
    assert!(c.friction_n.dot(&c.normal).abs() < 1e-9);
    // The contact wanders along the wire, and friction is against the wire's own way over the ball.
    let slid_mm = c.arclength_mm - earlier.contacts[0].arclength_mm;
    let tangent = last.links.frames[(c.arclength_mm / 1.5) as usize]
        .column(0)
        .into_owned();
    assert!(
        slid_mm.abs() > 0.02 && c.friction_n.dot(&tangent) * slid_mm > 0.0,
        "{slid_mm} {c:?}"
    );
    let ratio = c.friction_n.dot(&tangent).signum() * mu;
    let (moment, force) = (
        discrete.base_moment_nmm(last),
        c.normal * c.force_n + c.friction_n,
    );
    let off = |ratio: f64| {
        let rod = rod_at(last, &bent(1.0), Tangential::Ratio(ratio));
        (
            (moment - rod.moment_nmm).norm() / moment.norm(),
            (force - rod.force_n).norm() / force.norm(),
        )
    };
    let (of_moment, of_force) = off(ratio);
    assert!(
        of_moment < 6e-3 && of_force < 1e-2,
        "{of_moment} {of_force}"
    );
    // Negative control: without friction, or with it the other way, the rod needs another force.
    assert!(
        off(0.0).1 > 0.15 && off(-ratio).1 > 0.3,
        "{:?} {:?}",
        off(0.0),
        off(-ratio)
    );
}

/// A ball that first pulls the wire along and then lets it slide back: friction turns round, and on
/// the way the contact sticks.
#[test]
fn a_contact_sticks_while_friction_turns_round() {
    let discrete = rod(40);
    let mu = 0.4;
    let pressed = rubbed(&discrete, mu, [34.0, 0.0], 2.0, DEEP);
    let share = |p: &ContactState| {
        let c = p.contacts[0];
        let tangent = p.links.frames[(c.arclength_mm / discrete.link_mm) as usize]
            .column(0)
            .into_owned();
        c.friction_n.dot(&tangent) / (mu * c.force_n)
    };
    let touching: Vec<&ContactState> = pressed
        .iter()
        .filter(|p| !p.contacts.is_empty())
        .skip(1)
        .collect();
    let shares: Vec<f64> = touching.iter().map(|p| share(p)).collect();
    println!("friction over its limit along the wire: {shares:.2?}");
    assert!(
        shares.iter().all(|x| x.abs() < 1.0 + 1e-6),
        "never outside the cone"
    );
    assert!(
        shares.iter().any(|x| *x < -0.99) && shares.iter().any(|x| *x > 0.99),
        "slides both ways"
    );
    let stuck = touching[shares
        .iter()
        .position(|x| x.abs() < 0.9)
        .expect("sticks in between")];
    let c = stuck.contacts[0];
    // The rod under a force at that angle; at a given place and arc length it would be as stiff as
    // the wire is long.
    let rod = rod_at(stuck, &bent(1.0), Tangential::Ratio(mu * share(stuck)));
    let force = c.normal * c.force_n + c.friction_n;
    assert!(
        (force - rod.force_n).norm() < 1e-2 * force.norm(),
        "{force} {:?}",
        rod.force_n
    );
    assert!((rod.arclength_mm - c.arclength_mm).abs() < 0.02, "{rod:?}");
    let moment = discrete.base_moment_nmm(stuck);
    assert!(
        (moment - rod.moment_nmm).norm() < 6e-3 * moment.norm(),
        "{moment} {rod:?}"
    );
    // Negative control: without friction there is none, and the plain equilibrium comes out.
    let smooth = rubbed(&discrete, 0.0, [34.0, 0.0], 2.0, DEEP)
        .pop()
        .unwrap();
    assert_eq!(smooth.contacts[0].friction_n.norm(), 0.0);
    let rod = rod_at(&smooth, &bent(1.0), Tangential::Frictionless);
    let moment = discrete.base_moment_nmm(&smooth);
    assert!(
        (moment - rod.moment_nmm).norm() < 6e-3 * moment.norm(),
        "{moment} {rod:?}"
    );
}

/// Beside the wire's plane the ball pushes the wire aside: friction then is across the wire too,
/// still at the cone's edge.
#[test]
fn friction_takes_the_direction_of_the_slip() {
    let discrete = rod(40);
    let last = rubbed(&discrete, 0.1, [42.0, 1.0], 0.0, LAST)
        .pop()
        .unwrap();
    let c = last.contacts[0];
    assert!(
        (c.friction_n.norm() - 0.1 * c.force_n).abs() < 1e-3 * c.force_n,
        "{c:?}"
    );
    let moment = discrete.base_moment_nmm(&last);
    let applied = c.centre_mm.cross(&(c.normal * c.force_n + c.friction_n));
    assert!(
        (moment - applied).norm() < 2e-3 * moment.norm(),
        "{moment} {applied}"
    );
    let without = c.centre_mm.cross(&(c.normal * c.force_n));
    assert!(
        (moment - without).norm() > 1e-2 * moment.norm(),
        "negative control: {moment} {without}"
    );
}

#[test]
fn softened_links_bend_as_the_softened_rod() {
    let softening = Softening::Section {
        onset_per_m: 5.0,
        hardening: 0.1,
    };
    let error = |links: usize, law: Option<Softening>| {
        let mut discrete = rod(links);
        discrete.softening = Some(softening);
        let last = rubbed(&discrete, 0.0, [42.0, 0.0], 0.0, LAST)
            .pop()
            .unwrap();
        let bend_per_m = 1e3 * discrete.largest_bend_per_mm(&last.links);
        assert!(
            bend_per_m > 8.0,
            "the wire is to be past the onset: {bend_per_m}"
        );
        let mut rod = bent(0.5);
        rod.section.softening = law;
        let (moment, rod) = (
            discrete.base_moment_nmm(&last),
            rod_at(&last, &rod, Tangential::Frictionless).moment_nmm,
        );
        (moment - rod).norm() / rod.norm()
    };
    let errors = [20, 40, 80].map(|links| error(links, Some(softening)));
    assert!(
        errors[1] < 6e-3 && errors[0] / errors[2] > 6.0,
        "{errors:?}"
    );
    let stiff = error(40, None);
    assert!(
        stiff > 10.0 * errors[1],
        "negative control: a linear rod would be {stiff} off"
    );
}

/// A stiff cantilever under loads that differ along it: the root carries their integral; a soft one
/// under its weight follows the rod.
#[test]
fn the_root_carries_the_integral_of_the_loads() {
    let shape = Shape::new(&spec(straight_shape()).rest_shape, 0.25).unwrap();
    let settled = |section: &Section, load: &dyn Fn(f64) -> Vector3<f64>| {
        let mut discrete = ContactRod::new(section, &shape, 0.3, 40).unwrap();
        discrete.loads_n_per_mm = (0..40)
            .map(|j| load((f64::from(j) + 0.5) * LENGTH_MM / 40.0))
            .collect();
        let far = Ball {
            centre_mm: Vector3::repeat(1e4),
            radius_mm: 1.0,
        };
        let pressed = discrete.solve_contact(&far, &discrete.at_rest(), &[], &Vector3::zeros(), 60);
        assert!(pressed.converged && pressed.contacts.is_empty());
        discrete.base_moment_nmm(&pressed)
    };
    // A flow that grows along the wire from the clamp on: load q s / L, moment q L^2 / 3.
    let rigid = Section::round(0.3, 75e3, 28.2e3);
    let q = 1e-4;
    let moment = settled(&rigid, &|s| Vector3::z() * (q * s / LENGTH_MM));
    let exact = -q * LENGTH_MM * LENGTH_MM / 3.0;
    assert!(
        (moment.y - exact).abs() < 1e-3 * exact.abs(),
        "{moment} {exact}"
    );
    let even = settled(&rigid, &|_| Vector3::z() * (q / 2.0)).y;
    assert!(
        (even - exact).abs() > 0.2 * exact.abs(),
        "negative control: the same load spread evenly"
    );
    // Its own weight, four times that of the wire in air, on the soft wire: against the rod held by
    // next to nothing at its tip.
    let spec = spec(straight_shape());
    let mut rod = Rod::new(&spec, WORKING_STEP_MM)
        .unwrap()
        .with_weight(&spec, 0.0);
    rod.weight_n_per_mm *= 4.0;
    let moment = settled(&rod.section.clone(), &|_| rod.weight_n_per_mm);
    let stiff = rod.weight_n_per_mm.z * -LENGTH_MM * LENGTH_MM / 2.0;
    assert!(
        (moment.y / stiff - 1.0).abs() < 0.05 && moment.y < stiff,
        "a wire that hangs has a shorter arm: {moment} {stiff}"
    );
}
