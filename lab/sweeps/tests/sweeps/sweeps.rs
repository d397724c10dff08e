//! Sweeps over built-in objects (SIMULATED): labels lie on the mesh, forces balance, the same draw
//! gives the same sweep.

use nalgebra::Vector3;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::rod_engine::{LINKS, Run};
use wcal_lab_sweeps::sweep::Event;
use wcal_lab_sweeps::{RodEngine, Sweep, SweepPlan, Turn, Verdict, objects};
use wcal_mesh::Mesh;

fn whisker() -> WhiskerSpec {
    WhiskerSpec::nominal()
}

fn all(mesh: &Mesh, seed: u64, count: u64) -> Vec<(Sweep, Run)> {
    let (engine, plan) = (
        RodEngine::new(&whisker(), LINKS).unwrap(),
        SweepPlan::default(),
    );
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
    for name in objects::NAMES.into_iter().chain(objects::TEST_NAMES) {
        let mesh = objects::built_in(name).unwrap();
        assert!(mesh.notes.is_empty(), "{name}: {:?}", mesh.notes);
        let far = mesh.high_mm + Vector3::repeat(1.0);
        assert!(
            mesh.closest_point(&far, 100.0).unwrap().distance_mm > 0.0,
            "{name}"
        );
        // Just below each of some corners' surface lies the inside.
        let middle = (mesh.low_mm + mesh.high_mm) / 2.0;
        if !["ring", "bowl-foot", "wedge", "l-profile"].contains(&name) {
            assert!(
                mesh.closest_point(&middle, 100.0).unwrap().distance_mm < 0.0,
                "{name}"
            );
        }
    }
}

/// Sign of the distance against the winding number (solid angles of all triangles).
#[test]
fn inside_is_where_the_surface_winds_around() {
    for name in objects::NAMES.into_iter().chain(objects::TEST_NAMES) {
        let mesh = objects::built_in(name).unwrap();
        let corners: Vec<Vector3<f64>> = mesh.points().collect();
        let size = mesh.high_mm - mesh.low_mm;
        for k in 0..300 {
            let at = |n: f64, i: usize| {
                (n * f64::from(k) * 0.754_877_7 + 0.3 * i as f64).fract() * 1.4 - 0.2
            };
            let p =
                mesh.low_mm + size.component_mul(&Vector3::new(at(1.0, 0), at(1.7, 1), at(2.9, 2)));
            let turns: f64 = mesh
                .triangles()
                .iter()
                .map(|t| solid_angle(&p, t.map(|i| corners[i as usize])))
                .sum();
            let inside = turns > 2.0 * std::f64::consts::PI;
            let Some(near) = mesh.closest_point(&p, 500.0) else {
                panic!("{name}: nothing near {p}")
            };
            assert_eq!(
                near.distance_mm < 0.0,
                inside,
                "{name}: {p} {near:?} {turns}"
            );
        }
    }
}

fn solid_angle(p: &Vector3<f64>, t: [Vector3<f64>; 3]) -> f64 {
    let [a, b, c] = t.map(|x| x - p);
    let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
    2.0 * a
        .dot(&b.cross(&c))
        .atan2(la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb)
}

