//! Residuals of readings that a model was not fitted to (sealed ones, or those of a fold), and what
//! they say of it: by itself, and beside another model.
//!
//! ```text
//! e ~ N(0, s^2 S),   S = C + J V J',   r = S^(-1/2) e / s             of a model that is right
//! F = |r|^2 / n                                                       P(F_{n, dof} > F): the residuals are too large
//! |e'|^2 - |e|^2 = |d|^2 + 2 e'd,   d = e' - e                        e': of the other model, on the same readings
//! T = e'd / (s^2 d'S d max(1, B, W))^(1/2)                            Student's t with dof: refuted by the other where T is far below 0
//! B = 1 / (G - 1) sum (e_g'd_g - c |d_g|^2)^2 / (s^2 d_g'S d_g)       scatter of groups g about one gain c = e'd / |d|^2
//! W = |r off the direction of S^(-1/2) d|^2 / (n - 1)                 scatter of readings
//! ```
//!
//! e: measured less predicted, each in units of its noise; C: noise in units of s^2; V: covariance
//! of the fitted parameters, which all these readings share. With C = L L' and L^-1 J V J' L'^-1 =
//! Q diag(v) Q', S^(-1/2) is (1 + Q diag((1 + v)^(-1/2) - 1) Q') L^-1. Prediction F test: Seber &
//! Lee, "Linear Regression Analysis", 2nd ed., ch. 5; heavy tails: each r is as far out as a
//! Gaussian value of the same chance.
//!
//! T judges the error that is stated, not the one that whitening leaves of it: what neighbours
//! share widens it and hides nothing. T is exact for the declared model: where that is right its
//! fit is efficient, so that its errors and the difference d of two fits are independent (J. A.
//! Hausman, Econometrica 46 (1978), 1251-1271, lemma 2.1), whatever the fitted readings chose. For
//! the accepted model it holds given these, by which d is fixed: of an effect that is hardly found
//! the fit overshoots, and it is refuted somewhat more often. B and W widen it where groups or
//! readings scatter as no noise does: B asks that groups agree in the gain, not in their size.

use crate::levels::z;
use crate::measurement_model::MeasurementModel;
use crate::method::distributions::f_tail;
use crate::method::fit::{Fit, fit};
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::linear::stack_with;
use crate::method::noise::tails::Tails;
use crate::method::noise::{Noise, Weights};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// S^(-1/2) on values that C leaves white.
struct Root {
    directions: DMatrix<f64>,
    /// (1 + v)^(-1/2) - 1.
    shrink: DVector<f64>,
}

impl Root {
    /// Of parameters with that covariance in units of s^2, which move the whitened values by
    /// `jacobian`; none where it has no decomposition.
    fn of(jacobian: DMatrix<f64>, spread: &DMatrix<f64>) -> Option<Self> {
        // J V J' has the rank of the parameters: its eigenvectors lie in the span of J.
        let (q, r) = jacobian.qr().unpack();
        let parts = (&r * spread * r.transpose()).try_symmetric_eigen(f64::EPSILON, 0)?;
        let shrink = parts
            .eigenvalues
            .map(|v| (1.0 + v.max(0.0)).sqrt().recip() - 1.0);
        Some(Self {
            directions: q * parts.eigenvectors,
            shrink,
        })
    }

    fn apply(&self, v: &DVector<f64>) -> DVector<f64> {
        v + &self.directions * self.directions.tr_mul(v).component_mul(&self.shrink)
    }
}

/// Residuals of readings under one model that was fitted without them.
pub struct PredictionResidual {
    /// e / s; readings channel by channel, then the second witness, which is white.
    off: DVector<f64>,
    /// Derivatives of `off` by the parameters.
    jacobian: DMatrix<f64>,
    /// V.
    spread: DMatrix<f64>,
    /// Noise of the readings; those that are not judged do not count.
    weights: Weights,
    /// Values of the readings among `off`.
    readings: usize,
    root: Root,
    tails: Option<Tails>,
    /// Values that count.
    count: f64,
    /// Degrees of freedom of s.
    dof: f64,
}

