//! The zero of a record: the mean of its free readings, with what is not known of it.
//!
//! ```text
//! m' = m - m_0,   m_0 = mean of m_k over the n free readings                     errors: (h - h_0) c - z,   cov z = g R / n + 2 D
//! g   = 1 + 2 sum_j rho_j                                        rho_j: correlation of the free readings' noise over j readings
//! ```
//!
//! h_0 is the mean of h over the free readings: what all readings of a calibration share is the
//! less uncertain the nearer a reading is to the free wire. R: noise of a reading, g of which count
//! as one where it is slow, D: drift of the zero within the record. A record without free readings
//! keeps the calibration's zero, cov z = B / 4 + D: it may be off by half of the noise from pose to
//! pose B, an assumption. Where R is not known the free readings are one draw of B. The sum ends
//! where two successive rho_j are not positive together (C. J. Geyer, Stat. Sci. 7 (1992) 473).

use crate::reading::{Moments, Reading, squares};
use nalgebra::{Matrix2, Vector2};
use wcal_core::order_statistics::median;

/// Share of the noise from pose to pose by which the calibration's zero may be off in another
/// record. An assumption.
pub(crate) const ZERO: f64 = 0.5;
/// Share of it that is white from one averaged reading to the next, and a row's own where no prefix
/// was measured; the rest is slow. An assumption.
pub(crate) const WHITE: f64 = 0.2;
/// Fewer free readings are no zero, and say nothing of the noise.
const MIN_FREE: usize = 5;
/// A reading that is this many standard deviations of the free ones' noise off is no longer free.
const FREE_SDS: f64 = 6.0;
/// A zero that is this many standard deviations of what the calibration states of it off is none:
/// the record begins in contact.
const ZERO_SDS: f64 = 4.0;
/// Lower quartile of chi-squared with two degrees of freedom.
const CHI2_QUARTER: f64 = 0.575;
/// Noise below which no moments are read: rounding of tables, N mm.
const MIN_NOISE_NMM: f64 = 5e-4;

/// The beginning of a record that is free of contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FreeStart {
    /// So long, s, with a noise of the readings of this covariance, (N mm)^2.
    Free {
        /// From the first reading to the last free one, s.
        span_s: f64,
        /// Readings.
        readings: usize,
        /// Covariance of their noise, (N mm)^2.
        noise_nmm2: Matrix2<f64>,
        /// Its statistical inefficiency.
        inefficiency: f64,
    },
    /// The first readings stand still at a moment (N mm) that no free wire has by this calibration.
    Loaded(f64),
    /// Too few of the first readings agree with each other.
    Unknown,
}

/// Takes the zero off the moments of one whisker, in order of time.
#[derive(Debug, Clone)]
pub struct Zero {
    span_s: f64,
    begun_s: Option<f64>,
    sum_nmm: Vector2<f64>,
    shared_nmm: Vec<Vector2<f64>>,
    count: f64,
}

impl Zero {
    /// The mean over a time, s; 0: the calibration's zero.
    pub fn new(span_s: f64) -> Self {
        Self {
            span_s,
            begun_s: None,
            sum_nmm: Vector2::zeros(),
            shared_nmm: Vec::new(),
            count: 0.0,
        }
    }

    /// Moments from the zero on, with what is not known of it.
    pub fn applied(&mut self, t_s: f64, m: Moments) -> Moments {
        let begun_s = *self.begun_s.get_or_insert(t_s);
        if t_s - begun_s < self.span_s {
            self.sum_nmm += Vector2::from(m.moment_nmm);
            self.shared_nmm.resize(m.shared_nmm.len(), Vector2::zeros());
            self.shared_nmm
                .iter_mut()
                .zip(&m.shared_nmm)
                .for_each(|(sum, h)| *sum += Vector2::from(*h));
            self.count += 1.0;
        }
        if self.count == 0.0 {
            let zero_nmm2 = m.pose_nmm2 * ZERO * ZERO + m.drift_nmm2;
            return Moments { zero_nmm2, ..m };
        }
        let moment_nmm = (Vector2::from(m.moment_nmm) - self.sum_nmm / self.count).into();
        // An error that all readings share cancels as far as the free ones have it, too.
        let less =
            |(h, sum): (&[f64; 2], &Vector2<f64>)| (Vector2::from(*h) - sum / self.count).into();
        let shared_nmm: Vec<[f64; 2]> = m
            .shared_nmm
            .iter()
            .zip(&self.shared_nmm)
            .map(less)
            .collect();
        // Noise of the mean falls as g / n; free readings of one pose are one draw. Drift enters
        // twice, at the zero and at the reading.
        let mean = |own: Matrix2<f64>| own * (m.inefficiency.max(1.0) / self.count);
        let zero_nmm2 = m.own_nmm2.map_or(m.pose_nmm2, mean) + m.drift_nmm2 * 2.0;
        Moments {
            moment_nmm,
            shared_nmm,
            zero_nmm2,
            ..m
        }
    }
}

