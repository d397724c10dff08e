//! What chance alone would give: min-p over all signatures under white Gaussian noise, simulated in their joint span.

use super::linear::Basis;
use super::options::Options;
use super::signature::Signature;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal, StudentT};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// p-value of a fall `gain` of the sum of squares `ssr` (with `dof` degrees of freedom) for `d` more.
#[must_use]
pub fn f_test(gain: f64, ssr: f64, dof: f64, d: usize) -> f64 {
    let d = d as f64;
    let left = dof - d;
    if gain <= 0.0 || left < 1.0 {
        return 1.0;
    }
    let f = (gain / d) / ((ssr - gain).max(1e-12 * ssr) / left);
    if !f.is_finite() {
        return if f == f64::INFINITY { 1e-300 } else { 1.0 };
    }
    FisherSnedecor::new(d, left).map_or(1.0, |dist| dist.sf(f)).max(1e-300)
}

/// p-value of an signature on a residual; one-sided laws use half the F tail.
#[must_use]
pub fn signature_p(signature: &Signature, gain: f64, ssr: f64, dof: f64) -> f64 {
    let p = f_test(gain, ssr, dof, signature.dimension());
    if signature.one_sided { 0.5 * p } else { p }
}

/// Distribution of the smallest p over a family of signatures under the null.
#[derive(Debug, Clone)]
pub struct MinPDistribution {
    /// Smallest p of each draw, ascending.
    minima: Vec<f64>,
}

impl MinPDistribution {
    /// Simulates `draws` null residuals for `signatures`; only their coordinates in the joint span and the norm of the rest matter.
    #[must_use]
    pub fn simulate(signatures: &[&Signature], dof: f64, options: &Options) -> Self {
        let mut span = Basis::default();
        for signature in signatures {
            for q in &signature.directions {
                if (span.rank() as f64) < dof - 2.0 {
                    span.push(q);
                }
            }
        }
        let rank = span.rank();
        let reduced: Vec<(DMatrix<f64>, Option<DVector<f64>>)> = signatures
            .iter()
            .map(|a| {
                let rows: Vec<_> = a.directions.iter().map(|q| span.coordinates(q).transpose()).collect();
                let sign = a.one_sided.then(|| span.coordinates(&a.projected[0]));
                (DMatrix::from_rows(&rows), sign)
            })
            .collect();
        let rest = (dof - rank as f64).max(1.0);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
        let chi = ChiSquared::new(rest).ok();
        let heavy = options.tails_dof.and_then(|nu| StudentT::new(nu).ok());
        let mut draw = || -> (DVector<f64>, f64) {
            match &heavy {
                None => {
                    let z = DVector::from_fn(rank, |_, _| -> f64 { StandardNormal.sample(&mut rng) });
                    let ssr = z.norm_squared() + chi.map_or(rest, |c| c.sample(&mut rng));
                    (z, ssr)
                }
                // Heavy tails are not the same in every direction: whole readings are drawn.
                Some(t) => {
                    let size = span.vectors().first().map_or(0, DVector::len);
                    let whole = DVector::from_fn(size, |_, _| -> f64 { t.sample(&mut rng) });
                    let z = span.coordinates(&whole);
                    let off = (whole.norm_squared() - z.norm_squared()).max(0.0);
                    let ssr = z.norm_squared() + off * rest / (size as f64 - rank as f64).max(1.0);
                    (z, ssr)
                }
            }
        };
        let mut minima: Vec<f64> = (0..options.draws)
            .map(|_| {
                let (z, ssr) = draw();
                let mut best: f64 = 1.0;
                for (signature, (q, sign)) in signatures.iter().zip(&reduced) {
                    if sign.as_ref().is_some_and(|s| s.dot(&z) <= 0.0) {
                        continue;
                    }
                    let gain = (q * &z).norm_squared();
                    // The tail is dear to compute: skip what cannot be small.
                    if gain * dof / ssr < 2.0 * signature.dimension() as f64 {
                        continue;
                    }
                    best = best.min(signature_p(signature, gain, ssr, dof));
                }
                best
            })
            .collect();
        minima.sort_by(f64::total_cmp);
        Self { minima }
    }

    /// Single p-value that the family's smallest undercuts with probability `level` under the null.
    #[must_use]
    pub fn critical(&self, level: f64) -> f64 {
        let k = ((level * self.minima.len() as f64) as usize).min(self.minima.len().saturating_sub(1));
        self.minima.get(k).copied().unwrap_or(level).min(level)
    }

    /// Family-wise p-value of a smallest single p; past the draws' resolution by the effective number of tests.
    #[must_use]
    pub fn adjusted(&self, p: f64) -> f64 {
        let draws = self.minima.len();
        if draws == 0 {
            return 1.0;
        }
        let below = self.minima.partition_point(|m| *m <= p);
        if below >= 10 {
            return (below as f64 + 1.0) / (draws as f64 + 1.0);
        }
        let k = (draws / 50).max(1);
        let tests = ((k as f64 + 1.0) / (draws as f64 + 1.0)) / self.minima[k - 1].max(1e-300);
        (p * tests.max(1.0)).min((below as f64 + 1.0) / (draws as f64 + 1.0))
    }
}
