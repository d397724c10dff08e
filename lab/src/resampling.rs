//! The bootstrap: what a statistic would have been on units drawn again, with replacement, from
//! those that there are.
//!
//! A unit is what is independent: a group of readings, a sweep, an object. With replicates t*_1 <=
//! ... <= t*_B the percentile interval is [t*_(0.025 B), t*_(0.975 B)]. For few units n it is too
//! narrow by sqrt((n - 1) / n) and by the ratio of normal to Student quantiles; the expanded
//! percentile interval takes the shares Phi(-+ t_(0.975, n - 1) sqrt(n / (n - 1))) instead.
//!
//! Source: A. C. Davison & D. V. Hinkley, "Bootstrap Methods and their Application" (1997), ch. 2
//! and 3.8; T. C. Hesterberg, "What teachers should know about the bootstrap", Amer. Statist. 69
//! (2015).

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Values of `statistic`, one a draw, in order; the same for the same seed.
pub(crate) fn replicates<T>(
    draws: usize,
    seed: u64,
    mut statistic: impl FnMut(&mut ChaCha8Rng) -> T,
) -> Vec<T> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..draws).map(|_| statistic(&mut rng)).collect()
}

/// `units` numbers below `units`, drawn with replacement.
pub(crate) fn redrawn<R: Rng>(units: usize, rng: &mut R) -> impl Iterator<Item = usize> + '_ {
    (0..units).map(move |_| rng.random_range(0..units))
}

/// Central 95 % of the replicates, wider as few `units` ask for; none for fewer than two.
pub(crate) fn expanded_interval95(replicates: Vec<f64>, units: usize) -> Option<[f64; 2]> {
    let n = units as f64;
    let t = StudentsT::new(0.0, 1.0, n - 1.0)
        .ok()
        .filter(|_| units > 1)?
        .inverse_cdf(0.975);
    interval(
        replicates,
        Normal::standard().cdf(-t * (n / (n - 1.0)).sqrt()),
    )
}

/// From the quantile `share` to that of `1 - share`.
fn interval(mut replicates: Vec<f64>, share: f64) -> Option<[f64; 2]> {
    replicates.sort_by(f64::total_cmp);
    let last = replicates.len().checked_sub(1)?;
    let at = |share: f64| replicates[(last as f64 * share).round() as usize];
    Some([at(share), at(1.0 - share)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The mean of n values has the standard deviation sd / sqrt(n); both intervals are held
    /// against it.
    #[test]
    fn the_intervals_of_a_mean_are_those_of_theory() {
        let values: Vec<f64> = (0..200).map(|k| (f64::from(k) * 0.7).sin()).collect();
        let n = values.len();
        let mean = values.iter().sum::<f64>() / n as f64;
        let sd = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
        let means = |of: usize| {
            replicates(4000, 3, |rng| {
                redrawn(of, rng).map(|k| values[k]).sum::<f64>() / of as f64
            })
        };
        let [low, high] = interval(means(n), 0.025).unwrap();
        let exact = 2.0 * 1.96 * sd / (n as f64).sqrt();
        assert!(
            ((high - low) / exact - 1.0).abs() < 0.06,
            "{low} {high} {exact}"
        );
        // Of five units the interval must be wider than its quantiles; two hundred hardly ask for
        // it.
        let wider = |of: usize| {
            let [a, b] = expanded_interval95(means(of), of).unwrap();
            let [low, high] = interval(means(of), 0.025).unwrap();
            (b - a) / (high - low)
        };
        assert!(
            wider(5) > 1.3 && (1.0..1.1).contains(&wider(n)),
            "{} {}",
            wider(5),
            wider(n)
        );
    }

    #[test]
    fn nothing_has_no_interval_and_a_seed_decides_all() {
        assert_eq!(interval(Vec::new(), 0.025), None);
        assert_eq!(expanded_interval95(vec![1.0, 2.0], 1), None);
        let draw = |seed| replicates(3, seed, |rng| redrawn(10, rng).collect::<Vec<_>>());
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2), "control");
    }
}