/// First moments of a record that agree with each other.
pub(crate) struct Steady {
    /// How many.
    pub count: usize,
    /// Farther than this off they no longer do, N mm.
    pub limit_nmm: f64,
}

/// The steady beginning of a record whose readings have at least this noise, N mm; none where there
/// is none.
pub(crate) fn steady(moments_nmm: &[Vector2<f64>], noise_nmm: f64) -> Option<Steady> {
    if moments_nmm.len() < MIN_FREE {
        return None;
    }
    // Second differences have no trend and six times the noise's variance; a quarter of the
    // readings is taken to be quiet.
    let mut bends: Vec<f64> = moments_nmm
        .windows(3)
        .map(|w| (w[0] - w[1] * 2.0 + w[2]).norm_squared() / 6.0)
        .collect();
    bends.sort_by(f64::total_cmp);
    let quiet = (bends[bends.len() / 4] / CHI2_QUARTER).sqrt();
    let limit_nmm = FREE_SDS * quiet.max(noise_nmm).max(MIN_NOISE_NMM);
    // The median of the first few withstands a gross reading.
    let middle = |c: usize| median(moments_nmm[..MIN_FREE].iter().map(|m| m[c]));
    let middle = Vector2::new(middle(0)?, middle(1)?);
    let count = moments_nmm
        .iter()
        .take_while(|m| (*m - middle).norm() <= limit_nmm)
        .count();
    (count >= MIN_FREE).then_some(Steady { count, limit_nmm })
}

/// What the first readings of a table are. A calibration that does not know the zero of the free
/// wire cannot tell a beginning in contact: any steady one is taken for free.
pub fn beginning(readings: &[Reading], zero_known: bool) -> FreeStart {
    let all: Vec<(f64, &Moments)> = readings
        .iter()
        .filter_map(|r| Some((r.t_s, r.moments.as_ref()?)))
        .collect();
    let moments: Vec<Vector2<f64>> = all.iter().map(|(_, m)| m.moment_nmm.into()).collect();
    let known = all.first().and_then(|(_, m)| m.own_nmm2);
    let known = known.map_or(0.0, |n| (0.5 * n.trace()).sqrt());
    let Some(steady) = steady(&moments, known) else {
        return FreeStart::Unknown;
    };
    let readings = steady.count;
    let free = &moments[..readings];
    let mean = free.iter().sum::<Vector2<f64>>() / readings as f64;
    let (begun_s, m) = all[0];
    let stated_nmm = ZERO_SDS * (m.pose_nmm2.trace() + squares(&m.shared_nmm)).sqrt();
    if zero_known && mean.norm() > stated_nmm.max(steady.limit_nmm) {
        return FreeStart::Loaded(mean.norm());
    }
    // Sample covariance; the mean takes one degree of freedom.
    let off: Vec<Vector2<f64>> = free.iter().map(|m| m - mean).collect();
    let spread: Matrix2<f64> = off.iter().map(|o| o * o.transpose()).sum();
    let floor = Matrix2::identity() * MIN_NOISE_NMM * MIN_NOISE_NMM;
    // Half a step past the last free reading.
    let last_s = all[readings - 1].0;
    let next_s = all.get(readings).map_or(last_s, |n| 0.5 * (last_s + n.0));
    FreeStart::Free {
        span_s: next_s - begun_s,
        readings,
        noise_nmm2: spread / (readings - 1) as f64 + floor,
        inefficiency: inefficiency(&off),
    }
}

