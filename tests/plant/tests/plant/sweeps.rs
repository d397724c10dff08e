//! Drawn sweeps: what they are, and that their contacts obey the laws that they state. SIMULATED.

use wcal_plant::sweep::SweepCase;

#[test]
fn contacts_are_in_equilibrium_on_the_body_within_the_cone() {
    let (mut rows, mut slides, mut sticks, mut tips) = (0, 0, 0, 0);
    for seed in 0..6 {
        let start = std::time::Instant::now();
        let case = SweepCase::draw(seed).unwrap();
        let wire = case.scene.bench.wire();
        let peak = case
            .readings
            .iter()
            .map(|r| r.moment_nmm[0].hypot(r.moment_nmm[1]))
            .fold(0.0, f64::max);
        let touches: Vec<_> = case
            .readings
            .iter()
            .filter_map(|r| r.touch.map(|t| (r, t)))
            .collect();
        println!(
            "{seed}: {} of {} readings, {} rejected, mu {:.2}, peak {peak:.2} N mm, noise {:.4}, arcs {:.1} .. {:.1} of {:.0}, {:?}, {:.0} Hz, {:.1} s",
            touches.len(),
            case.readings.len(),
            case.rejected,
            case.scene.friction,
            case.noise_nmm(),
            touches[0].1.arclength_mm,
            touches[touches.len() - 1].1.arclength_mm,
            wire.length_mm,
            case.scene.body.outline,
            case.scene.rate_hz,
            start.elapsed().as_secs_f64()
        );
        for (r, t) in touches {
            let (distance, normal) = case.scene.body.closest(&(t.axis_mm + r.base_mm));
            assert!((distance - wire.radius_mm()).abs() < 1e-6);
            // Within the cone of the body's own normal; the wire lies along the surface, but at its
            // tip.
            let across = t.force_n - normal * t.force_n.dot(&normal);
            assert!(
                t.normal_n > 0.0
                    && across.norm() <= case.scene.friction * t.normal_n * (1.0 + 1e-9) + 1e-12
            );
            let tip = t.arclength_mm > wire.length_mm - 1e-6;
            assert!(tip && normal.dot(&t.tangent) < 1e-6 || normal.dot(&t.tangent).abs() < 1e-6);
            // The rod's other solver, which knows no body, finds the same force for the same
            // contact point (without friction).
            if case.scene.friction == 0.0 && !tip {
                let start = wcal_plant::rod::Equilibrium {
                    force_n: t.force_n,
                    arclength_mm: t.arclength_mm,
                    tangent: t.tangent,
                    moment_nmm: t.moment_nmm,
                };
                let e = wire.solve(&t.axis_mm, 0.0, &start, &mut None).unwrap();
                let off = (e.moment_nmm - t.moment_nmm).norm();
                assert!(
                    off < 0.01 * t.moment_nmm.norm() + 1e-4,
                    "{off} {:?}",
                    t.moment_nmm
                );
            }
            rows += 1;
            slides += usize::from(t.mobilised > 0.95);
            sticks += usize::from(t.mobilised < 0.7);
            tips += usize::from(tip);
        }
    }
    println!(
        "{rows} contacts: {slides} slide, {sticks} stick or have no friction, {tips} at the tip"
    );
    assert!(rows > 200 && slides > 50 && tips > 3);
}

/// Control: a body that is moved is no longer touched where the truth says.
#[test]
fn another_body_is_not_touched_there() {
    let mut case = SweepCase::draw(1).unwrap();
    let place = case
        .readings
        .iter()
        .find_map(|r| r.touch.map(|t| t.axis_mm + r.base_mm))
        .unwrap();
    let near = case.scene.body.closest(&place).0;
    case.scene.body.centre_mm.x += 1.0;
    case.scene.body.centre_mm.z += 1.0;
    assert!((case.scene.body.closest(&place).0 - near).abs() > 0.1);
    assert_eq!(
        SweepCase::draw(1).unwrap().readings.len(),
        case.readings.len(),
        "seeded"
    );
}
