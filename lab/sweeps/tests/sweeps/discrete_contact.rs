//! The wire against bodies: balance, gaps, and agreement with the continuous rod under refinement.

use super::{bent, bent_shape, spec};
use nalgebra::{Matrix3, Vector3};
use wcal_lab_sweeps::contact::{Configuration, Contact, ContactRod, ContactState, Surface};
use wcal_mesh::ClosestPoint;
use wcal_rod::{DiscreteRod, Guess, Section, Shape, Tangential};

/// Half space below `z = height_mm`.
struct Floor {
    height_mm: f64,
}

impl Surface for Floor {
    fn closest_point(&self, p: &Vector3<f64>, within_mm: f64) -> Option<ClosestPoint> {
        let distance_mm = p.z - self.height_mm;
        let point_mm = Vector3::new(p.x, p.y, self.height_mm);
        (distance_mm < within_mm).then_some(ClosestPoint {
            distance_mm,
            normal: Vector3::z(),
            point_mm,
            second_per_mm: Matrix3::zeros(),
        })
    }
}

pub(crate) struct Ball {
    pub centre_mm: Vector3<f64>,
    pub radius_mm: f64,
}

impl Surface for Ball {
    fn closest_point(&self, p: &Vector3<f64>, within_mm: f64) -> Option<ClosestPoint> {
        let off = p - self.centre_mm;
        let distance_mm = off.norm() - self.radius_mm;
        let normal = off.normalize();
        let point_mm = self.centre_mm + normal * self.radius_mm;
        let second_per_mm = (Matrix3::identity() - normal * normal.transpose()) / off.norm();
        (distance_mm < within_mm).then_some(ClosestPoint {
            distance_mm,
            normal,
            point_mm,
            second_per_mm,
        })
    }
}

pub(crate) fn rod(links: usize) -> ContactRod {
    let section = Section::round(0.3, 75.0, 28.2);
    let shape = Shape::new(&spec(bent_shape()).rest_shape, 0.25).unwrap();
    ContactRod::new(&section, &shape, 0.3, links).unwrap()
}

/// A body moves along its path in `steps` steps.
fn follow<S: Surface>(
    rod: &ContactRod,
    steps: usize,
    by: &Vector3<f64>,
    at: impl Fn(f64) -> S,
) -> ContactState {
    let mut pressed: Option<ContactState> = None;
    let rest = rod.at_rest();
    for k in 0..=steps {
        let (links, known): (&Configuration, &[Contact]) = pressed
            .as_ref()
            .map_or((&rest, &[]), |p| (&p.links, &p.contacts));
        let next = rod.solve_contact(
            &at(k as f64 / steps as f64),
            links,
            known,
            &(by / steps as f64),
            60,
        );
        assert!(
            next.converged,
            "step {k}: {} iterations, {:?}",
            next.iterations, next.contacts
        );
        pressed = Some(next);
    }
    pressed.unwrap()
}

fn ball(rod: &ContactRod) -> ContactState {
    // From below into the straight part, off the plane of the wire.
    let (from, by) = (Vector3::new(42.0, 1.0, -18.0), Vector3::new(0.0, 0.0, 15.0));
    follow(rod, 28, &by, |x| Ball {
        centre_mm: from + by * x,
        radius_mm: 5.0,
    })
}

#[test]
fn the_root_carries_what_the_contacts_apply() {
    for pressed in [
        ball(&rod(40)),
        follow(&rod(40), 20, &Vector3::new(0.0, 0.0, 12.0), |x| Floor {
            height_mm: -20.0 + 12.0 * x,
        }),
    ] {
        let moment = rod(40).base_moment_nmm(&pressed);
        assert!(moment.norm() > 0.2, "{moment}");
        let applied: Vector3<f64> = pressed
            .contacts
            .iter()
            .map(|c| c.centre_mm.cross(&(c.normal * c.force_n)))
            .sum();
        assert!(
            (moment - applied).norm() < 1e-5 * moment.norm(),
            "{moment} {applied}"
        );
        for contact in &pressed.contacts {
            assert!(contact.gap_mm.abs() < 1e-4, "{contact:?}");
        }
    }
}

/// At the point where the ball holds the wire, the continuous rod needs the same force: error of
/// second order in the link.
#[test]
fn links_agree_with_the_rod_to_second_order() {
    let errors: Vec<f64> = [20, 40, 80]
        .into_iter()
        .map(|links| {
            let rod = rod(links);
            let pressed = ball(&rod);
            assert_eq!(pressed.contacts.len(), 1, "{:?}", pressed.contacts);
            let contact = pressed.contacts[0];
            let point = contact.centre_mm;
            let guess = Guess {
                force_n: contact.normal * contact.force_n,
                arclength_mm: contact.arclength_mm,
            };
            let continuous = bent(1.0)
                .solve(&point, &guess, Tangential::Frictionless)
                .unwrap();
            (rod.base_moment_nmm(&pressed) - continuous.moment_nmm).norm()
                / continuous.moment_nmm.norm()
        })
        .collect();
    assert!(errors[1] < 6e-3, "{errors:?}");
    assert!(errors[0] / errors[2] > 8.0, "{errors:?}");
}

