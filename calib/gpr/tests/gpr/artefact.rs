//! The stored map: same numbers after a round trip, refusal of what is unsound, refusal outside the
//! region.
#![allow(
    clippy::needless_range_loop,
    reason = "one index for both moments, as in the formulas"
)]

use crate::support::Plant;
use wcal_gpr::{FitOptions, MapArtefact, MapError, MapKind, MapPredictor, MapTraining, fit_map};

fn bent(candidate: MapKind) -> (MapTraining, wcal_gpr::MapFit) {
    let training = Plant {
        bend: 0.3,
        noise_nmm: 0.02,
    }
    .draw(9, 21);
    let options = FitOptions {
        candidates: vec![candidate],
        ..FitOptions::default()
    };
    let fit = fit_map(&training, &options).unwrap();
    (training, fit)
}

#[test]
fn predictor_of_a_stored_map_equals_the_fit() {
    for candidate in MapKind::ALL {
        let (_, fit) = bent(candidate);
        let json = serde_json::to_string(&fit.artefact).unwrap();
        let read: MapArtefact = serde_json::from_str(&json).unwrap();
        assert_eq!(read, fit.artefact);
        let predictor = MapPredictor::new(&read).unwrap();
        for shift in [[0.0, 0.0], [30.0, -50.0], [-70.0, 20.0]] {
            let p = predictor.predict(shift);
            let mean = predictor.mean_nmm(shift);
            let z = [0, 1].map(|c| (shift[c] - read.centre_pm[c]) / read.scale_pm);
            for m in 0..2 {
                let (expected, map, noisy) = fit.candidates[0].fits[m].predict(z);
                let wider = fit.candidates[0].inflation[m];
                // The artefact solves in double precision what the fit solved in another order:
                // kernel plus affine part cancel.
                assert!((p.moment_nmm[m] - expected).abs() < 1e-7, "{candidate:?}");
                assert!((mean[m] - expected).abs() < 1e-7, "{candidate:?}");
                assert!(
                    (p.sd_map_nmm[m].powi(2) - wider.powi(2) * map).abs() < 1e-7,
                    "{candidate:?}"
                );
                assert!(
                    (p.sd_nmm[m].powi(2) - wider.powi(2) * noisy).abs() < 1e-7,
                    "{candidate:?}"
                );
                assert!(p.sd_nmm[m] >= p.sd_map_nmm[m]);
            }
        }
    }
}

#[test]
fn a_reading_outside_the_region_is_not_valid() {
    let (training, fit) = bent(MapKind::ThinPlate);
    let predictor = MapPredictor::new(&fit.artefact).unwrap();
    assert!(
        training
            .shifts_pm
            .iter()
            .all(|s| predictor.predict(*s).is_valid())
    );
    let far = predictor.predict([1000.0, 0.0]);
    assert!(!far.is_valid() && far.outside_by_pm > 500.0, "{far:?}");
    assert!(!predictor.predict([f64::NAN, 0.0]).is_valid());
}

type Damage = fn(&mut MapArtefact);

#[test]
fn unsound_artefacts_are_refused() {
    let (_, fit) = bent(MapKind::ThinPlateConstant);
    let damages: [(&str, Damage); 8] = [
        ("version", |a| a.version = 2),
        ("alpha", |a| a.outputs[0].alpha.truncate(1)),
        ("beta", |a| a.outputs[1].beta.push(0.0)),
        ("nan weight", |a| a.outputs[0].alpha[0] = f64::NAN),
        ("scale", |a| a.scale_pm = 0.0),
        ("nugget", |a| a.outputs[0].nugget = -1.0),
        ("no readings", |a| a.training_pm.clear()),
        ("radius", |a| {
            a.outputs[0].kernel = wcal_gpr::Kernel::ThinPlate { radius: 0.5 }
        }),
    ];
    assert!(MapPredictor::new(&fit.artefact).is_ok());
    for (name, damage) in damages {
        let mut artefact = fit.artefact.clone();
        damage(&mut artefact);
        assert!(MapPredictor::new(&artefact).is_err(), "{name}");
    }
}

#[test]
fn unsound_training_sets_are_refused() {
    let good = Plant {
        bend: 0.0,
        noise_nmm: 0.02,
    }
    .draw(4, 2);
    let fit = |t: &MapTraining| fit_map(t, &FitOptions::default()).map(|f| f.artefact.name);
    let mut nan = good.clone();
    nan.shifts_pm[3][1] = f64::NAN;
    assert!(matches!(
        fit(&nan),
        Err(MapError::NotFinite {
            field: "shifts_pm",
            point: 3,
            ..
        })
    ));
    let mut short = good.clone();
    short.moments_nmm.pop();
    assert!(matches!(
        fit(&short),
        Err(MapError::Length {
            field: "moments_nmm",
            expected: 13,
            found: 12
        })
    ));
    assert!(matches!(
        fit(&MapTraining::default()),
        Err(MapError::TooFew { found: 0, .. })
    ));
    let mut line = good.clone();
    line.shifts_pm.iter_mut().for_each(|s| s[1] = 2.0 * s[0]);
    let options = FitOptions {
        candidates: vec![MapKind::Affine],
        ..FitOptions::default()
    };
    assert!(matches!(
        fit_map(&line, &options),
        Err(MapError::NoCandidate { .. })
    ));
}

#[test]
fn readings_of_one_pose_are_left_out_together() {
    let mut training = Plant {
        bend: 0.0,
        noise_nmm: 0.1,
    }
    .draw(6, 8);
    let n = training.len();
    // Every reading twice: left out alone, each would be predicted from its own copy.
    training.pose = (0..n as u32).chain(0..n as u32).collect();
    training.shifts_pm.extend_from_within(..);
    training.moments_nmm.extend_from_within(..);
    training.trajectory.extend_from_within(..);
    training.point.extend(n as i64..2 * n as i64);
    let options = FitOptions {
        candidates: vec![MapKind::Affine],
        ..FitOptions::default()
    };
    let together = fit_map(&training, &options).unwrap().candidates[0].loo[0].rmse_nmm;
    training.pose.clear();
    let separate = fit_map(&training, &options).unwrap().candidates[0].loo[0].rmse_nmm;
    assert!(together > 1.03 * separate, "{together} {separate}");
}
