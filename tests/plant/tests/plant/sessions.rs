//! Drawn sessions: their form, their sizes, their laws, and tampering.

use wcal_plant::case::Tampering;
use wcal_plant::effects::ALL;
use wcal_plant::{Case, CaseKind, Design, Kind, Request, draw};

fn request(seed: u64, design: Design, want: CaseKind, target_sigma: f64) -> Request {
    Request {
        seed,
        design,
        want,
        target_sigma,
        rivals: false,
    }
}

fn columns(path: &std::path::Path) -> Vec<Vec<String>> {
    csv::Reader::from_path(path)
        .unwrap()
        .records()
        .map(|r| r.unwrap().iter().map(str::to_owned).collect())
        .collect()
}

#[test]
fn written_sessions_have_the_practice_form() {
    let folder = tempfile::tempdir().unwrap();
    for (design, count, calibration, rests) in
        [(Design::Rich, 360, 27, 36), (Design::Paper, 36, 27, 9)]
    {
        let case = draw(&request(3, design, CaseKind::Null, 8.0)).unwrap();
        let out = folder.path().join("case-001");
        case.write(&out).unwrap();
        let points = columns(&out.join("points.csv"));
        assert_eq!(points.len(), count);
        let with = |role: &str| points.iter().filter(|r| r[1] == role).count();
        assert_eq!((with("calibration"), with("rest")), (calibration, rests));
        let times: Vec<f64> = points.iter().map(|r| r[4].parse().unwrap()).collect();
        assert!(times.windows(2).all(|w| w[1] > w[0]));
        let holdout = columns(&out.join("holdout.csv"));
        assert_eq!(holdout.len(), 54);
        assert_eq!(holdout.iter().filter(|r| r[1] == "holdout").count(), 42);
        assert_eq!(case.truth.holdout_moments_nmm.len(), 54);
        let toml = std::fs::read_to_string(out.join("session.toml")).unwrap();
        assert!(toml.contains("id = \"case-001\"") && toml.matches("[[trajectory]]").count() == 15);
        // Timing of the practice sessions: 2 mm/s between settled rows, the first after 3 s (paper
        // 2 s).
        let (dwell, stage): (f64, f64) =
            (points[1][8].parse().unwrap(), points[1][5].parse().unwrap());
        assert!((times[1] - times[0] - dwell - stage / 2.0).abs() < 2e-3);
        assert_eq!(times[0], if design == Design::Rich { 3.0 } else { 2.0 });
    }
}

#[test]
fn truth_has_the_practice_keys_and_the_draw_repeats() {
    let order = request(
        9,
        Design::Paper,
        CaseKind::Effects(vec![Kind::CreepProny1]),
        8.0,
    );
    let (a, b) = (draw(&order).unwrap(), draw(&order).unwrap());
    assert_eq!(format!("{a:?}"), format!("{b:?}"));
    let truth = serde_json::to_value(&a.truth).unwrap();
    for key in [
        "effects",
        "design",
        "noise_pm",
        "K",
        "zero",
        "label",
        "names",
        "size",
        "projected_size_in_noises",
        "holdout_moments_nmm",
    ] {
        assert!(!truth[key].is_null(), "{key}");
    }
    assert_eq!(truth["design"], "paper");
    assert!(truth["effects"]["creep"]["tau_s"].is_number());
}

#[test]
fn every_law_draws_and_reaches_its_size_or_says_so() {
    for (i, kind) in ALL.into_iter().enumerate() {
        let case = draw(&request(
            100 + i as u64,
            Design::Rich,
            CaseKind::Effects(vec![kind]),
            12.0,
        ))
        .unwrap();
        let t = &case.truth;
        assert!(t.projected_size_in_noises.is_finite(), "{kind:?}");
        if t.target_reached {
            assert!(
                (t.projected_size_in_noises / 12.0 - 1.0).abs() < 0.06,
                "{kind:?}"
            );
        }
        assert!(
            case.readings
                .iter()
                .all(|r| r.fbg_nm.iter().all(|v| v.is_finite())),
            "{kind:?}"
        );
        // An oracle is as good as the noise allows (84 values: 1 +- 0.25 at 3 sd).
        let floor =
            t.new_pose_noise_pm / (t.k[0][0] * t.k[1][1] - t.k[0][1] * t.k[1][0]).abs().sqrt();
        assert!(
            (0.7..1.35).contains(&(t.oracle_after_nmm / floor)),
            "{kind:?} {}",
            t.oracle_after_nmm / floor
        );
        assert_eq!(kind.is_unknown(), t.shape.is_some(), "{kind:?}");
    }
}

#[test]
fn size_grows_with_the_target() {
    let size = |target| {
        let order = request(
            5,
            Design::Rich,
            CaseKind::Effects(vec![Kind::TemperatureLinear]),
            target,
        );
        draw(&order).unwrap().truth
    };
    let (small, large) = (size(8.0), size(20.0));
    assert!((large.projected_size_in_noises / small.projected_size_in_noises - 2.5).abs() < 0.2);
    // A target that the physical range cannot give is recorded as missed.
    let far = draw(&request(
        5,
        Design::Rich,
        CaseKind::Effects(vec![Kind::StageScale]),
        40.0,
    ))
    .unwrap()
    .truth;
    assert!(!far.target_reached && far.projected_size_in_noises < 10.0);
}

#[test]
fn tricks_leave_their_mark() {
    let case = |trick| -> Case {
        draw(&request(7, Design::Rich, CaseKind::Adversarial(trick), 8.0)).unwrap()
    };
    let honest = draw(&request(7, Design::Rich, CaseKind::Null, 8.0)).unwrap();
    let points = |c: &Case| {
        c.readings
            .iter()
            .filter(|r| !r.planned.holdout)
            .cloned()
            .collect::<Vec<_>>()
    };
    for trick in Tampering::ALL {
        let c = case(trick);
        assert_ne!(c.readings, honest.readings, "{}", trick.name());
        assert_eq!(c.truth.label, "adversarial");
        assert!(!c.truth.expected.is_empty());
    }
    let fake = points(&case(Tampering::FakeReplicates));
    let copies = (0..fake.len())
        .filter(|&i| i + 12 < fake.len() && fake[i].fbg_nm == fake[i + 12].fbg_nm)
        .count();
    assert_eq!(copies, 99);
    let backwards = points(&case(Tampering::ClockBackwards));
    assert!(
        backwards
            .windows(2)
            .all(|w| w[1].planned.t_s < w[0].planned.t_s)
    );
    let swapped = points(&case(Tampering::SwappedPoses));
    let moved = swapped
        .iter()
        .zip(points(&honest))
        .filter(|(a, b)| a.fbg_nm != b.fbg_nm)
        .count();
    assert_eq!(moved, 2);
    let metres = case(Tampering::GrooveInMetres);
    assert!(metres.readings.iter().all(|r| r.groove_mm[0] < 0.1));
}