/// Distance from a mesh by its triangles one after the other (C. Ericson, Real-Time Collision
/// Detection, 5.1.5): no tree, no library.
fn distance_mm(mesh: &Mesh, p: &Vector3<f64>) -> f64 {
    let corners: Vec<Vector3<f64>> = mesh.points().collect();
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|k| corners[k as usize]);
        let edge = |a: Vector3<f64>, b: Vector3<f64>| {
            let along = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (p - a - (b - a) * along).norm()
        };
        let edges = edge(a, b).min(edge(b, c)).min(edge(c, a));
        let normal = (b - a).cross(&(c - a)).normalize();
        let foot = p - normal * normal.dot(&(p - a));
        let side = |a: Vector3<f64>, b: Vector3<f64>| normal.dot(&(b - a).cross(&(foot - a)));
        let over = side(a, b) >= 0.0 && side(b, c) >= 0.0 && side(c, a) >= 0.0;
        if over { (p - foot).norm() } else { edges }
    };
    mesh.triangles()
        .iter()
        .map(of)
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn labels_lie_on_the_mesh_and_forces_balance() {
    let (mut kept, mut touching, mut exact, mut imbalance) = (0, 0, 0, Vec::new());
    let mut below = 0;
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
                    let off = distance_mm(&mesh, &sweep.turn.tr_mul(&(contact.point_mm - shift)));
                    // A plane that the wire met off its nearest place may lie up to 3 micrometres
                    // off.
                    assert!(off < 3.1e-3, "{name}: {off} mm");
                    // Negative control: the wire's centre line is not on the mesh, but a radius
                    // away.
                    let axis = distance_mm(&mesh, &sweep.turn.tr_mul(&(contact.centre_mm - shift)));
                    assert!((0.1..0.2).contains(&axis), "{name}: {axis} mm");
                    // Where it slides over a plane the gap is solved to 1e-5 mm.
                    exact += usize::from(off < 2e-5);
                    // A wire that slides over a facet is touched where it is now, not where it was.
                    let offset_mm = (contact.centre_mm - contact.point_mm)
                        .cross(&contact.normal)
                        .norm();
                    below += usize::from(offset_mm < 1e-6);
                    applied += contact.centre_mm.cross(&(contact.normal * contact.force_n));
                }
                let off = (sample.moment_nmm - applied).norm();
                imbalance.push(off);
            }
        }
    }
    imbalance.sort_by(f64::total_cmp);
    assert!(*imbalance.last().unwrap() < 5e-3 && imbalance[imbalance.len() * 95 / 100] < 1e-5);
    // What leans on a facet's plane past its edge, within 3 micrometres, is one contact in twenty;
    // before the touched point went along with the wire it was on the mesh even there, off the
    // wire.
    assert!(
        exact * 100 > touching * 94,
        "on the mesh: {exact} of {touching}"
    );
    assert!(
        below * 100 > touching * 98,
        "below the wire: {below} of {touching}"
    );
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
    let whole = runs
        .iter()
        .find(|(_, r)| r.samples.iter().any(|s| s.event == Event::Release))
        .unwrap();
    let events: Vec<Event> = whole
        .1
        .samples
        .iter()
        .map(|s| s.event)
        .filter(|e| *e != Event::None)
        .collect();
    assert_eq!(events[0], Event::Onset, "{events:?}");
    assert!(whole.1.samples[0].contacts.is_empty() && whole.1.samples[0].moment_nmm.norm() < 1e-9);
}

/// A plate, thinner than the way of the base from sample to sample, mm.
fn plate() -> Mesh {
    let corner = |k: usize| {
        let [x, y, z] = [0, 1, 2].map(|bit| if k >> bit & 1 == 1 { 0.5 } else { -0.5 });
        Vector3::new(40.0 * x, 40.0 * y, 0.5 * z)
    };
    let points: Vec<Vector3<f64>> = (0..8).map(corner).collect();
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let triangles: Vec<[u32; 3]> = faces
        .iter()
        .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
        .collect();
    Mesh::new("plate", &points, &triangles).unwrap()
}

/// What a sweep over a thin plate feels does not depend on how often it is sampled where the steps
/// are short: with long ones the wire may pass through between two samples.
#[test]
fn short_steps_keep_a_wire_on_its_side_of_a_thin_plate() {
    let (mesh, engine) = (plate(), RodEngine::new(&whisker(), LINKS).unwrap());
    let [mut touching, mut short, mut long] = [0; 3];
    let plan = |rate_hz, step_mm| SweepPlan {
        rate_hz,
        step_mm,
        ..SweepPlan::default()
    };
    for k in 0..24 {
        let Some(sweep) = Sweep::draw(&mesh, &plan(5.0, 0.1), 7, k, engine.reach_mm()) else {
            continue;
        };
        let run = |rate_hz, step_mm| engine.run(&mesh, &sweep, &plan(rate_hz, step_mm)).samples;
        let often = run(50.0, 0.1);
        for (seldom, differ) in [(run(5.0, 0.1), &mut short), (run(5.0, 1.0), &mut long)] {
            for (a, b) in seldom.iter().zip(often.iter().step_by(10)) {
                assert!((a.t_s - b.t_s).abs() < 1e-9);
                touching += usize::from(!b.contacts.is_empty());
                let off = (a.moment_nmm - b.moment_nmm).norm();
                *differ += usize::from(off > 0.002 + 0.02 * b.moment_nmm.norm());
            }
        }
    }
    println!(
        "of {touching} samples in contact {short} differ with short steps, {long} with long ones"
    );
    assert!(
        short * 100 < touching && short * 2 < long,
        "{short}, {long} of {touching}"
    );
}

