//! A contact that slides over a rigid object whose motion is known in three dimensions; any direction, turns, holds and reversals.
//!
//! The Bayes filter over the curve of inverse solutions (`filter`) takes the object's displacement in place of a sweep's. Friction and the
//! errors that all readings share (zero, calibration) are hypotheses h, each with a filter of its own on m - e_h:
//!
//! ```text
//! p(x | m) = sum_h P(h | m) p(x | m - e_h, h),     P(h | m_1 .. m_k) ~ P(h) prod_k p(m_k - e_h | m_1 .. m_{k-1}, h)
//! ```
//!
//! The motion has to be this object's: it has to predict the moments far better than its reverse does, and no worse than in sweeps, with
//! predicted readings k,
//!
//! ```text
//! E = sum_k log p(m_k | m_1 .. m_{k-1}, motion) > E_reversed + 10,     E / n >= 0     (densities by (N mm)^2)
//! ```
//!
//! The filter loses contacts, and is sure of them: with probability l its answer is of another place (`LOST`), and the stated regions are those of
//! `(1 - l) p + l` times the arc of the moments alone. Answers are places of the wire's axis: the point of the object and the wire's radius along
//! the force.

use crate::arc::{arclength_regions, moments_alone};
use crate::known_motion::{MotionRow, Place, Region};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use wcal_track::filter::{BayesFilter, BayesSettings, ObjectStep};
use wcal_track::inverse::StaticInverse;
use wcal_track::network::Prediction;

/// Log likelihood ratio of the motion to its reverse from which on it counts as the object's.
const MIN_RATIO: f64 = 10.0;
/// Mean log predictive density below which readings are predicted worse than in any sweep (as for networks, `untrained_motion`).
const LOW_EVIDENCE: f64 = 0.0;
/// Fewer predicted readings support nothing.
const MIN_PREDICTED: usize = 10;
/// Share of the noise from pose to pose that changes from reading to reading. An assumption, as for sweeps.
const WHITE: f64 = 0.2;

/// Probability that the filter has lost the contact and is sure of it (three of 18 tracks, read one by one): then nothing but the moments
/// counts, and the regions are that wide.
const LOST: f64 = 0.17;
/// Standard deviation added for errors that the curve's nodes do not represent, mm.
const MIN_SD_MM: f64 = 0.1;

/// Where a sliding contact is at each reading.
#[derive(Debug, Clone, PartialEq)]
pub struct SlidingContact {
    /// Places, one a reading.
    pub places: Vec<Place>,
    /// 95 % regions along the wire, one list a reading.
    pub regions: Vec<Vec<Region>>,
    /// Log likelihood of the predicted readings.
    pub evidence: f64,
    /// The same of the motion with its sign reversed.
    pub reversed_evidence: f64,
    /// Readings that were predicted.
    pub predicted: usize,
}

impl SlidingContact {
    /// Whether the motion is the object's.
    #[must_use]
    pub fn supported(&self) -> bool {
        self.predicted >= MIN_PREDICTED
            && self.evidence > self.reversed_evidence + MIN_RATIO
            && self.evidence >= LOW_EVIDENCE * self.predicted as f64
    }
}

/// A filter with its error of the moments and the logarithm of its probability.
struct Hypothesis<'a> {
    filter: BayesFilter<'a>,
    error_nmm: Vector2<f64>,
    ln_weight: f64,
}

/// Filters with friction and without, each at five errors that all readings share: the cubature of degree three of a normal distribution in
/// two dimensions, weights 1/3 at 0 and 1/6 at sqrt(3) standard deviations along its axes.
fn hypotheses<'a>(inverse: &'a StaticInverse, rows: &[MotionRow], noise_nmm: f64) -> Vec<Hypothesis<'a>> {
    let axes = shared_axes(rows);
    let errors = std::iter::once((Vector2::zeros(), 1.0 / 3.0)).chain(
        axes.column_iter().flat_map(|c| [3.0_f64.sqrt(), -(3.0_f64.sqrt())].map(|by| (c * by, 1.0 / 6.0))),
    );
    let zero_nmm = axes.norm();
    let settings = [BayesSettings::multi_mu(), BayesSettings::default()];
    let settings = settings.map(|s| s.with_measurement_noise(WHITE * noise_nmm, zero_nmm));
    let each = |(error_nmm, weight): (Vector2<f64>, f64)| {
        settings.map(|s| Hypothesis {
            filter: BayesFilter::new(inverse, s),
            error_nmm,
            ln_weight: (0.5 * weight).ln(),
        })
    };
    errors.flat_map(each).collect()
}

/// Columns: standard deviations of the errors that readings share (zero, calibration), root mean square over the readings, N mm.
fn shared_axes(rows: &[MotionRow]) -> Matrix2<f64> {
    let of = |r: &MotionRow| -> Matrix2<f64> {
        r.shared_nmm.iter().map(|h| Vector2::from(*h) * Vector2::from(*h).transpose()).sum()
    };
    let mean = rows.iter().map(of).sum::<Matrix2<f64>>() / rows.len().max(1) as f64;
    let eigen = mean.symmetric_eigen();
    eigen.eigenvectors * Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()))
}

/// Tracks a contact over the readings of one episode; `noise_nmm`: standard deviation of the moments from pose to pose, N mm.
#[must_use]
pub fn locate_sliding(
    inverse: &StaticInverse,
    rows: &[MotionRow],
    noise_nmm: f64,
    radius_mm: f64,
) -> SlidingContact {
    let mut reversed = rows.to_vec();
    for row in &mut reversed {
        (row.moved_mm, row.turn) = (-row.moved_mm, row.turn.inverse());
    }
    let of = |rows: &[MotionRow]| followed(inverse, rows, noise_nmm, radius_mm);
    let (found, control) = rayon::join(|| of(rows), || of(&reversed));
    SlidingContact { reversed_evidence: control.evidence, ..found }
}

