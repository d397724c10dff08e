//! The thin-plate kernel: where it is positive definite, what its radius does, and what is refused.

use nalgebra::DMatrix;
use proptest::prelude::*;
use wcal_gpr::{
    Kernel, MapError, Process, ProcessModel, Trend, choose_hyperparameters, log_evidence,
};

fn smallest_eigenvalue(radius: f64, inputs: &[[f64; 2]]) -> f64 {
    let k: DMatrix<f64> = Kernel::ThinPlate { radius }.matrix(inputs);
    k.symmetric_eigenvalues().min()
}

fn largest_distance(inputs: &[[f64; 2]]) -> f64 {
    let pairs = inputs
        .iter()
        .flat_map(|a| inputs.iter().map(move |b| (a[0] - b[0]).hypot(a[1] - b[1])));
    pairs.fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn positive_definite_from_1_34_times_the_largest_distance(
        inputs in prop::collection::vec([-1.0..1.0_f64, -1.0..1.0_f64], 3..40),
        factor in 1.34..20.0_f64,
    ) {
        let d = largest_distance(&inputs);
        prop_assume!(d > 1e-3);
        // Rounding of n entries near 1 is all that may be below zero.
        prop_assert!(smallest_eigenvalue(factor * d, &inputs) > -1e-13 * inputs.len() as f64);
    }
}

#[test]
fn a_filled_disk_shows_that_a_small_radius_is_not_positive_definite() {
    // 29 grid points in a disk of diameter 1. numpy: smallest eigenvalue -0.0920 at R = 0.8,
    // 6.45e-4 at R = 1.34.
    let steps = || (-3..=3).map(|i| f64::from(i) / 6.0);
    let disk: Vec<[f64; 2]> = steps()
        .flat_map(|x| steps().map(move |y| [x, y]))
        .filter(|p| p[0].hypot(p[1]) <= 0.5 + 1e-12)
        .collect();
    assert_eq!(disk.len(), 29);
    assert!((smallest_eigenvalue(0.8, &disk) + 0.0920).abs() < 1e-3);
    assert!((smallest_eigenvalue(1.34, &disk) - 6.45e-4).abs() < 1e-5);
    let zero = vec![0.0; disk.len()];
    let model = ProcessModel {
        trend: Trend::Zero,
        kernel: Kernel::ThinPlate { radius: 0.8 },
        nugget: 1e-9,
        fixed_variance: Some(1.0),
    };
    assert_eq!(
        Process::fit(model, &disk, &zero).unwrap_err(),
        MapError::NotPositiveDefinite {
            readings: disk.len()
        }
    );
}

#[test]
fn with_an_affine_mean_the_radius_cancels() {
    let training = crate::support::Plant {
        bend: 0.3,
        noise_nmm: 0.02,
    }
    .draw(9, 4);
    let inputs: Vec<[f64; 2]> = training
        .shifts_pm
        .iter()
        .map(|s| s.map(|v| v / 60.0))
        .collect();
    let y = training.moment_nmm(0);
    let fit = |radius: f64| {
        let kernel = Kernel::ThinPlate { radius };
        let model = choose_hyperparameters(Trend::Affine, kernel, None, &inputs, &y).unwrap();
        (
            Process::fit(model, &inputs, &y).unwrap(),
            log_evidence(&model, &inputs, &y).unwrap(),
        )
    };
    let ((a, ea), (b, eb)) = (fit(8.0), fit(24.0));
    // The noise ratio is searched to about 1e-4 of a decade, so agreement is to that, not to
    // rounding.
    assert!((ea - eb).abs() < 1e-5, "{ea} {eb}");
    for z in [[0.0, 0.0], [0.7, -0.4], [-1.0, 1.2]] {
        let ((ma, sa, _), (mb, sb, _)) = (a.predict(z), b.predict(z));
        assert!(
            (ma - mb).abs() < 1e-4 && (sa - sb).abs() < 1e-4 * sa,
            "{z:?}: {ma} {mb} {sa} {sb}"
        );
    }
    // Negative control: about a constant mean the radius matters.
    let constant = |radius: f64| {
        let model = ProcessModel {
            trend: Trend::Constant,
            kernel: Kernel::ThinPlate { radius },
            nugget: 1e-3,
            fixed_variance: None,
        };
        log_evidence(&model, &inputs, &y).unwrap()
    };
    assert!((constant(8.0) - constant(24.0)).abs() > 0.1);
}