/// A body that comes along -z cannot push a free wire toward +z: it is met on the side that it
/// comes from.
#[test]
fn a_free_wire_is_met_from_the_side_that_the_body_comes_from() {
    let (mesh, engine) = (plate(), RodEngine::new(&whisker(), LINKS).unwrap());
    let plan = SweepPlan {
        rate_hz: 10.0,
        speed_mm_s: [6.9, 7.0],
        ..SweepPlan::default()
    };
    let (mut met, mut from_behind) = (0, 0);
    for k in 0..80 {
        let Some(sweep) = Sweep::draw(&mesh, &plan, 11, k, engine.reach_mm()) else {
            continue;
        };
        let samples = engine.run(&mesh, &sweep, &plan).samples;
        for first in samples
            .iter()
            .filter(|s| s.event == Event::Onset && s.contacts.len() == 1)
        {
            met += 1;
            from_behind += usize::from(first.contacts[0].normal.z > 0.05);
        }
    }
    println!("{from_behind} of {met} from behind");
    assert!(met > 40 && from_behind == 0, "{from_behind} of {met}");
}

#[test]
fn faces_are_upright_and_a_quarter_turn_apart() {
    let mesh = objects::built_in("can").unwrap();
    let plan = SweepPlan {
        turn: Turn::Faces,
        ..SweepPlan::default()
    };
    let turns: Vec<_> = (0..8)
        .map(|k| Sweep::draw(&mesh, &plan, 7, k, 60.0).unwrap().turn)
        .collect();
    for (k, turn) in turns.iter().enumerate() {
        assert!((turn * Vector3::z() - Vector3::y()).norm() < 1e-12, "{k}");
        let next = turns[(k + 1) % 8];
        assert!(
            (turn * Vector3::x()).dot(&(next * Vector3::x())).abs() < 1e-12,
            "{k}"
        );
        assert!((turn - turns[(k + 4) % 8]).norm() < 1e-12, "{k}");
    }
    // Negative control: drawn at random they are not.
    let drawn = Sweep::draw(&mesh, &SweepPlan::default(), 7, 0, 60.0)
        .unwrap()
        .turn;
    assert!((drawn * Vector3::z() - Vector3::y()).norm() > 0.05);
}

/// Every reason for which a sweep is rejected, each from its own cause.
#[test]
fn rejected_sweeps_name_their_reason() {
    let (mesh, star) = (
        objects::built_in("can").unwrap(),
        objects::built_in("star-bar").unwrap(),
    );
    let engine = RodEngine::new(&whisker(), LINKS).unwrap();
    let usual = SweepPlan::default();
    let drawn = |mesh: &Mesh, plan: &SweepPlan, k| {
        Sweep::draw(mesh, plan, 7, k, engine.reach_mm()).unwrap()
    };
    let verdict =
        |mesh: &Mesh, plan: &SweepPlan, sweep: &Sweep| engine.run(mesh, sweep, plan).verdict;
    let sweep = drawn(&mesh, &usual, 0);
    // Negative control: the sweep itself is kept.
    assert_eq!(verdict(&mesh, &usual, &sweep), Verdict::Kept);
    let weak = SweepPlan {
        max_strain: 2e-4,
        ..usual.clone()
    };
    assert_eq!(
        verdict(&mesh, &weak, &sweep),
        Verdict::Rejected("torque-too-high")
    );
    let short = SweepPlan {
        max_travel_mm: 1.0,
        ..usual.clone()
    };
    assert_eq!(
        verdict(&mesh, &short, &sweep),
        Verdict::Rejected("no-contact")
    );
    // The object's middle is brought to the middle of the wire.
    let mut inside = sweep.clone();
    inside.shift_mm =
        Vector3::new(25.0, 0.0, 0.0) - sweep.turn * ((mesh.low_mm + mesh.high_mm) / 2.0);
    assert_eq!(
        verdict(&mesh, &usual, &inside),
        Verdict::Rejected("starts-inside")
    );
    assert!(
        Sweep::draw(&mesh, &usual, 7, 0, 1.0).is_none(),
        "a wire of 1 mm reach meets nothing"
    );
    // A star's edges throw the wire from one to the next.
    let strict = SweepPlan {
        keep_jumps: false,
        ..usual.clone()
    };
    let jumps = (0..30).map(|k| drawn(&star, &usual, k)).find(|s| {
        engine
            .run(&star, s, &usual)
            .samples
            .iter()
            .any(|s| s.event == Event::Jump)
    });
    let jumps = jumps.expect("one of thirty sweeps over a star jumps");
    assert_eq!(verdict(&star, &usual, &jumps), Verdict::Kept);
    assert_eq!(
        verdict(&star, &strict, &jumps),
        Verdict::Rejected("contact-jump")
    );
}
