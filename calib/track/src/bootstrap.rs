//! Intervals of errors by bootstrap over whole sweeps and objects: samples of one sweep are no independent draws.
//!
//! The n units (objects, or the sweeps of one) are drawn with replacement, `RESAMPLES` times; the interval is from the quantile a to 1 - a of
//! the statistic, moved outward for few units (expanded percentiles):
//!
//! ```text
//! a = Phi(-t_{n-1}(0.975) sqrt(n / (n - 1)))
//! ```
//!
//! Sources: A. C. Davison, D. V. Hinkley, "Bootstrap Methods and their Application", 1997, 3.8; T. C. Hesterberg, "What Teachers Should Know
//! About the Bootstrap", The American Statistician 69 (2015) 371.

use crate::evaluate::ObjectScores;
use crate::score::{SquareSum, SweepSums};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Draws of an interval.
const RESAMPLES: usize = 2000;

/// Which error.
pub type ErrorOf = fn(&SweepSums) -> SquareSum;

/// 95 % interval of the RMSE over one object, mm: its sweeps are drawn again; none with fewer than two.
#[must_use]
pub fn object_interval95(sweeps: &[SweepSums], of: ErrorOf) -> Option<[f64; 2]> {
    let n = sweeps.len();
    interval95(n, |rng| resampled_rmse(sweeps, of, rng))
}

/// 95 % interval of the mean over objects of their RMSE, mm: whole objects are drawn again (A. C. Davison, D. V. Hinkley, "Bootstrap Methods
/// and their Application", 3.8); of one object its sweeps.
#[must_use]
pub fn mean_interval95(rows: &[ObjectScores], of: ErrorOf) -> Option<[f64; 2]> {
    if let [one] = rows {
        return object_interval95(&one.sweeps, of);
    }
    let each: Vec<f64> = rows.iter().map(|r| rmse_of(&r.sweeps, of)).collect();
    let n = each.len();
    interval95(n, |rng| (0..n).map(|_| each[rng.random_range(0..n)]).sum::<f64>() / n as f64)
}

/// 95 % interval of the largest RMSE of these objects, mm: sweeps are drawn again within each.
#[must_use]
pub fn worst_interval95(rows: &[&ObjectScores], of: ErrorOf) -> Option<[f64; 2]> {
    let least = rows.iter().map(|r| r.sweeps.len()).min()?;
    interval95(least, |rng| rows.iter().map(|r| resampled_rmse(&r.sweeps, of, rng)).fold(0.0, f64::max))
}

fn rmse_of(sweeps: &[SweepSums], of: ErrorOf) -> f64 {
    sweeps.iter().map(of).fold(SquareSum::default(), SquareSum::plus).rmse_mm()
}

fn resampled_rmse(sweeps: &[SweepSums], of: ErrorOf, rng: &mut ChaCha8Rng) -> f64 {
    let n = sweeps.len();
    (0..n).map(|_| of(&sweeps[rng.random_range(0..n)])).fold(SquareSum::default(), SquareSum::plus).rmse_mm()
}

/// Quantiles of `draw`, moved outward as `n` units ask for (T. C. Hesterberg, "What teachers should know about the bootstrap", 2015:
/// quantiles alone are too narrow by the factor between n and n - 1 and by that between normal and t).
fn interval95(n: usize, draw: impl Fn(&mut ChaCha8Rng) -> f64) -> Option<[f64; 2]> {
    if n < 2 {
        return None;
    }
    let mut rng = ChaCha8Rng::seed_from_u64(n as u64);
    let mut drawn: Vec<f64> = (0..RESAMPLES).map(|_| draw(&mut rng)).collect();
    drawn.sort_by(f64::total_cmp);
    let t = StudentsT::new(0.0, 1.0, (n - 1) as f64).ok()?.inverse_cdf(0.975);
    let share = Normal::standard().cdf(-t * (n as f64 / (n - 1) as f64).sqrt());
    let at = |share: f64| drawn[((RESAMPLES - 1) as f64 * share).round() as usize];
    Some([at(share), at(1.0 - share)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::score::{Detection, Scores};
    use rand_distr::{Distribution, LogNormal};

    fn object(rmse_mm: f64) -> ObjectScores {
        let sum = SquareSum { count: 10.0, squares_mm2: 10.0 * rmse_mm * rmse_mm };
        ObjectScores {
            name: String::new(),
            all: Scores::default(),
            followed: Scores::default(),
            detection: Detection::default(),
            sweeps: vec![SweepSums { surface: sum, ..SweepSums::default() }],
        }
    }

    /// Errors of ten objects from a skewed law; 400 repetitions scatter by 1.1 %.
    #[test]
    fn intervals_hold_the_mean_of_all_objects_nineteen_times_in_twenty() {
        let law = LogNormal::new(-1.5, 0.5).unwrap();
        let truth = (-1.5_f64 + 0.125).exp();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let (mut held, mut narrow) = (0, 0);
        for _ in 0..400 {
            let rows: Vec<ObjectScores> = (0..10).map(|_| object(law.sample(&mut rng))).collect();
            let [low, high] = mean_interval95(&rows, |s| s.surface).unwrap();
            held += usize::from(low <= truth && truth <= high);
            // Negative control: half as wide.
            let (middle, half) = ((low + high) / 2.0, (high - low) / 4.0);
            narrow += usize::from((truth - middle).abs() <= half);
        }
        assert!((364..=396).contains(&held), "{held} of 400");
        assert!(narrow < 330, "{narrow} of 400");
    }

    #[test]
    fn sweeps_stay_whole() {
        // Two sweeps, one good and one bad: every draw is one of three values, however many samples they have.
        let good =
            SweepSums { surface: SquareSum { count: 1e6, squares_mm2: 1e6 * 0.01 }, ..SweepSums::default() };
        let bad =
            SweepSums { surface: SquareSum { count: 1e6, squares_mm2: 1e6 * 4.0 }, ..SweepSums::default() };
        let [low, high] = object_interval95(&[good, bad], |s| s.surface).unwrap();
        assert!((low - 0.1).abs() < 1e-9 && (high - 2.0).abs() < 1e-9, "{low} {high}");
        assert_eq!(object_interval95(&[good], |s| s.surface), None, "one sweep says nothing of its like");
    }
}
