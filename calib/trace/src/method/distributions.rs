//! Tails of the distributions that tests are judged by. Degrees of freedom that are none have no tail: what rests on them cannot be judged.

use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};

/// Chance of a larger F with these degrees of freedom; none where they are none.
pub fn f_tail(f: f64, [extra, left]: [f64; 2]) -> Option<f64> {
    let enough = extra >= 0.5 && left >= 0.5;
    let law = FisherSnedecor::new(extra, left).ok().filter(|_| enough)?;
    (!f.is_nan()).then(|| law.sf(f.max(0.0)))
}

/// Chance of a larger chi-squared; none where the degrees of freedom are none.
pub fn chi_squared_tail(statistic: f64, dof: f64) -> Option<f64> {
    let law = ChiSquared::new(dof).ok().filter(|_| dof >= 0.5)?;
    (!statistic.is_nan()).then(|| law.sf(statistic.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_degrees_of_freedom_is_not_judged() {
        for dof in [0.0, -1.0, f64::NAN] {
            assert_eq!((f_tail(3.0, [2.0, dof]), f_tail(3.0, [dof, 9.0])), (None, None), "{dof}");
            assert_eq!(chi_squared_tail(3.0, dof), None, "{dof}");
        }
        // Control: textbook values.
        assert!((f_tail(4.256, [2.0, 9.0]).unwrap_or(0.0) - 0.05).abs() < 1e-3);
        assert!((chi_squared_tail(3.841, 1.0).unwrap_or(0.0) - 0.05).abs() < 1e-4);
    }
}