impl PredictionResidual {
    /// `off` of readings whose noise is that of `weights`, and its derivatives by parameters with
    /// covariance `spread`; `tails` where the noise has heavy ones.
    fn new(
        off: DVector<f64>,
        [jacobian, spread]: [DMatrix<f64>; 2],
        weights: Weights,
        readings: usize,
        [count, dof]: [f64; 2],
        tails: Option<Tails>,
    ) -> Option<Self> {
        let white = jacobian
            .column_iter()
            .map(|column| whitened(&weights, readings, &column.into_owned()));
        let root = Root::of(DMatrix::from_columns(&white.collect::<Vec<_>>()), &spread)?;
        Some(Self {
            off,
            jacobian,
            spread,
            weights,
            readings,
            root,
            tails,
            count,
            dof,
        })
    }

    /// Of the readings of `model` that `judged` under `h`, which was fitted without them;
    /// `tangents` are those of `h` on the rows of `model`. None without readings or noise.
    pub fn of(
        model: &dyn MeasurementModel,
        h: &Hypothesis,
        tangents: &Fit,
        noise: &Noise,
        judged: impl Fn(usize) -> bool,
    ) -> Option<Self> {
        let (weights, s) = (
            noise.weights_of(&model.noise_inputs()).masked(judged),
            noise.repeat.value,
        );
        if weights.active() == 0 || !(s > 0.0) {
            return None;
        }
        // What the second witness leaves of these readings, and its tangents.
        let pictured = !model.auxiliary_readings().is_empty();
        let seen = if pictured {
            Some(fit(model, &h.fit.terms, &weights, 0)?)
        } else {
            None
        };
        let left = in_own_noise(
            &weights,
            model.measured() - &tangents.raw_design * &h.fit.coefficients,
        );
        let none = DVector::zeros(0);
        let off = stack_with(
            &left,
            seen.as_ref().map_or(&none, |f| &f.auxiliary_residual),
        ) / s;
        let (columns, spread) = (
            derivatives(tangents, &weights, seen.as_ref()),
            covariance(&h.fit, 1.0),
        );
        if spread.nrows() != columns.len() {
            return None;
        }
        let witnessed = model
            .auxiliary_readings()
            .iter()
            .filter(|i| weights.counts(**i))
            .count();
        let count = (weights.active() * left.ncols() + witnessed) as f64;
        let tails = noise.tails.filter(|t| t.heavy && t.heaviest.is_finite());
        Self::new(
            off,
            [DMatrix::from_columns(&columns), spread],
            weights,
            left.len(),
            [count, h.fit.dof],
            tails,
        )
    }

    /// S^(-1/2) v.
    fn white(&self, v: &DVector<f64>) -> DVector<f64> {
        self.root.apply(&whitened(&self.weights, self.readings, v))
    }

    /// v'S v.
    fn variance(&self, v: &DVector<f64>) -> f64 {
        // v'S v = v'C v + (J'v)' V (J'v): no dense matrix of all readings.
        let (readings, witness) = v.as_slice().split_at(self.readings);
        let own = readings
            .chunks(self.weights.len())
            .map(|channel| self.weights.variance_of(channel))
            .sum::<f64>();
        let witness = witness.iter().map(|v| v * v).sum::<f64>();
        let moved = self.jacobian.tr_mul(v);
        own + witness + moved.dot(&(&self.spread * &moved))
    }

    /// Chance of residuals as large where the model is right.
    pub fn p(&self) -> Option<f64> {
        let mut r = self.white(&self.off);
        if let Some(tails) = self.tails {
            // Each value as far out as a Gaussian one of the same chance; 30 is beyond any.
            let gaussian = |x: f64| z((0.5 * tails.two_sided(x)).clamp(1e-300, 0.5)).min(30.0);
            r.apply(|r| *r = r.signum() * gaussian(r.abs()));
        }
        f_tail(r.norm_squared() / self.count, [self.count, self.dof])
    }

