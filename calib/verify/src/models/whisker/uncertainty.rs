//! How uncertain an inferred moment is.
//!
//! The inverse `m = f(y; B, v)` has the uncertainty of its noise and of everything that was fitted
//! (GUM 5.2.2, correlated inputs): `cov(m) = K^-1 (s^2 I) K^-T + G C G'`, `G = [dm/dB, dm/dv]`,
//! `dm/dB_(c,k) = -K^-1 e_c c_k`, `dm/dv` by differences over the whole history (memory carries a
//! value's error from reading to reading), `C` the joint covariance of `B` (channel by channel) and
//! `v`.

use super::physical::{PhysicalModel, undo_memory};
use super::whisker_effect::ActiveEffect;
use crate::whisker::path::WhiskerPath;
use nalgebra::{DMatrix, Matrix2};

/// Step of the differences by a nonlinear value, in its standard deviations.
pub(super) const VALUE_STEP: f64 = 0.1;

impl PhysicalModel {
    /// The nonlinear values that have a covariance, in its order after the coefficients: place in
    /// it and standard deviation. Files of before these were stored have none.
    pub(super) fn uncertain_values(&self) -> Vec<(usize, f64)> {
        (2 * self.coefficients.len()..self.covariance.len())
            .map(|k| (k, self.covariance[k][k].max(0.0).sqrt()))
            .filter(|(_, sd)| *sd > 0.0)
            .collect()
    }

    /// How each reading's moment moves with everything that was fitted, N mm per unit of it: two
    /// rows a reading, coefficients channel by channel and then the values of
    /// [`Self::uncertain_values`] (those without a covariance stay 0). And what a reading must
    /// exceed to show anything: standard deviations by noise and coefficients, N mm.
    pub(super) fn gradients(
        &self,
        terms: &[ActiveEffect],
        path: &WhiskerPath,
        sensed: &[[f64; 2]],
        inverse: &Matrix2<f64>,
        noise_sd_pm: &[f64],
    ) -> (Vec<DMatrix<f64>>, Vec<[f64; 2]>) {
        let columns = self.columns(terms, path, sensed);
        let mut gradients: Vec<DMatrix<f64>> = (0..sensed.len())
            .map(|i| {
                let row: Vec<f64> = columns.iter().map(|c| c[i]).collect();
                self.of_coefficients(inverse, &row)
            })
            .collect();
        let visible: Vec<[f64; 2]> = gradients
            .iter()
            .zip(noise_sd_pm)
            .map(|(g, s)| self.sd_nmm(inverse, g, *s))
            .collect();
        // Central differences through the whole history: memory carries a value's error from
        // reading to reading.
        for (place, sd) in self.uncertain_values() {
            let step = VALUE_STEP * sd;
            let [low, high] = [-step, step].map(|by| {
                let moved = self.terms_moved(Some((place, by)));
                undo_memory(&moved, path, &self.sensed(&moved, path, inverse), &visible)
            });
            for (i, g) in gradients.iter_mut().enumerate() {
                for c in 0..2 {
                    g[(c, place)] = (high[i][c] - low[i][c]) / (2.0 * step);
                }
            }
        }
        (gradients, visible)
    }

    /// The part of a gradient that the coefficients make, from the readout's columns at the
    /// reading.
    pub(super) fn of_coefficients(&self, inverse: &Matrix2<f64>, row: &[f64]) -> DMatrix<f64> {
        let q = self.coefficients.len();
        let mut g = DMatrix::zeros(2, self.covariance.len());
        // m = K^-1 (y - B u): a coefficient moves the moment by -K^-1 e_c u_k.
        for c in 0..2 {
            for (k, u) in row.iter().enumerate() {
                g.fixed_view_mut::<2, 1>(0, c * q + k)
                    .copy_from(&(-inverse.column(c) * *u));
            }
        }
        g
    }

    /// Standard deviations of a moment, N mm: noise and everything that was fitted.
    pub(super) fn sd_nmm(
        &self,
        inverse: &Matrix2<f64>,
        gradient: &DMatrix<f64>,
        noise_sd_pm: f64,
    ) -> [f64; 2] {
        // Noise of the wavelengths through the inverse, then g' C g of what was fitted (GUM 5.2.2).
        let noise = inverse * inverse.transpose() * noise_sd_pm.powi(2);
        [0, 1].map(|c| {
            let g = gradient.row(c);
            let mut variance = noise[(c, c)];
            for (gi, row) in g.iter().zip(&self.covariance) {
                if *gi != 0.0 {
                    variance += gi * row.iter().zip(g.iter()).map(|(v, gj)| v * gj).sum::<f64>();
                }
            }
            variance.max(0.0).sqrt()
        })
    }
}
