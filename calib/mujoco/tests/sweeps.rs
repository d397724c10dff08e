//! Sweeps over built-in objects (SIMULATED): labels lie on the mesh, forces balance, the same draw gives the same sweep.

use nalgebra::Vector3;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mujoco::rod_engine::{LINKS, Run};
use wcal_mujoco::sweep::Event;
use wcal_mujoco::{Mesh, RodEngine, Sweep, SweepPlan, Verdict, objects};

fn whisker() -> WhiskerSpec {
    WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 },
        gravity_direction: None,
    }
}

fn all(mesh: &Mesh, seed: u64, count: u64) -> Vec<(Sweep, Run)> {
    let (engine, plan) = (RodEngine::new(&whisker(), LINKS).unwrap(), SweepPlan::default());
    (0..count)
        .filter_map(|k| Sweep::draw(mesh, &plan, seed, k, engine.reach_mm()))
        .map(|sweep| {
            let run = engine.run(mesh, &sweep, &plan);
            (sweep, run)
        })
        .collect()
}

#[test]
fn built_in_objects_are_closed_and_their_inside_is_inside() {
    for name in objects::NAMES {
        let mesh = objects::built_in(name).unwrap();
        assert!(mesh.notes.is_empty(), "{name}: {:?}", mesh.notes);
        let far = mesh.high_mm + Vector3::repeat(1.0);
        assert!(mesh.near(&far, 100.0).unwrap().distance_mm > 0.0, "{name}");
        // Just below each of some corners' surface lies the inside.
        let middle = (mesh.low_mm + mesh.high_mm) / 2.0;
        if !["ring", "bowl-foot", "wedge"].contains(&name) {
            assert!(mesh.near(&middle, 100.0).unwrap().distance_mm < 0.0, "{name}");
        }
    }
}

/// Sign of the distance against the winding number (solid angles of all triangles).
#[test]
fn inside_is_where_the_surface_winds_around() {
    for name in objects::NAMES {
        let mesh = objects::built_in(name).unwrap();
        let corners: Vec<Vector3<f64>> = mesh.points().collect();
        let size = mesh.high_mm - mesh.low_mm;
        for k in 0..300 {
            let at = |n: f64, i: usize| (n * f64::from(k) * 0.754_877_7 + 0.3 * i as f64).fract() * 1.4 - 0.2;
            let p = mesh.low_mm + size.component_mul(&Vector3::new(at(1.0, 0), at(1.7, 1), at(2.9, 2)));
            let turns: f64 =
                mesh.triangles().iter().map(|t| solid_angle(&p, t.map(|i| corners[i as usize]))).sum();
            let inside = turns > 2.0 * std::f64::consts::PI;
            let Some(near) = mesh.near(&p, 500.0) else { panic!("{name}: nothing near {p}") };
            assert_eq!(near.distance_mm < 0.0, inside, "{name}: {p} {near:?} {turns}");
        }
    }
}

fn solid_angle(p: &Vector3<f64>, t: [Vector3<f64>; 3]) -> f64 {
    let [a, b, c] = t.map(|x| x - p);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    2.0 * a.dot(&b.cross(&c)).atan2(la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb)
}

#[test]
fn labels_lie_on_the_mesh_and_forces_balance() {
    let (mut kept, mut touching, mut exact, mut imbalance) = (0, 0, 0, Vec::new());
    for name in objects::NAMES {
        let mesh = objects::built_in(name).unwrap();
        for (sweep, run) in all(&mesh, 7, 6) {
            if run.verdict != Verdict::Kept {
                continue;
            }
            kept += 1;
            for sample in run.samples.iter().filter(|s| s.settled) {
                let mut applied = Vector3::zeros();
                for contact in &sample.contacts {
                    touching += 1;
                    let shift = sweep.shift_mm - Vector3::z() * sample.travel_mm;
                    let off = mesh.distance_mm(&sweep.turn.tr_mul(&(contact.point_mm - shift)));
                    // A plane that the wire met beside its nearest place may lie a few micrometres off.
                    assert!(off < 0.01, "{name}: {off} mm");
                    exact += usize::from(off < 1e-6);
                    applied += contact.centre_mm.cross(&(contact.normal * contact.force_n));
                }
                let off = (sample.moment_nmm - applied).norm();
                imbalance.push(off);
            }
        }
    }
    imbalance.sort_by(f64::total_cmp);
    assert!(*imbalance.last().unwrap() < 5e-3 && imbalance[imbalance.len() * 95 / 100] < 1e-5);
    assert!(exact * 100 > touching * 97, "{exact} of {touching}");
    assert!(kept > 60 && touching > 3000, "{kept} {touching}");
}

#[test]
fn the_same_draw_is_the_same_sweep_and_another_seed_is_another() {
    let mesh = objects::built_in("can").unwrap();
    assert!(all(&mesh, 7, 2) == all(&mesh, 7, 2));
    assert_ne!(all(&mesh, 7, 2)[0].0, all(&mesh, 8, 2)[0].0);
}

#[test]
fn a_sweep_past_a_can_begins_free_touches_and_comes_free() {
    let runs = all(&objects::built_in("can").unwrap(), 3, 20);
    let whole = runs.iter().find(|(_, r)| r.samples.iter().any(|s| s.event == Event::Release)).unwrap();
    let events: Vec<Event> = whole.1.samples.iter().map(|s| s.event).filter(|e| *e != Event::None).collect();
    assert_eq!(events[0], Event::Onset, "{events:?}");
    assert!(whole.1.samples[0].contacts.is_empty() && whole.1.samples[0].moment_nmm.norm() < 1e-9);
}