    /// The `other` model beside this one, on the same readings; `group` of each reading. The second
    /// witness is one group.
    pub fn beside(&self, other: &Self, group: impl Fn(usize) -> u32) -> PairedTest {
        let group = |k: usize| (k < self.readings).then(|| group(k % self.weights.len()));
        let d = &other.off - &self.off;
        let mut groups: BTreeMap<Option<u32>, DVector<f64>> = BTreeMap::new();
        for (k, d) in d.iter().enumerate().filter(|(_, d)| **d != 0.0) {
            let own = groups
                .entry(group(k))
                .or_insert_with(|| DVector::zeros(self.off.len()));
            own[k] = *d;
        }
        let of_group = |d: DVector<f64>| [self.off.dot(&d), d.norm_squared(), self.variance(&d)];
        let (r, along) = (self.white(&self.off), self.white(&d));
        let taken = if along.norm() > 0.0 {
            r.dot(&along).powi(2) / along.norm_squared()
        } else {
            0.0
        };
        PairedTest {
            groups: groups.into_values().map(of_group).collect(),
            variance: self.variance(&d),
            squares: r.norm_squared() - taken,
            // The direction of d is tested by T itself and takes one degree of freedom from W.
            count: self.count - 1.0,
            dof: self.dof,
        }
    }
}

/// Every reading in units of its noise; those that do not count are zero.
fn in_own_noise(weights: &Weights, mut m: DMatrix<f64>) -> DMatrix<f64> {
    m.row_iter_mut()
        .zip(weights.relative())
        .for_each(|(mut row, weight)| row *= *weight);
    m
}

/// L^-1 v of values in units of their own noise, the first `readings` of which are the readings'.
fn whitened(weights: &Weights, readings: usize, v: &DVector<f64>) -> DVector<f64> {
    let n = weights.len();
    let mut out = v.clone();
    for channel in out.as_mut_slice()[..readings].chunks_mut(n) {
        let raw: Vec<f64> = channel
            .iter()
            .zip(weights.relative())
            // `apply_to` takes values as they were read, not those in units of their noise.
            .map(|(v, w)| if *w > 0.0 { v / w } else { 0.0 })
            .collect();
        channel.copy_from_slice(&weights.apply_to(&raw));
    }
    out
}

/// Derivatives of the prediction by coefficients, channel by channel, and nonlinear values.
fn derivatives(tangents: &Fit, weights: &Weights, seen: Option<&Fit>) -> Vec<DVector<f64>> {
    let design = in_own_noise(weights, tangents.raw_design.clone());
    let (n, channels) = (design.nrows(), tangents.raw_residual.ncols());
    let witness = seen.map_or(0, |f| f.auxiliary_residual.len());
    let mut columns = Vec::new();
    for c in 0..channels {
        for column in design.column_iter() {
            let mut v = DVector::zeros(n * channels + witness);
            v.rows_mut(c * n, n).copy_from(&column);
            columns.push(v);
        }
    }
    for (k, readings) in tangents.raw_tangents.iter().enumerate() {
        let shown = seen.map_or_else(
            || DVector::zeros(0),
            |f| f.tangents[k].rows(n * channels, witness).into_owned(),
        );
        columns.push(stack_with(&in_own_noise(weights, readings.clone()), &shown));
    }
    columns
}

/// Two models on the same readings: how far those speak against the first one, for the other.
pub struct PairedTest {
    /// e'd, |d|^2 and d'S d of each group.
    groups: Vec<[f64; 3]>,
    /// d'S d of all.
    variance: f64,
    /// Squares of r off the direction of d, and how many they are.
    squares: f64,
    count: f64,
    /// Degrees of freedom of s.
    dof: f64,
}

impl PairedTest {
    /// Of several folds; none of none.
    pub(crate) fn of_folds(folds: impl IntoIterator<Item = Self>) -> Option<Self> {
        folds.into_iter().reduce(|mut all, fold| {
            all.groups.extend(fold.groups);
            all.variance += fold.variance;
            (all.squares, all.count) = (all.squares + fold.squares, all.count + fold.count);
            // The folds share most readings: their degrees of freedom do not add.
            all.dof = all.dof.min(fold.dof);
            all
        })
    }

