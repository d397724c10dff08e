//! Pure error from readings that agree in every setting, and the lack of fit of a model against it.
//!
//! ```text
//! S_pure = sum over settings, sum over their readings of (r - mean)^2,   F = ((S - S_pure) / d) / (S_pure / d_pure)
//! ```

use super::distributions::f_tail;
use crate::levels::REPLICATES;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Pure error from readings of one stimulus, and lack of fit against it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LackOfFit {
    /// Standard deviation of readings of one stimulus.
    pub pure_sd: f64,
    /// Degrees of freedom of the pure error.
    pub pure_dof: f64,
    /// F of the rest of the misfit.
    pub f: f64,
    /// Its degrees of freedom.
    pub dof: f64,
    /// p-value; null where nothing is left to test.
    pub p_value: Option<f64>,
}

impl LackOfFit {
    /// Of the sums of squares within settings and between them, each with its degrees of freedom; none without pure error.
    pub fn against([pure, pure_dof]: [f64; 2], [rest, dof]: [f64; 2]) -> Option<Self> {
        if pure_dof < 1.0 || !(pure > 0.0) {
            return None;
        }
        let pure_variance = pure / pure_dof;
        let f = (rest.max(0.0) / dof.max(1.0)) / pure_variance;
        Some(Self { pure_sd: pure_variance.sqrt(), pure_dof, f, dof, p_value: f_tail(f, [dof, pure_dof]) })
    }

    /// Repeats contradict the model.
    pub fn is_significant(&self) -> bool {
        self.p_value.is_some_and(|p| p < REPLICATES)
    }
}

/// Splits the misfit of a model with `parameters` free values. `keys` groups replicates; rows with weight 0 do not count.
/// None where nothing was repeated.
pub fn lack_of_fit(residual: &[f64], keys: &[u64], weights: &[f64], parameters: usize) -> Option<LackOfFit> {
    let mut rows: Vec<usize> = (0..residual.len()).filter(|&i| weights[i] > 0.0).collect();
    rows.sort_by_key(|&i| keys[i]);
    let (mut pure, mut levels) = (0.0, 0usize);
    for group in rows.chunk_by(|&a, &b| keys[a] == keys[b]) {
        // Weighted mean of the unweighted residuals: the weighted residual of one stimulus has one weight.
        let mean = group.iter().map(|&i| residual[i]).sum::<f64>() / group.len() as f64;
        pure += group.iter().map(|&i| (residual[i] - mean).powi(2)).sum::<f64>();
        levels += 1;
    }
    let pure_dof = (rows.len() - levels) as f64;
    let dof = levels as f64 - parameters as f64;
    let total: f64 = rows.iter().map(|&i| residual[i].powi(2)).sum();
    LackOfFit::against([pure, pure_dof], [total - pure, dof])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lack_of_fit_rises_when_a_level_is_moved() {
        let keys: Vec<u64> = (0..12).map(|k| k / 3).collect();
        let noise = [0.1, -0.1, 0.0];
        let fair: Vec<f64> = (0..12).map(|k| noise[k % 3]).collect();
        let moved: Vec<f64> = (0..12).map(|k| noise[k % 3] + if k / 3 == 1 { 1.0 } else { 0.0 }).collect();
        let good = lack_of_fit(&fair, &keys, &[1.0; 12], 2).unwrap();
        let bad = lack_of_fit(&moved, &keys, &[1.0; 12], 2).unwrap();
        assert!(good.p_value > Some(0.5) && bad.p_value < Some(1e-4), "{good:?} {bad:?}");
    }
}