/// The same without the control.
fn followed(inverse: &StaticInverse, rows: &[MotionRow], noise_nmm: f64, radius_mm: f64) -> SlidingContact {
    let mut all = hypotheses(inverse, rows, noise_nmm);
    let priors: Vec<f64> = all.iter().map(|h| h.ln_weight).collect();
    let (mut places, mut regions) = (Vec::new(), Vec::new());
    let (mut evidence, mut predicted) = (0.0, 0);
    for (k, row) in rows.iter().enumerate() {
        let (dt_s, step) = match k.checked_sub(1).map(|k| &rows[k]) {
            Some(before) => (row.t_s - before.t_s, step_between(before, row)),
            None => (0.0, ObjectStep::past_base(0.0)),
        };
        let measured = Vector2::from(row.moment_nmm);
        let mut held = !row.free;
        for h in all.iter_mut().filter(|_| !row.free) {
            let moment = measured - h.error_nmm;
            held &= h.filter.step_along(dt_s, moment.into(), &step).is_some();
        }
        if !held {
            // Free wire: the next contact is another one.
            all.iter_mut().zip(&priors).for_each(|(h, prior)| h.ln_weight = *prior);
            places.push(Place {
                place_mm: None,
                covariance_mm2: Matrix3::zeros(),
                contact: 0.0,
                gross: false,
            });
            regions.push(Vec::new());
            continue;
        }
        // An evidence of 0 is none: a first contact, or a reading during a hold.
        if all.iter().all(|h| h.filter.log_evidence() != 0.0) {
            let before = ln_sum(&all);
            all.iter_mut().for_each(|h| h.ln_weight += h.filter.log_evidence());
            evidence += ln_sum(&all) - before;
            predicted += 1;
        }
        let (place, weights) = unless_lost(inverse, row, mixture(&all, radius_mm));
        places.push(place);
        regions.push(arclength_regions(&inverse.nodes, &weights));
    }
    SlidingContact { places, regions, evidence, reversed_evidence: f64::NEG_INFINITY, predicted }
}

/// The object's step from one reading to another.
fn step_between(before: &MotionRow, now: &MotionRow) -> ObjectStep {
    let turn = now.turn * before.turn.inverse();
    // Both places have an error.
    let sd_mm = before.moved_sd_mm.hypot(now.moved_sd_mm);
    ObjectStep { turn, moved_mm: now.moved_mm - turn * before.moved_mm, sd_mm }
}

/// A posterior (mean p, covariance C, weights w) with the chance that it is of another place: the arc of the moments alone (q, C_a, v) with
/// probability l. The place stays p; `(1 - l) w + l v`, and `(1 - l) C + l (C_a + (q - p)(q - p)')`, the second moment about p.
fn unless_lost(
    inverse: &StaticInverse,
    row: &MotionRow,
    (place, weights): (Place, Vec<f32>),
) -> (Place, Vec<f32>) {
    let sd_nmm = [0, 1].map(|k| {
        let shared: f64 = row.shared_nmm.iter().map(|h| h[k] * h[k]).sum();
        (row.noise_nmm2[(k, k)] + shared).sqrt()
    });
    let arc = moments_alone(inverse, row.moment_nmm, sd_nmm, &Prediction::unknown());
    let (Some(p), q) = (place.place_mm, Vector3::from(arc.point_mm.map(f64::from))) else {
        return (place, weights);
    };
    let spread = Matrix3::from_fn(|i, j| f64::from(arc.covariance_mm2[i][j])) + (q - p) * (q - p).transpose();
    let covariance_mm2 = place.covariance_mm2 * (1.0 - LOST) + spread * LOST;
    let lost = LOST as f32;
    let weights = weights.iter().zip(&arc.weights).map(|(w, v)| (1.0 - lost) * w + lost * v).collect();
    (Place { covariance_mm2, ..place }, weights)
}

/// Logarithm of the sum of all weights.
fn ln_sum(all: &[Hypothesis<'_>]) -> f64 {
    let max = all.iter().map(|h| h.ln_weight).fold(f64::NEG_INFINITY, f64::max);
    max + all.iter().map(|h| (h.ln_weight - max).exp()).sum::<f64>().ln()
}

/// Mean and covariance of the wire's axis over hypotheses and nodes, and the weights of the nodes.
fn mixture(all: &[Hypothesis<'_>], radius_mm: f64) -> (Place, Vec<f32>) {
    let total = ln_sum(all);
    let mut nodes: Vec<f64> = Vec::new();
    let mut points: Vec<(f64, Vector3<f64>)> = Vec::new();
    for h in all {
        let share = (h.ln_weight - total).exp();
        let posterior = h.filter.posterior();
        nodes.resize(posterior.len(), 0.0);
        for ((node, w), s) in nodes.iter_mut().zip(&posterior).zip(h.filter.solutions()) {
            let w = share * w;
            *node += w;
            points.push((w, s.point_mm + s.normal * radius_mm));
        }
    }
    let sum: f64 = points.iter().map(|p| p.0).sum();
    let mean: Vector3<f64> = points.iter().map(|(w, p)| p * (*w / sum)).sum();
    let mut covariance_mm2 = Matrix3::identity() * MIN_SD_MM * MIN_SD_MM;
    for (w, p) in &points {
        let off = p - mean;
        covariance_mm2 += off * off.transpose() * (*w / sum);
    }
    let place = Place { place_mm: Some(mean), covariance_mm2, contact: 1.0, gross: false };
    let all: f64 = nodes.iter().sum();
    (place, nodes.iter().map(|w| (w / all) as f32).collect())
}
