//! Which readings can be used at all.

use super::frame::{Declared, ScalarRow, Scaling};
use crate::verify::copied_holdout::{ComparedRow, bits, copied_holdout};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::collections::BTreeMap;
use wcal_core::Sealed;
use wcal_core::repeats::decimal_step;

/// Fewer readings than this are refused.
const MIN_ROWS: usize = 8;
/// The search takes at most this many readings of a session; all are predicted.
const MAX_ROWS: usize = 1000;

/// Why the readings of the points table cannot be used; `sealed` are those of the holdout.
pub(super) fn refusal(
    rows: &[ScalarRow],
    sealed: &Sealed<ScalarRow>,
    scaling: &Scaling,
    declared: Declared,
) -> Option<String> {
    let parameters = match declared {
        Declared::Polynomial(degree) => degree + 1,
        Declared::Axis => 1,
    };
    if rows.len() < MIN_ROWS {
        return Some(format!("{} readings; at least {MIN_ROWS} are needed", rows.len()));
    }
    let not_finite = |rows: &[ScalarRow]| {
        let bad = rows.iter().find(|r| !r.x.is_finite() || !r.y.is_finite())?;
        Some(format!("reading {} of {} is not a finite number", bad.origin.2, bad.origin.0))
    };
    if let Some(why) = not_finite(rows).or_else(|| sealed.refusal(not_finite)) {
        return Some(why);
    }
    let mut x: Vec<f64> = rows.iter().map(|r| r.x).collect();
    x.sort_by(f64::total_cmp);
    x.dedup();
    if x.len() < parameters || (parameters > 1 && !(scaling.half > 0.0)) {
        let count = x.len();
        return Some(
            declared.format_text(&format!(
                "{count} different stimuli do not determine {parameters} coefficients"
            )),
        );
    }
    let fitted: Vec<ComparedRow> = rows.iter().map(compared).collect();
    clock_fault(rows.iter().map(|r| r.t_s))
        .or_else(|| {
            sealed.refusal(|sealed| copied_holdout(&fitted, &sealed.iter().map(compared).collect::<Vec<_>>()))
        })
        .or_else(|| sealed.refusal(|sealed| jittered_holdout(rows, sealed)))
        .or_else(|| constant_response(rows, declared))
        .or_else(|| mistyped(rows, declared).map(|why| declared.format_text(&why)))
}

/// One value throughout, where the declared model follows the stimulus.
fn constant_response(rows: &[ScalarRow], declared: Declared) -> Option<String> {
    let first = rows.first()?.y;
    let stuck =
        matches!(declared, Declared::Polynomial(degree) if degree > 0) && rows.iter().all(|r| r.y == first);
    stuck.then(|| format!("the response is {first} in every reading: no sensitivity to the stimulus"))
}

/// Where the clock of a table in file order runs backwards, in words.
pub fn clock_fault(times: impl Iterator<Item = Option<f64>>) -> Option<String> {
    let times: Vec<f64> = times.flatten().collect();
    let k = times.windows(2).position(|w| w[1] < w[0])?;
    Some(format!(
        "the clock runs backwards after reading {} (t_s {} follows {})",
        k + 1,
        times[k + 1],
        times[k]
    ))
}

/// A reading as it is compared with those of the points table.
fn compared(r: &ScalarRow) -> ComparedRow {
    let more = [r.temperature_degc, r.cycle.map(f64::from)];
    ComparedRow {
        setting: bits(&[Some(r.x), r.direction]),
        reading: vec![r.y],
        rest: more.into_iter().chain(r.covariates.iter().map(|v| Some(*v))).map(|v| bits(&[v])[0]).collect(),
        t_s: r.t_s,
    }
}