/// Negative control of the agreement: a clamp spring of a whole link (the plain layout) would miss
/// by far more.
#[test]
fn a_floor_holds_the_tip_first_and_then_a_line() {
    let rod = rod(60);
    let floor = |to: f64| {
        follow(&rod, 60, &Vector3::new(0.0, 0.0, to + 20.0), |x| Floor {
            height_mm: -20.0 + (to + 20.0) * x,
        })
    };
    let tip = floor(-14.0);
    assert_eq!(tip.contacts.len(), 1);
    assert!(
        (tip.contacts[0].arclength_mm - 60.0).abs() < 1e-9,
        "{:?}",
        tip.contacts
    );
    let lying = floor(-0.5);
    // What touches lies on the floor; the links' ends are off the centre line by some micrometres.
    let touching: Vec<f64> = lying.contacts.iter().map(|c| c.centre_mm.z).collect();
    assert!(
        !touching.is_empty() && touching.iter().all(|z| (z - (-0.5 + 0.15)).abs() < 1e-4),
        "{touching:?}"
    );
    let lowest = lying
        .links
        .nodes_mm
        .iter()
        .map(|p| p.z)
        .fold(f64::INFINITY, f64::min);
    assert!((lowest - (-0.5 + 0.15)).abs() < 5e-3, "{lowest}");
}

/// The soft contact sinks in by hundredths of a millimetre and gives the hard one's moment; ten
/// times as deep it would not.
#[test]
fn a_soft_contact_gives_the_hard_ones_moment() {
    let rod = rod(40);
    let hard = ball(&rod);
    let body = |lower_mm: f64| Ball {
        centre_mm: Vector3::new(42.0, 1.0, -3.0 - lower_mm),
        radius_mm: 5.0,
    };
    let moment = rod.base_moment_nmm(&hard);
    let off = |lower_mm: f64| {
        let soft = rod.solve_penalty_contact(&body(lower_mm), &hard.links, 300);
        assert!(
            soft.converged && soft.overlap_mm < 0.05,
            "{} {}",
            soft.converged,
            soft.overlap_mm
        );
        (rod.base_moment_nmm(&soft) - moment).norm() / moment.norm()
    };
    assert!(off(0.0) < 0.02, "{}", off(0.0));
    assert!(
        off(0.3) > 0.03,
        "negative control: a ball 0.3 mm lower shows ({})",
        off(0.3)
    );
}

/// From the contact inward the same equilibrium comes out as from the search for it; half the force
/// is another one.
#[test]
fn a_push_from_the_contact_inward_is_the_pressed_wire() {
    let rod = rod(40);
    let shape = Shape::new(&spec(bent_shape()).rest_shape, 0.25).unwrap();
    let links = DiscreteRod::new(&Section::round(0.3, 75.0, 28.2), &shape, 0.3, 40).unwrap();
    for x_mm in [16.0, 22.0, 28.0] {
        let by = Vector3::new(0.0, -2.0, -14.0);
        let start = Vector3::new(x_mm, 3.0, 21.0);
        let pressed = follow(&rod, 16, &by, |t| Ball {
            centre_mm: start + by * t,
            radius_mm: 9.0,
        });
        let [contact] = &pressed.contacts[..] else {
            panic!("one contact: {:?}", pressed.contacts)
        };
        let link = ((contact.arclength_mm / rod.link_mm) as usize).min(39);
        let local = pressed.links.frames[link].tr_mul(&(contact.normal * contact.force_n));
        let push = links.under_point_load(contact.arclength_mm, &local);
        let (moment, expected) = (push.moment_nmm, rod.base_moment_nmm(&pressed));
        // A contact lies on the smooth centre line, some 0.01 mm off the link itself.
        assert!(
            (moment - expected).norm() < 1e-3 * expected.norm(),
            "{moment} {expected}"
        );
        let off = push.axis_mm - contact.normal * rod.radius_mm - contact.point_mm;
        assert!(off.norm() < 0.03, "{off}");
        let half = links.under_point_load(contact.arclength_mm, &(local / 2.0));
        assert!((half.moment_nmm - expected).norm() > 0.2 * expected.norm());
    }
}
