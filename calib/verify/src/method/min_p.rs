//! What chance alone would give: min-p over all signatures under white Gaussian noise, simulated in
//! their joint span.
//!
//! ```text
//! F = (gain / d) / ((S - gain) / (dof - d)),   p = P(F_(d, dof - d) > F)
//! draw: S = |z|^2 + chi^2_(dof - rank),        gain = |D' z|^2 with z ~ N(0, I) in the joint span, D a signature's directions
//! ```

use super::distributions::f_tail;
use super::fit::Fit;
use super::linear::JointSpan;
use super::options::Options;
use super::signature::Signature;
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution, StandardNormal, StudentT};
use std::sync::{Arc, OnceLock};

/// Draws that are projected together.
const BATCH: usize = 250;

/// p-value of a fall `gain` of the sum of squares `ssr` (with `dof` degrees of freedom) for `d`
/// more; none where no degrees of freedom are left.
pub fn f_test(gain: f64, ssr: f64, dof: f64, d: usize) -> Option<f64> {
    let d = d as f64;
    let left = dof - d;
    // The residual of the larger model estimates the variance: F(d, dof - d) under the null of
    // Gaussian noise.
    let f = (gain / d) / ((ssr - gain).max(1e-12 * ssr) / left);
    if left < 1.0 {
        return None;
    }
    // Where nothing remains before, nothing is gained.
    f_tail(if f.is_nan() { 0.0 } else { f.min(1e200) }, [d, left]).map(|p| p.max(1e-300))
}

/// p-value of an signature on a residual, none where no degrees of freedom are left; one-sided laws
/// use half the F tail.
pub fn signature_p(signature: &Signature, gain: f64, ssr: f64, dof: f64) -> Option<f64> {
    // Under the null either sign is equally likely, and one of them is not admissible: half the
    // tail remains.
    let p = f_test(gain, ssr, dof, signature.dimension())?;
    Some(if signature.one_sided { 0.5 * p } else { p })
}

