//! The measured set: reference numbers of the released labels, the released map, the choice and its
//! warnings.

use crate::support::whiskerfbg;
use wcal_gpr::{FitOptions, MapPredictor, document, fit_map};

fn rmse(fit: &wcal_gpr::MapFit, name: &str) -> [f64; 2] {
    let candidate = fit.candidates.iter().find(|c| c.name == name).unwrap();
    candidate.loo.each_ref().map(|s| s.rmse_nmm)
}

#[test]
fn affine_map_leaves_the_reference_errors() {
    let training = whiskerfbg();
    assert_eq!(training.len(), 28);
    let fit = fit_map(&training, &FitOptions::default()).unwrap();
    // Computed independently of this code (numpy least squares and hat matrix): 0.497299, 0.242948
    // N mm.
    let affine = rmse(&fit, "affine");
    assert!(
        (affine[0] - 0.497_299).abs() < 1e-6 && (affine[1] - 0.242_948).abs() < 1e-6,
        "{affine:?}"
    );
    let quadratic = rmse(&fit, "quadratic");
    assert!(
        (quadratic[0] - 0.516_934).abs() < 1e-6 && (quadratic[1] - 0.259_581).abs() < 1e-6,
        "{quadratic:?}"
    );
    assert_eq!(fit.artefact.name, "affine");
}

#[test]
fn a_wrong_unit_of_one_reading_changes_the_reference_errors() {
    let mut training = whiskerfbg();
    training.shifts_pm[4][0] *= 1e-3;
    let fit = fit_map(&training, &FitOptions::default()).unwrap();
    assert!((rmse(&fit, "affine")[0] - 0.497_299).abs() > 1e-3);
}

#[test]
fn released_preset_reproduces_the_released_map() {
    let training = whiskerfbg();
    let options = FitOptions {
        released: true,
        ..FitOptions::default()
    };
    let fit = fit_map(&training, &options).unwrap();
    // Computed independently of this code (numpy, inverse of the covariance): 0.071802, 0.034524 of
    // scale. The covariance's condition number is 2e8, so six digits are what both sides can agree
    // on.
    let loo = rmse(&fit, "released").map(|e| e / 7.0);
    assert!(
        (loo[0] - 0.071_802).abs() < 2e-6 && (loo[1] - 0.034_524).abs() < 2e-6,
        "{loo:?}"
    );
    // It is affine in all but name, with slopes shrunk by the kernel's prior: numpy finds 0.17037
    // and 0.07740 N mm as the largest departures from least squares.
    let affine = fit_map(&training, &FitOptions::default()).unwrap();
    let (released, affine) = (
        MapPredictor::new(&fit.artefact).unwrap(),
        MapPredictor::new(&affine.artefact).unwrap(),
    );
    let mut largest = [0.0_f64; 2];
    for shift in &training.shifts_pm {
        let (a, b) = (released.mean_nmm(*shift), affine.mean_nmm(*shift));
        (0..2).for_each(|m| largest[m] = largest[m].max((a[m] - b[m]).abs()));
    }
    assert!(
        (largest[0] - 0.170_37).abs() < 1e-4 && (largest[1] - 0.077_40).abs() < 1e-4,
        "{largest:?}"
    );
}

#[test]
fn the_first_moment_is_named_as_barely_determined() {
    let training = whiskerfbg();
    let fit = fit_map(&training, &FitOptions::default()).unwrap();
    let found = document(&fit, &training, 27);
    assert_eq!(found.points, 27);
    assert_eq!(
        found.identifiability.warnings.len(),
        1,
        "{:?}",
        found.identifiability.warnings
    );
    let sentence = &found.identifiability.warnings[0];
    assert!(
        sentence.starts_with("The first moment is barely determined"),
        "{sentence}"
    );
    assert!(
        sentence.contains("0.50 N mm rms") && sentence.contains("0.58 N mm"),
        "{sentence}"
    );
    // numpy: singular values 89.002, 27.460 pm per N mm.
    let singular = fit.identifiability.singular_pm_per_nmm;
    assert!(
        (singular[0] - 89.002).abs() < 1e-3 && (singular[1] - 27.460).abs() < 1e-3,
        "{singular:?}"
    );
    assert!(!fit.identifiability.nearly_one_dimensional);
}

#[test]
fn labels_that_obey_the_wavelengths_give_no_warning() {
    let mut training = whiskerfbg();
    // Negative control: labels made from the readings by a law of the usual size (simulated).
    for (m, s) in training.moments_nmm.iter_mut().zip(&training.shifts_pm) {
        *m = [0.02 * s[0] - 0.01 * s[1], 0.005 * s[0] + 0.012 * s[1]];
    }
    training.moments_nmm[3][0] += 0.01;
    let fit = fit_map(&training, &FitOptions::default()).unwrap();
    assert_eq!(fit.identifiability.warnings, Vec::<String>::new());
}

#[test]
fn readings_on_a_line_are_named() {
    let mut training = whiskerfbg();
    for s in &mut training.shifts_pm {
        s[1] = 1.3 * s[0] + 0.02 * s[1];
    }
    let fit = fit_map(&training, &FitOptions::default()).unwrap();
    assert!(fit.identifiability.nearly_one_dimensional);
    assert!(
        fit.identifiability
            .warnings
            .iter()
            .any(|w| w.contains("nearly on a line"))
    );
}