    /// Chance that the other model seems so much better where the first one is right; 1 where it
    /// leaves no less.
    pub fn p(&self) -> Option<f64> {
        let sum = |k: usize| self.groups.iter().map(|g| g[k]).sum::<f64>();
        let (gain, change) = (sum(0), sum(1));
        // |e'|^2 - |e|^2 = |d|^2 + 2 e'd: the other model leaves no less.
        if change + 2.0 * gain >= 0.0 {
            return Some(1.0);
        }
        let scatter =
            |[own, size, variance]: &[f64; 3]| (own - gain / change * size).powi(2) / variance;
        // Groups that agree about one gain scatter by 1 on G - 1 degrees of freedom.
        let between = self.groups.iter().map(scatter).sum::<f64>()
            / (self.groups.len() as f64 - 1.0).max(1.0);
        let within = self.squares / self.count.max(1.0);
        let variance = self.variance * between.max(within).max(1.0);
        // One-sided: T^2 is F with one degree of freedom, and half of it lies on the other side.
        Some(0.5 * f_tail(gain * gain / variance, [1.0, self.dof])?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::levels::{CATALOGUE, LEFT_OUT, LEFT_OUT_GAIN};
    use crate::method::columns_system_test::ColumnsSystem;
    use crate::method::noise::whitening::SharedNoise;
    use crate::method::noise_estimator::NoiseEstimator;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::sync::Arc;

    /// Eight runs of ten readings (SIMULATED): noise that neighbours of a run share, a level
    /// declared, a slope accepted. Two runs are fitted; the others, which go further, are sealed,
    /// and share what those few tell of the level.
    struct Sessions {
        noise: Weights,
        design: DMatrix<f64>,
        /// Root of the noise's covariance.
        root: DMatrix<f64>,
        rng: rand_chacha::ChaCha8Rng,
    }

    const OPEN: usize = 20;

    impl Sessions {
        fn new(seed: u64) -> Self {
            let of_run = |i: usize| (i % 10) as f64;
            let shared = SharedNoise {
                clock: Arc::new((0..80).map(|i| (i / 10) as f64 * 1e3 + of_run(i)).collect()),
                settings: Arc::new((0..80).collect()),
                posed: Arc::new(vec![true; 80]),
                correlated: Some([2.0, 5.0]),
                pose: 0.0,
            };
            let noise = Weights::sharing(vec![1.0; 80], shared);
            let root = noise
                .covariance(&(0..80).collect::<Vec<usize>>())
                .cholesky()
                .unwrap()
                .l();
            let place = |i: usize| of_run(i) / 4.5 - if i < OPEN { 1.0 } else { 0.0 };
            let design = DMatrix::from_fn(80, 2, |i, j| place(i).powi(j as i32));
            Self {
                noise,
                design,
                root,
                rng: rand_chacha::ChaCha8Rng::seed_from_u64(seed),
            }
        }

        /// Sealed residuals of the first one and two columns, fitted to the open readings of `y`,
        /// in units of the richer one's noise. `judged_by` is the noise that is assumed, and
        /// `parameters` says whether theirs counts.
        fn sealed(
            &self,
            y: &DVector<f64>,
            judged_by: &Weights,
            parameters: bool,
        ) -> [PredictionResidual; 2] {
            let (kept, sealed) = (
                judged_by.masked(|i| i < OPEN),
                judged_by.masked(|i| i >= OPEN),
            );
            let white = |w: &Weights, v: &DVector<f64>| DVector::from_vec(w.apply_to(v.as_slice()));
            let fitted = |count: usize| {
                let design = self.design.columns(0, count).into_owned();
                let columns = kept.apply(&design);
                let spread = columns.tr_mul(&columns).try_inverse().unwrap();
                let left = y - &design * (&spread * columns.tr_mul(&white(&kept, y)));
                (in_own_noise(&sealed, design), spread, left)
            };
            let s = (white(&kept, &fitted(2).2).norm_squared() / (OPEN - 2) as f64).sqrt();
            [1, 2].map(|count| {
                let (jacobian, spread, left) = fitted(count);
                let spread = if parameters { spread } else { spread * 0.0 };
                let count = [(80 - OPEN) as f64, (OPEN - 2) as f64];
                let off = left.map_with_location(|i, _, v| v * sealed.of(i) / s);
                PredictionResidual::new(off, [jacobian, spread], sealed.clone(), 80, count, None)
                    .unwrap()
            })
        }

        /// Shares of sessions with a slope of that size in which, at 5 %, the declared model is
        /// refuted by the accepted one, that by the declared one, and the accepted one by itself.
        fn shares(&mut self, slope: f64, judged_by: &Weights, parameters: bool) -> [f64; 3] {
            const DRAWS: usize = 2000;
            let mut counts = [0; 3];
            for _ in 0..DRAWS {
                let white = DVector::from_fn(80, |_, _| StandardNormal.sample(&mut self.rng));
                let y = &self.root * white + self.design.column(1) * slope;
                let [declared, accepted] = self.sealed(&y, judged_by, parameters);
                let run = |i: usize| (i / 10) as u32;
                let tests = [
                    declared.beside(&accepted, run).p(),
                    accepted.beside(&declared, run).p(),
                ];
                for (count, p) in counts
                    .iter_mut()
                    .zip(tests.into_iter().chain([accepted.p()]))
                {
                    *count += usize::from(p.unwrap() < 0.05);
                }
            }
            counts.map(|c| c as f64 / DRAWS as f64)
        }
    }

    /// Binomial standard deviation of 5 % in 2000 draws: 0.005.
    #[test]
    fn each_test_holds_its_level_and_a_model_that_is_wrong_is_refuted() {
        let mut sessions = Sessions::new(6_211);
        let noise = sessions.noise.clone();
        let [declared, _, itself] = sessions.shares(0.0, &noise, true);
        println!("no slope: declared refuted {declared:.3}, accepted by itself {itself:.3}");
        assert!(declared < 0.065 && (0.035..0.065).contains(&itself));
        // Power rises with the slope, and what is right stays so at its level.
        let mut power = Vec::new();
        for slope in [1.0, 2.0, 4.0] {
            let [declared, accepted, itself] = sessions.shares(slope, &noise, true);
            println!(
                "slope {slope}: declared refuted {declared:.3}, accepted {accepted:.3}, by itself {itself:.3}"
            );
            // The fit of a slope that no search would name yet overshoots, and d with it: the level
            // is that of slopes which are found.
            assert!(accepted < if slope < 2.0 { 0.1 } else { 0.065 }, "{slope}");
            assert!((0.035..0.065).contains(&itself), "{slope}");
            power.push(declared);
        }
        assert!(power.is_sorted() && power[2] > 0.8, "{power:?}");
        // Controls: parameters that are taken for known, and readings for independent.
        for (judged_by, parameters) in [(noise, false), (Weights::equal(80), true)] {
            let [declared, _, itself] = sessions.shares(0.0, &judged_by, parameters);
            println!("control: declared refuted {declared:.3}, accepted by itself {itself:.3}");
            assert!(declared.max(itself) > 0.1, "{declared} {itself}");
        }
    }

    /// Two runs of unequal gain: once their scatter hid a fall of the error to a tenth.
    #[test]
    fn groups_of_unequal_gain_tell_the_models_apart() {
        let of = |off: &[f64]| {
            let known = [DMatrix::zeros(6, 1), DMatrix::zeros(1, 1)];
            let off = DVector::from_column_slice(off);
            PredictionResidual::new(off, known, Weights::equal(6), 6, [6.0, 50.0], None).unwrap()
        };
        let p = |a: &PredictionResidual, b: &PredictionResidual| {
            a.beside(b, |k| k as u32 / 3).p().unwrap()
        };
        let accepted = of(&[0.4, -1.1, 0.7, 1.3, -0.2, -0.9]);
        let declared = of(&[9.0, 8.1, 9.5, 2.2, 1.6, 1.1]);
        assert!(p(&declared, &accepted) < 1e-6 && p(&accepted, &declared) > 0.05);
        // Controls: predictions alike to a tenth of the noise say nothing, the same ones are no
        // test, and residuals that scatter five times as far as they are said to measure by that.
        let alike = of(&[0.5, -1.0, 0.6, 1.4, -0.1, -1.0]);
        assert!(
            p(&alike, &accepted) > 0.05
                && p(&accepted, &alike) > 0.05
                && p(&accepted, &accepted) == 1.0
        );
        let wild = of(&[5.0, -5.5, 6.0, -4.5, 5.0, -6.0]);
        let moved = of(&[2.0, -8.5, 3.0, -7.5, 2.0, -9.0]);
        assert!(p(&moved, &wild) > 0.05);
        // An effect that is half as large here as it was fitted refutes both; the one that leaves
        // less stands.
        let (over, under) = (
            of(&[4.0, 4.1, 3.9, 4.0, 4.2, 3.8]),
            of(&[-6.0, -5.9, -6.1, -6.0, -5.8, -6.2]),
        );
        assert!(p(&under, &over) < 0.05 && p(&over, &under) == 1.0);
    }

    /// p of a slope by readings of each group left out in turn, and of its F test on all of them:
    /// `count` groups of ten (SIMULATED).
    fn left_out(seed: u64, count: usize, slope: impl Fn(usize) -> f64) -> [f64; 2] {
        let x: Vec<f64> = (0..10 * count)
            .map(|i| (i % 10) as f64 / 4.5 - 1.0)
            .collect();
        let clean: Vec<f64> = x
            .iter()
            .enumerate()
            .map(|(i, x)| slope(i / 10) * x)
            .collect();
        let system = ColumnsSystem::new(seed, vec![x], &clean);
        let fitted = |effects: &[usize], weights: &Weights| {
            let terms: Vec<_> = effects.iter().map(|&e| ColumnsSystem::term(e)).collect();
            Hypothesis::fitted(&system, &terms, weights, 5).unwrap()
        };
        let of_fold = |g: usize| {
            let weights = Weights::equal(10 * count).masked(|i| i / 10 != g);
            let chosen = fitted(&[0], &weights);
            let noise = NoiseEstimator::new(&system, 1)
                .without(|i| i / 10 == g)
                .noise(&chosen, &[])
                .unwrap();
            let of = |h: &Hypothesis| {
                PredictionResidual::of(&system, h, &h.fit, &noise, |i| i / 10 == g).unwrap()
            };
            of(&fitted(&[], &weights)).beside(&of(&chosen), |_| g as u32)
        };
        let p = PairedTest::of_folds((0..count).map(of_fold))
            .unwrap()
            .p()
            .unwrap();
        let all = Weights::equal(10 * count);
        let (with, without) = (fitted(&[0], &all).fit, fitted(&[], &all).fit);
        let f = (without.ssr - with.ssr) / with.variance();
        [p, f_tail(f, [1.0, with.dof]).unwrap()]
    }

    /// What a search among ten names gives just at CATALOGUE keeps its name as often as LEFT_OUT
    /// says, be there four groups or ten.
    #[test]
    fn a_weak_effect_keeps_its_name_and_one_of_a_single_group_does_not() {
        for count in [4, 10] {
            let [mut given, mut lost, mut chance, mut single] = [0_u32; 4];
            let at_bound = 4.0 / (4.1 * count as f64).sqrt();
            for seed in 0..500 {
                let [p, search] = left_out(31_000 + seed, count, |_| at_bound);
                let is_given = search < 0.1 * CATALOGUE;
                given += u32::from(is_given);
                lost += u32::from(is_given && p >= LEFT_OUT_GAIN);
                chance += u32::from(left_out(35_000 + seed, count, |_| 0.0)[0] < LEFT_OUT_GAIN);
                // Control: the same sum of squares in a single group.
                let of_one = |g: usize| {
                    if g == 1 {
                        at_bound * (count as f64).sqrt()
                    } else {
                        0.0
                    }
                };
                single += u32::from(left_out(39_000 + seed, count, of_one)[0] >= LEFT_OUT_GAIN);
            }
            println!(
                "{count} groups: {lost} of {given} lost, {chance} of 500 by chance, {single} of 500 of one group lost"
            );
            let may = LEFT_OUT * f64::from(given);
            assert!(
                given > 200 && f64::from(lost) <= may + 2.0 * may.sqrt(),
                "{lost} of {given}"
            );
            assert!(chance < 50 && single > 400, "{chance} {single}");
        }
    }
}
