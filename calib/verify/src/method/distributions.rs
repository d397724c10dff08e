//! Tails of the distributions that tests are judged by. Degrees of freedom that are none have no
//! tail: what rests on them cannot be judged.
//!
//! ```text
//! s sqrt(nu / chi2_(0.975, nu)) .. s sqrt(nu / chi2_(0.025, nu))          95 % interval of a standard deviation s with nu degrees of freedom
//! ```

use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};

/// Chance of a larger F with these degrees of freedom; none where they are none.
pub(crate) fn f_tail(f: f64, [extra, left]: [f64; 2]) -> Option<f64> {
    let enough = extra >= 0.5 && left >= 0.5;
    let law = FisherSnedecor::new(extra, left).ok().filter(|_| enough)?;
    (!f.is_nan()).then(|| law.sf(f.max(0.0)))
}

/// Chance of a larger chi-squared; none where the degrees of freedom are none.
pub(crate) fn chi_squared_tail(statistic: f64, dof: f64) -> Option<f64> {
    let law = ChiSquared::new(dof).ok().filter(|_| dof >= 0.5)?;
    (!statistic.is_nan()).then(|| law.sf(statistic.max(0.0)))
}

/// Chi-squared with `dof` degrees of freedom that is undercut with probability `level`; none where
/// they are none.
pub(crate) fn chi_squared_quantile(level: f64, dof: f64) -> Option<f64> {
    Some(
        ChiSquared::new(dof)
            .ok()
            .filter(|_| dof >= 0.5)?
            .inverse_cdf(level),
    )
}

/// 95 % interval of a standard deviation that is `sd` by `dof` degrees of freedom, in its unit;
/// none where they are none.
pub(crate) fn sd_interval95(sd: f64, dof: f64) -> Option<[f64; 2]> {
    let end = |level: f64| Some(sd * (dof / chi_squared_quantile(level, dof)?).sqrt());
    Some([end(0.975)?, end(0.025)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::NORMAL_95;
    use rand::SeedableRng;
    use rand_distr::Distribution;

    #[test]
    fn the_interval_of_a_standard_deviation_holds_it() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for dof in [2.0_f64, 3.0, 4.0, 6.0, 40.0] {
            let chi = rand_distr::ChiSquared::new(dof).unwrap();
            let (mut held, mut plain) = (0, 0);
            for _ in 0..2000 {
                let sd = f64::sqrt(chi.sample(&mut rng) / dof);
                let [low, high] = sd_interval95(sd, dof).unwrap();
                held += usize::from((low..high).contains(&1.0));
                // Control: the interval of a Gaussian with the same standard error.
                let half = NORMAL_95 / (2.0 * dof).sqrt();
                plain += usize::from((sd * (1.0 - half)..sd * (1.0 + half)).contains(&1.0));
            }
            // 1,900 +- 10 expected (binomial standard deviation).
            assert!((1860..=1940).contains(&held), "{dof}: {held}");
            assert!(plain < 1860 || dof > 10.0, "{dof}: {plain}");
        }
    }

    #[test]
    fn what_has_no_degrees_of_freedom_is_not_judged() {
        for dof in [0.0, -1.0, f64::NAN] {
            assert_eq!(
                (f_tail(3.0, [2.0, dof]), f_tail(3.0, [dof, 9.0])),
                (None, None),
                "{dof}"
            );
            assert_eq!(chi_squared_tail(3.0, dof), None, "{dof}");
        }
        // Control: textbook values.
        assert!((f_tail(4.256, [2.0, 9.0]).unwrap_or(0.0) - 0.05).abs() < 1e-3);
        assert!((chi_squared_tail(3.841, 1.0).unwrap_or(0.0) - 0.05).abs() < 1e-4);
    }
}