/// The signature with the smallest p on what `fit` leaves, `residual`, and that p; none where none
/// can be tested.
pub fn strongest<'a>(
    signatures: impl IntoIterator<Item = &'a Signature>,
    residual: &DVector<f64>,
    fit: &Fit,
) -> Option<(f64, &'a Signature)> {
    let tested = |s: &'a Signature| Some((signature_p(s, s.gain(residual), fit.ssr, fit.dof)?, s));
    signatures
        .into_iter()
        .filter_map(tested)
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Distribution of the smallest p over a family of signatures under the null. It is drawn once,
/// where a p is asked for that its bounds do not decide.
#[derive(Clone)]
pub struct MinPDistribution(Arc<Family>);

struct Family {
    signatures: Arc<[Signature]>,
    dof: f64,
    options: Options,
    /// Smallest p of each draw, ascending.
    minima: OnceLock<Vec<f64>>,
}

impl MinPDistribution {
    /// Of `signatures` on a residual with `dof` degrees of freedom.
    pub fn new(signatures: Arc<[Signature]>, dof: f64, options: &Options) -> Self {
        Self(Arc::new(Family {
            signatures,
            dof,
            options: options.clone(),
            minima: OnceLock::new(),
        }))
    }

    fn minima(&self) -> &[f64] {
        self.0.minima.get_or_init(|| self.0.simulate())
    }

    /// Whether the family-wise p-value of a smallest single p lies below `level`: it is that p at
    /// least, and at most as many times as there are signatures (Bonferroni).
    pub(crate) fn rejects(&self, p: f64, level: f64) -> bool {
        let most = p * self.0.signatures.len() as f64;
        p < level && (most < level || self.family_wise_p(p) < level)
    }

    /// Single p-value that the family's smallest undercuts with probability `level` under the null.
    pub(crate) fn critical_p(&self, level: f64) -> f64 {
        let minima = self.minima();
        let k = ((level * minima.len() as f64) as usize).min(minima.len().saturating_sub(1));
        minima.get(k).copied().unwrap_or(level).min(level)
    }

    /// Family-wise p-value of a smallest single p; past the draws' resolution by the effective
    /// number of tests.
    pub fn family_wise_p(&self, p: f64) -> f64 {
        let minima = self.minima();
        let draws = minima.len();
        if draws == 0 {
            return 1.0;
        }
        let below = minima.partition_point(|m| *m <= p);
        // Monte Carlo p-value with the observed value counted as a draw: it is never zero. Ten
        // draws make it stable.
        if below >= 10 {
            return (below as f64 + 1.0) / (draws as f64 + 1.0);
        }
        // Sidak at small p: 1 - (1 - p)^M is about M p, with M from the 2 % quantile of the
        // simulated minima.
        let k = (draws / 50).max(1);
        let tests = ((k as f64 + 1.0) / (draws as f64 + 1.0)) / minima[k - 1].max(1e-300);
        (p * tests.max(1.0)).min((below as f64 + 1.0) / (draws as f64 + 1.0))
    }
}

impl Family {
    /// Smallest p of null residuals, ascending; only their coordinates in the joint span and the
    /// norm of the rest matter.
    fn simulate(&self) -> Vec<f64> {
        let (dof, options) = (self.dof, &self.options);
        let span = JointSpan::of(
            self.signatures.iter().flat_map(|a| &a.directions),
            dof.max(0.0) as usize,
        );
        let rank = span.rank();
        // Of signatures of one kind the largest gain has the smallest p: the tail, which is dear to
        // compute, is computed for that one.
        let mut kinds: Vec<&Signature> = Vec::new();
        let mut places: Vec<(usize, usize, usize)> = Vec::with_capacity(self.signatures.len());
        for s in self.signatures.iter() {
            let same =
                |k: &&Signature| (k.dimension(), k.one_sided) == (s.dimension(), s.one_sided);
            let kind = kinds.iter().position(same).unwrap_or(kinds.len());
            if kind == kinds.len() {
                kinds.push(s);
            }
            let from = places
                .last()
                .map_or(0, |(from, dimension, _)| from + dimension);
            places.push((from, s.dimension(), kind));
        }
        // Signatures may span everything that a few readings leave.
        let rest = (dof - rank as f64).max(0.0);
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(options.seed);
        let chi = ChiSquared::new(rest).ok();
        let heavy = options.tails_dof.and_then(|nu| StudentT::new(nu).ok());
        let size = span.size();
        let mut minima: Vec<f64> = Vec::with_capacity(options.draws);
        while minima.len() < options.draws {
            let count = BATCH.min(options.draws - minima.len());
            // Projections of each draw (a column) on every direction, and its sum of squares.
            let (along, ssr): (DMatrix<f64>, Vec<f64>) = match &heavy {
                None => {
                    // White Gaussian noise is isotropic: N(0, 1) along each basis vector,
                    // chi-squared in the rest, independently.
                    let mut z = DMatrix::zeros(rank, count);
                    let mut ssr = Vec::with_capacity(count);
                    for mut column in z.column_iter_mut() {
                        column
                            .iter_mut()
                            .for_each(|v| *v = StandardNormal.sample(&mut rng));
                        ssr.push(column.norm_squared() + chi.map_or(0.0, |c| c.sample(&mut rng)));
                    }
                    (span.along(&z), ssr)
                }
                // Heavy tails are not the same in every direction: whole readings are drawn.
                Some(t) => {
                    let mut whole = DMatrix::zeros(size, count);
                    whole.iter_mut().for_each(|v| *v = t.sample(&mut rng));
                    let z = span.coordinates(&whole);
                    // The draw fills the nuisance space, too: its rest is scaled to the residual's
                    // degrees of freedom.
                    let scale = rest / (size as f64 - rank as f64).max(1.0);
                    let ssr = (0..count).map(|k| {
                        let inside = z.column(k).norm_squared();
                        inside + (whole.column(k).norm_squared() - inside).max(0.0) * scale
                    });
                    let ssr = ssr.collect();
                    (span.along(&z), ssr)
                }
            };
            minima.extend((0..count).map(|k| {
                let (draw, ssr) = (along.column(k), ssr[k]);
                let mut gains = vec![-1.0_f64; kinds.len()];
                for &(from, dimension, kind) in &places {
                    // The first direction of a one-sided law is its signature.
                    if kinds[kind].one_sided && draw[from] <= 0.0 {
                        continue;
                    }
                    gains[kind] = gains[kind].max(draw.rows(from, dimension).norm_squared());
                }
                let mut best: f64 = 1.0;
                for (signature, gain) in kinds.iter().zip(gains) {
                    // What cannot be small (chi-squared below its mean and two deviations) is
                    // skipped, where there are readings enough to say so.
                    let d = signature.dimension() as f64;
                    let cannot =
                        dof > 10.0 && gain * dof / ssr < (2.0 * d).min(d + 2.0 * (2.0 * d).sqrt());
                    if gain >= 0.0 && !cannot {
                        best = best.min(signature_p(signature, gain, ssr, dof).unwrap_or(1.0));
                    }
                }
                best
            }));
        }
        minima.sort_by(f64::total_cmp);
        minima
    }
}
