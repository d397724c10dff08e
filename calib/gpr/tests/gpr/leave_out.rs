//! Closed-form leave-out errors against refits, and the restricted likelihood against its
//! definition.

use crate::support::Plant;
use nalgebra::{Cholesky, DMatrix, DVector};
use wcal_gpr::{Kernel, Process, ProcessModel, Trend, log_evidence};

fn cases() -> Vec<ProcessModel> {
    let model = |trend, kernel, nugget, fixed_variance| ProcessModel {
        trend,
        kernel,
        nugget,
        fixed_variance,
    };
    vec![
        model(Trend::Affine, Kernel::None, 1.0, None),
        model(Trend::Quadratic, Kernel::None, 1.0, None),
        model(Trend::Affine, Kernel::ThinPlate { radius: 9.0 }, 1e-3, None),
        model(
            Trend::Constant,
            Kernel::ThinPlate { radius: 9.0 },
            1e-3,
            None,
        ),
        model(
            Trend::Constant,
            Kernel::Matern52 { length: 2.0 },
            1e-2,
            None,
        ),
        model(
            Trend::Zero,
            Kernel::Matern52 { length: 2.0 },
            1e-2,
            Some(0.5),
        ),
    ]
}

fn data() -> (Vec<[f64; 2]>, Vec<f64>) {
    let training = Plant {
        bend: 0.3,
        noise_nmm: 0.05,
    }
    .draw(7, 11);
    (
        training
            .shifts_pm
            .iter()
            .map(|s| s.map(|v| v / 60.0))
            .collect(),
        training.moment_nmm(0),
    )
}

#[test]
fn closed_form_equals_refits_without_the_group() {
    let (inputs, y) = data();
    let groups: Vec<Vec<usize>> = vec![vec![0], vec![1, 2], (3..8).collect(), vec![21]];
    for model in cases() {
        let fit = Process::fit(model, &inputs, &y).unwrap();
        let left = fit.leave_out(&groups);
        assert_eq!(left.len(), 9);
        for group in &groups {
            let keep: Vec<usize> = (0..y.len()).filter(|i| !group.contains(i)).collect();
            let kept: Vec<[f64; 2]> = keep.iter().map(|i| inputs[*i]).collect();
            let rest: Vec<f64> = keep.iter().map(|i| y[*i]).collect();
            let brute = Process::fit(model, &kept, &rest).unwrap();
            for e in left.iter().filter(|e| group.contains(&e.index)) {
                let (mean, _, variance) = brute.predict(inputs[e.index]);
                assert!(
                    (y[e.index] - mean - e.error).abs() < 1e-9,
                    "{model:?}: {e:?}"
                );
                assert!(
                    (variance.sqrt() / e.sd - 1.0).abs() < 1e-7,
                    "{model:?}: {e:?} {}",
                    variance.sqrt()
                );
                assert_eq!(e.dof, brute.dof);
            }
        }
    }
}

#[test]
fn a_shifted_label_changes_its_left_out_error_by_the_shift() {
    let (inputs, mut y) = data();
    let model = cases()[2];
    let error = |y: &[f64]| {
        Process::fit(model, &inputs, y)
            .unwrap()
            .leave_out(&[vec![5]])[0]
            .error
    };
    let before = error(&y);
    y[5] += 0.1;
    assert!((error(&y) - before - 0.1).abs() < 1e-10);
}

#[test]
fn tridiagonal_evidence_equals_its_definition() {
    let (inputs, y) = data();
    for model in cases().into_iter().filter(|m| m.fixed_variance.is_none()) {
        let n = y.len();
        let mut c = model.kernel.matrix(&inputs);
        (0..n).for_each(|i| c[(i, i)] += model.nugget);
        let h = model.trend.matrix(&inputs);
        let y = DVector::from_column_slice(&y);
        let chol = Cholesky::new(c).unwrap();
        let a = h.transpose() * chol.solve(&h);
        let beta = a.clone().try_inverse().unwrap() * h.transpose() * chol.solve(&y);
        let residual = &y - &h * beta;
        let free = (n - h.ncols()) as f64;
        let variance = residual.dot(&chol.solve(&residual)) / free;
        let log_det = |m: &DMatrix<f64>| m.clone().symmetric_eigenvalues().map(f64::ln).sum();
        let expected = -0.5
            * (free * ((2.0 * std::f64::consts::PI * variance).ln() + 1.0)
                + 2.0 * chol.l().diagonal().map(f64::ln).sum()
                + log_det(&a)
                - log_det(&(h.transpose() * &h)));
        let found = log_evidence(&model, &inputs, y.as_slice()).unwrap();
        assert!(
            (found - expected).abs() < 1e-7,
            "{model:?}: {found} {expected}"
        );
    }
}