/// Sealed readings that agree with fitted ones of the same stimulus far better than these agree with each other: copies with a little noise
/// added. Fisher's combination of the chances that m repeats come as near; asked only where repeats tell the noise.
fn jittered_holdout(rows: &[ScalarRow], sealed: &[ScalarRow]) -> Option<String> {
    /// Degrees of freedom of the repeats, and sealed readings, below which nothing is said.
    const MIN_DOF: usize = 8;
    const MIN_SEALED: usize = 5;
    /// An accusation: not once in a million honest sessions.
    const LEVEL: f64 = 1e-6;
    let mut cells: BTreeMap<[u64; 2], Vec<f64>> = BTreeMap::new();
    let key = |r: &ScalarRow| [(r.x + 0.0).to_bits(), r.direction.unwrap_or(0.0).to_bits()];
    rows.iter().for_each(|r| cells.entry(key(r)).or_default().push(r.y));
    let (mut square, mut dof) = (0.0, 0);
    for y in cells.values() {
        let mean = y.iter().sum::<f64>() / y.len() as f64;
        square += y.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        dof += y.len() - 1;
    }
    let sd = (square / dof.max(1) as f64).sqrt();
    if dof < MIN_DOF || !(sd > 0.0) {
        return None;
    }
    // What rounding makes equal is no nearer than half a digit.
    let step = decimal_step(&rows.iter().map(|r| r.y).collect::<Vec<f64>>()).unwrap_or(0.0);
    let chances: Vec<f64> = sealed
        .iter()
        .filter_map(|r| {
            let own = cells.get(&key(r))?;
            let nearest = own.iter().map(|y| (y - r.y).abs()).fold(f64::INFINITY, f64::min).max(0.5 * step);
            let single = statrs::function::erf::erf(nearest / (2.0 * sd));
            Some((1.0 - (1.0 - single).powi(i32::try_from(own.len()).unwrap_or(i32::MAX))).max(1e-12))
        })
        .collect();
    if chances.len() < MIN_SEALED {
        return None;
    }
    let statistic = -2.0 * chances.iter().map(|p| p.ln()).sum::<f64>();
    let chance = ChiSquared::new(2.0 * chances.len() as f64).map_or(1.0, |d| d.sf(statistic));
    (chance < LEVEL).then(|| {
        format!(
            "{} rows of the holdout agree with fitted ones better than repeats do (p = {chance:.0e}): copies with a little noise prove nothing",
            chances.len()
        )
    })
}

/// Factors of a decimal point in the wrong place.
const DECIMALS: [f64; 6] = [10.0, 0.1, 100.0, 0.01, 1e3, 1e-3];
/// Standard deviations beyond which a reading contradicts the others, and within which it agrees once the decimal point is moved.
const CONTRADICTS: f64 = 20.0;
const AGREES: f64 = 4.0;
/// More levels than this are no table that was typed.
const MAX_LEVELS: usize = 200;

/// A level that contradicts all others, and agrees with them once the decimal point of its stimulus or its responses is moved.
fn mistyped(rows: &[ScalarRow], declared: Declared) -> Option<String> {
    let (degree, axis) = match declared {
        Declared::Polynomial(0) => return None,
        Declared::Polynomial(degree) => (degree, false),
        Declared::Axis => (1, true),
    };
    let y = |r: &ScalarRow| if axis { r.x + 1e-3 * r.y } else { r.y };
    let mut levels: Vec<f64> = rows.iter().map(|r| r.x).collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    if levels.len() < degree + 4 || levels.len() > MAX_LEVELS {
        return None;
    }
    levels.iter().find_map(|&level| {
        let (own, others): (Vec<&ScalarRow>, Vec<&ScalarRow>) = rows.iter().partition(|r| r.x == level);
        let (low, high) = others.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), r| (a.min(r.x), b.max(r.x)));
        let curve = Curve::fit(&others.iter().map(|r| (r.x, y(r))).collect::<Vec<_>>(), degree)?;
        let wrong: Vec<&ScalarRow> =
            own.iter().copied().filter(|r| curve.deviation(r.x, y(r)) > CONTRADICTS).collect();
        // A single reading within the others' range is an outlier like any other.
        let first = *wrong.first().filter(|r| wrong.len() > 1 || r.x < low || r.x > high)?;
        let agrees = |stimulus: f64, response: f64| {
            wrong.iter().all(|r| curve.deviation(stimulus * r.x, response * y(r)) < AGREES)
        };
        let count = wrong.len();
        DECIMALS.into_iter().find_map(|factor| {
            let right = first.x * factor;
            if agrees(factor, 1.0) && first.x != 0.0 {
                return Some(format!(
                    "the stimulus {level} of {count} readings contradicts all others: their responses are those of {right} (a decimal point in the wrong place?)"
                ));
            }
            (agrees(1.0, factor) && count > 1).then(|| {
                format!(
                    "{count} responses at the stimulus {level} contradict all others: times {factor} they agree (a decimal point in the wrong place?)"
                )
            })
        })
    })
}

