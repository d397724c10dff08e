//! Quantiles and densities of standardised errors: Student t with known degrees of freedom, or
//! normal.
//!
//! An error over its estimated scale with nu degrees of freedom follows t_nu; its central 95 % are
//! +- t_(0.975, nu), 1.960 for a known scale. Of n trials with success p the counts k with P(X <=
//! k) > 0.025 and P(X >= k) > 0.025 are not contradicted at 5 % (C. Clopper & E. Pearson,
//! Biometrika 26, 1934).

use statrs::distribution::{Binomial, Continuous, ContinuousCDF, DiscreteCDF, Normal, StudentsT};

/// Half width of a central 95 % interval in standard deviations (the t scale, not the t standard
/// deviation).
pub fn half95(dof: Option<f64>) -> f64 {
    // Past a million degrees of freedom it is the normal distribution's to 2e-6, and the search for
    // it takes minutes.
    match dof
        .filter(|nu| *nu <= 1e6)
        .and_then(|nu| StudentsT::new(0.0, 1.0, nu).ok())
    {
        Some(t) => t.inverse_cdf(0.975),
        None => 1.959_963_984_540_054,
    }
}

/// Probability of a standardised error as large, to either side.
pub(crate) fn two_sided(z: f64, dof: Option<f64>) -> f64 {
    2.0 * match dof.and_then(|nu| StudentsT::new(0.0, 1.0, nu).ok()) {
        Some(t) => t.sf(z.abs()),
        None => Normal::standard().sf(z.abs()),
    }
}

/// Log density of a standardised error.
pub(crate) fn log_density(z: f64, dof: Option<f64>) -> f64 {
    match dof.and_then(|nu| StudentsT::new(0.0, 1.0, nu).ok()) {
        Some(t) => t.ln_pdf(z),
        None => Normal::standard().ln_pdf(z),
    }
}

/// Smallest and largest count of `n` trials that a success rate of `p` does not contradict at the
/// two-sided 5 % level.
pub fn binomial_bounds(n: usize, p: f64) -> [usize; 2] {
    let Ok(law) = Binomial::new(p, n as u64) else {
        return [0, n];
    };
    // Counts with more than 2.5 % on either side.
    let low = (0..=n).find(|k| law.cdf(*k as u64) > 0.025).unwrap_or(0);
    let high = (0..=n).find(|k| law.cdf(*k as u64) >= 0.975).unwrap_or(n);
    [low, high]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_agree_with_tables() {
        assert!((half95(Some(25.0)) - 2.059_539).abs() < 1e-5);
        assert!((half95(None) - 1.959_964).abs() < 1e-6);
    }

    #[test]
    fn bounds_of_28_trials_at_95_percent() {
        assert_eq!(binomial_bounds(28, 0.95), [24, 28]);
    }
}