/// Statistical inefficiency of noise, see the module.
fn inefficiency(off: &[Vector2<f64>]) -> f64 {
    // Autocovariance of both moments together.
    let covariance = |lag: usize| {
        off[lag..]
            .iter()
            .zip(off)
            .map(|(a, b)| a.dot(b))
            .sum::<f64>()
    };
    let variance = covariance(0).max(f64::MIN_POSITIVE);
    // Geyer's sequence: sums of pairs of a reversible process are positive; noise ends it.
    let pairs = (0..off.len() / 4).map(|k| (covariance(2 * k) + covariance(2 * k + 1)) / variance);
    (2.0 * pairs.take_while(|pair| *pair > 0.0).sum::<f64>() - 1.0).max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(k: usize, moment_nmm: [f64; 2]) -> Reading {
        let moments = Moments {
            moment_nmm,
            sd_nmm: [0.1; 2],
            valid: true,
            pose_nmm2: Matrix2::identity() * 0.01,
            own_nmm2: None,
            shared_nmm: vec![[0.05 + 0.1 * moment_nmm[0], 0.0]],
            ..Moments::default()
        };
        Reading::alone(k as i64, 0.1 * k as f64, Some(moments))
    }

    /// Ten free readings at a zero, then a contact.
    fn record(zero: f64) -> Vec<Reading> {
        let noise = |k: usize| 0.002 * (k % 3) as f64 - 0.002;
        let load = |k: usize| 0.1 * k.saturating_sub(9) as f64;
        (0..30)
            .map(|k| reading(k, [zero + noise(k) + load(k), noise(k + 1)]))
            .collect()
    }

    #[test]
    fn the_free_beginning_is_the_zero_and_says_what_the_noise_is() {
        let readings = record(0.2);
        let FreeStart::Free {
            span_s,
            readings: free,
            noise_nmm2,
            ..
        } = beginning(&readings, true)
        else {
            panic!()
        };
        assert!(
            free == 10 && (span_s - 0.95).abs() < 1e-9,
            "{free} {span_s}"
        );
        assert!(
            (0.001..0.003).contains(&noise_nmm2[(0, 0)].sqrt()),
            "{noise_nmm2}"
        );
        let mut zero = Zero::new(span_s);
        let taken = |zero: &mut Zero, r: &Reading| zero.applied(r.t_s, r.moments.clone().unwrap());
        let all: Vec<Moments> = readings.iter().map(|r| taken(&mut zero, r)).collect();
        assert!(
            (all[29].moment_nmm[0] - 2.0).abs() < 0.005,
            "{:?}",
            all[29].moment_nmm
        );
        // What all readings share is that of the difference from the free wire.
        assert!(
            (all[29].shared_nmm[0][0] - 0.2).abs() < 0.001
                && (all[29].zero_nmm2[(0, 0)] - 1e-2).abs() < 1e-9
        );
        // With a noise of their own the mean of ten knows more; less where it is slow.
        let of = |inefficiency: f64| {
            let own_nmm2 = Some(Matrix2::identity() * 1e-4);
            let known = |r: &Reading| Moments {
                own_nmm2,
                inefficiency,
                ..r.moments.clone().unwrap()
            };
            let mut zero = Zero::new(span_s);
            let all: Vec<Moments> = readings
                .iter()
                .map(|r| zero.applied(r.t_s, known(r)))
                .collect();
            all[29].zero_nmm2[(0, 0)]
        };
        assert!((of(1.0) - 1e-5).abs() < 1e-12 && (of(4.0) - 4e-5).abs() < 1e-12);
        // Control: the calibration's zero stays, with its own uncertainty.
        let plain = taken(&mut Zero::new(0.0), &readings[29]);
        assert!(
            (plain.moment_nmm[0] - 2.2).abs() < 0.005
                && (plain.zero_nmm2[(0, 0)] - 2.5e-3).abs() < 1e-9
        );
    }

    #[test]
    fn slow_noise_is_counted_and_white_noise_is_white() {
        // First-order Gauss-Markov noise of correlation phi from reading to reading: g = (1 + phi)
        // / (1 - phi).
        let g = |phi: f64| {
            let (mut state, mut last) = (7_u64, Vector2::zeros());
            let mut uniform = || {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            };
            let noise: Vec<Vector2<f64>> = (0..2000)
                .map(|_| {
                    last = last * phi + Vector2::new(uniform(), uniform());
                    last
                })
                .collect();
            inefficiency(&noise)
        };
        assert!(
            g(0.0) < 1.3 && (12.0..28.0).contains(&g(0.9)),
            "{} {}",
            g(0.0),
            g(0.9)
        );
    }

    #[test]
    fn a_record_that_begins_in_contact_has_no_free_beginning() {
        let FreeStart::Loaded(nmm) = beginning(&record(3.0), true) else {
            panic!("{:?}", beginning(&record(3.0), true))
        };
        assert!((nmm - 3.0).abs() < 0.01);
        // A calibration without the zero of the free wire takes the steady beginning for free.
        assert!(matches!(
            beginning(&record(3.0), false),
            FreeStart::Free { readings: 10, .. }
        ));
        assert_eq!(beginning(&record(0.0)[9..], true), FreeStart::Unknown);
        assert_eq!(beginning(&record(0.0)[..3], true), FreeStart::Unknown);
    }
}