/// A polynomial by least squares that knows how well it predicts.
struct Curve {
    middle: f64,
    half: f64,
    degree: usize,
    coefficients: nalgebra::DVector<f64>,
    inverse: nalgebra::DMatrix<f64>,
    sd: f64,
}

impl Curve {
    fn powers(&self, x: f64) -> nalgebra::DVector<f64> {
        let u = (x - self.middle) / self.half;
        nalgebra::DVector::from_fn(self.degree + 1, |k, _| u.powi(k as i32))
    }

    fn fit(pairs: &[(f64, f64)], degree: usize) -> Option<Self> {
        let [low, high] =
            pairs.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], p| [a.min(p.0), b.max(p.0)]);
        let mut curve = Self {
            middle: 0.5 * (low + high),
            half: 0.5 * (high - low),
            degree,
            coefficients: nalgebra::DVector::zeros(degree + 1),
            inverse: nalgebra::DMatrix::zeros(degree + 1, degree + 1),
            sd: 0.0,
        };
        let dof = pairs.len().checked_sub(degree + 2).filter(|_| high > low)? + 1;
        let mut normal = nalgebra::DMatrix::zeros(degree + 1, degree + 1);
        let mut right = nalgebra::DVector::zeros(degree + 1);
        for (x, y) in pairs {
            let p = curve.powers(*x);
            normal += &p * p.transpose();
            right += p * *y;
        }
        curve.inverse = normal.try_inverse()?;
        curve.coefficients = &curve.inverse * right;
        let left: f64 =
            pairs.iter().map(|(x, y)| (y - curve.powers(*x).dot(&curve.coefficients)).powi(2)).sum();
        // Readings that agree to the last bit are as good as their rounding.
        let rounding = 1e-12 * pairs.iter().map(|p| p.1.abs()).fold(0.0, f64::max);
        curve.sd = (left / dof as f64).sqrt().max(rounding);
        (curve.sd > 0.0).then_some(curve)
    }

    /// Distance of a reading from the prediction in standard deviations of both.
    fn deviation(&self, x: f64, y: f64) -> f64 {
        let p = self.powers(x);
        let spread = 1.0 + p.dot(&(&self.inverse * &p));
        (y - p.dot(&self.coefficients)).abs() / (self.sd * spread.sqrt())
    }
}

/// Parts of the stimulus that are sampled alike.
const BINS: usize = 40;

/// At most [`MAX_ROWS`] readings for the search, chosen by strata (part of the stimulus, direction, cycle) so that nothing that alternates
/// from row to row is lost; in each stratum spread evenly over the session from a place of its own. All rows carry their place.
pub(super) fn thin(mut rows: Vec<ScalarRow>) -> Vec<ScalarRow> {
    let total = rows.len();
    if total <= MAX_ROWS {
        return rows;
    }
    let [lo, hi] = rows.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], r| [a.min(r.x), b.max(r.x)]);
    let bin = |x: f64| (((x - lo) / (hi - lo).max(1e-300)) * BINS as f64).min(BINS as f64 - 1.0) as usize;
    let mut strata: BTreeMap<(usize, i8, u32), Vec<usize>> = BTreeMap::new();
    for (k, r) in rows.iter().enumerate() {
        // Without a column the direction is that of the step from the row before.
        let step = k.checked_sub(1).map_or(0.0, |j| r.x - rows[j].x);
        let direction = r.direction.unwrap_or(if step == 0.0 { 0.0 } else { step.signum() });
        strata.entry((bin(r.x), direction as i8, r.cycle.unwrap_or(0))).or_default().push(k);
    }
    let mut kept = vec![false; total];
    for (s, members) in strata.values().enumerate() {
        let share = ((members.len() * MAX_ROWS) as f64 / total as f64).max(1.0) as usize;
        let stride = members.len() as f64 / share as f64;
        // The golden ratio's multiples lie evenly between 0 and 1: no two strata keep the same phase.
        let phase = (s as f64 * 0.618_034).fract();
        for j in 0..share {
            kept[members[(((j as f64 + phase) * stride) as usize).min(members.len() - 1)]] = true;
        }
    }
    let mut keep = kept.iter();
    rows.retain(|_| *keep.next().unwrap_or(&false));
    rows
}

/// Gives every reading its place in the order of the measurement.
pub(super) fn number(rows: &mut [ScalarRow]) {
    let mut order: Vec<usize> = (0..rows.len()).collect();
    if rows.iter().all(|r| r.t_s.is_some()) {
        order.sort_by(|&a, &b| rows[a].t_s.unwrap_or(0.0).total_cmp(&rows[b].t_s.unwrap_or(0.0)));
    }
    for (place, k) in order.into_iter().enumerate() {
        rows[k].place = Some(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::observation::Role;

    fn rows(n: usize) -> Vec<ScalarRow> {
        let row = |k: usize| ScalarRow {
            origin: ("t.csv".into(), k + 2, k as i64),
            role: Role::Calibration,
            x: (k / 2 % 50) as f64,
            y: 0.0,
            t_s: None,
            temperature_degc: None,
            direction: Some(if k.is_multiple_of(2) { 1.0 } else { -1.0 }),
            cycle: None,
            covariates: Vec::new(),
            place: None,
        };
        (0..n).map(row).collect()
    }

    #[test]
    fn both_directions_of_alternating_rows_are_kept_alike() {
        let mut all = rows(2000);
        number(&mut all);
        let kept = thin(all.clone());
        let up = kept.iter().filter(|r| r.direction == Some(1.0)).count();
        assert!(kept.len() <= 1100 && kept.len() >= 800, "{}", kept.len());
        assert!(up.abs_diff(kept.len() - up) < kept.len() / 10, "{up} of {}", kept.len());
        assert!(kept.iter().all(|r| r.place == Some(r.origin.2 as usize)));
        // Control: every second row has one direction only.
        assert!(all.iter().step_by(2).all(|r| r.direction == Some(1.0)));
        assert_eq!(thin(rows(900)).len(), 900);
    }

    /// `sweeps` repeats of ten stimuli; the reading of number and stimulus.
    fn table(sweeps: usize, y: impl Fn(usize, f64) -> f64) -> Vec<ScalarRow> {
        let of = |(k, r): (usize, ScalarRow)| {
            let x = (k % 10) as f64;
            ScalarRow { x, y: y(k, x), direction: None, ..r }
        };
        rows(10 * sweeps).into_iter().enumerate().map(of).collect()
    }

    fn scatter(k: usize) -> f64 {
        (k as f64 * 12.9898).sin() * 43758.5453 % 1.0
    }

    fn copied(points: &[ScalarRow], sealed: &[ScalarRow]) -> Option<String> {
        let of = |rows: &[ScalarRow]| rows.iter().map(compared).collect::<Vec<_>>();
        copied_holdout(&of(points), &of(sealed))
    }

    #[test]
    fn a_holdout_that_was_in_the_fit_is_refused_and_an_honest_one_is_not() {
        let points = table(4, |k, x| 2.0 * x + 0.1 * scatter(k));
        let again = |jitter: f64| -> Vec<ScalarRow> {
            let moved = |r: &ScalarRow| ScalarRow { y: r.y + jitter * scatter(r.origin.1), ..r.clone() };
            points[10..20].iter().map(moved).collect()
        };
        assert!(copied(&points, &again(0.0)).is_some());
        assert!(jittered_holdout(&points, &again(1e-4)).is_some());
        let honest = table(2, |k, x| 2.0 * x + 0.1 * scatter(k + 1000));
        assert!(jittered_holdout(&points, &honest).is_none() && copied(&points, &honest).is_none());
        // A coarse gauge reads the same again.
        let coarse = table(4, |k, x| (2.0 * x + 0.01 * scatter(k)).round());
        let sealed = table(2, |k, x| (2.0 * x + 0.01 * scatter(k + 1000)).round());
        assert!(copied(&coarse, &sealed).is_none() && jittered_holdout(&coarse, &sealed).is_none());
    }
}
