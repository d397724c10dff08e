//! Readings at a limit of the read-out: where the last settings of the stimulus all read the same
//! value, the extreme one, although the law of the others goes on, the reading is censored. It is
//! no measurement of the stimulus (Tobin 1958), and what it scatters by is no noise.

use super::frame::{Declared, ScalarRow};
use super::sequence::MIN_REPEATS;
use crate::method::{means, settings};
use crate::models::range;
use wcal_core::order_statistics::median;
use wcal_core::repeats::decimal_step;
use wcal_core::text::{number, with_unit};

/// What the law of the other settings goes on by beyond the limit, in resolvable steps: a coarse
/// gauge repeats itself, too.
const BEYOND_STEPS: f64 = 6.0;

/// A limit of the read-out.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeLimit {
    /// What it reads there.
    pub value: f64,
    /// Stimulus from which on it does, and the last one before.
    pub stimuli: [f64; 2],
    /// Where the readings come from: file, line and point.
    pub origins: Vec<(String, usize, i64)>,
}

impl RangeLimit {
    /// In a sentence; `unit` of the response.
    pub fn sentence(&self, unit: &str) -> String {
        let points = self.origins.iter().map(|origin| origin.2.to_string());
        let points: Vec<String> = points.collect();
        let unit = if unit == "1" { "" } else { unit };
        let [from, last] = self.stimuli.map(|stimulus| number(stimulus, 10));
        format!(
            "{} readings (points {}) stand at a limit of the read-out, {}, from the stimulus {from} on: they are no measurement and in no fit; the \
             calibration ends at {last}.",
            points.len(),
            points.join(", "),
            with_unit(&self.value.to_string(), unit)
        )
    }
}

/// What a reading shows: the response, or the measured position in mm.
pub(crate) fn read_out(row: &ScalarRow, declared: Declared) -> f64 {
    if declared == Declared::Axis {
        row.x + 1e-3 * row.y
    } else {
        row.y
    }
}

/// Limits at either end of the read-out, at most one each.
pub(crate) fn range_limits(rows: &[ScalarRow], declared: Declared) -> Vec<RangeLimit> {
    let x: Vec<f64> = rows.iter().map(|r| r.x).collect();
    let y: Vec<f64> = rows.iter().map(|r| read_out(r, declared)).collect();
    let setting = settings(&x);
    [f64::max as fn(f64, f64) -> f64, f64::min]
        .iter()
        .filter_map(|end| at_end(rows, &x, &y, &setting, *end))
        .collect()
}

fn at_end(
    rows: &[ScalarRow],
    x: &[f64],
    y: &[f64],
    setting: &[usize],
    end: fn(f64, f64) -> f64,
) -> Option<RangeLimit> {
    let value = y.iter().copied().reduce(end)?;
    let count = setting.iter().max()? + 1;
    let mut of: Vec<Vec<usize>> = vec![Vec::new(); count];
    setting.iter().enumerate().for_each(|(i, &k)| of[k].push(i));
    // Settings from either end of the stimulus that read nothing else, and one more that reads it
    // now and then.
    let all = |k: usize| of[k].iter().all(|&i| y[i] == value);
    let any = |k: usize| of[k].iter().any(|&i| y[i] == value);
    let upper = all(count - 1);
    let place = |k: usize| if upper { count - 1 - k } else { k };
    let full = (0..count).take_while(|&k| all(place(k))).count();
    let at = if full < count && any(place(full)) {
        full + 1
    } else {
        full
    };
    let censored: Vec<usize> = (0..at).flat_map(|k| of[place(k)].iter().copied()).collect();
    if full == 0 || count - at < 2 || (full == 1 && of[place(0)].len() < MIN_REPEATS) {
        return None;
    }
    // The law of the two settings next to the limit, at the far end of the stimulus.
    let [mx, my] = [x, y].map(|v| means(setting, v));
    let [near, next] = [place(at), place(at + 1)];
    // Straight on from the two settings before the limit.
    let expected =
        my[near] + (my[near] - my[next]) / (mx[near] - mx[next]) * (mx[place(0)] - mx[near]);
    // What the read-out resolves, and what the other settings scatter by.
    let others = || (at..count).map(|k| &of[place(k)]);
    let spread = |rows: &Vec<usize>| {
        let [low, high] = range(rows.iter().map(|&i| y[i]));
        high - low
    };
    let resolved = decimal_step(y)
        .unwrap_or_default()
        .max(median(others().map(spread)).unwrap_or_default());
    let repeats_scatter = others().filter(|rows| spread(rows) > 0.0).count() * 2 > count - at;
    // Only a law that would have gone on past the extreme value makes it a limit.
    let beyond =
        end(expected, value) == expected && (expected - value).abs() > BEYOND_STEPS * resolved;
    (beyond && (full > 1 || repeats_scatter)).then(|| RangeLimit {
        value,
        stimuli: [mx[place(at - 1)], mx[near]],
        origins: censored.iter().map(|&i| rows[i].origin.clone()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::row::bare;
    use super::*;

    fn rows(read: impl Fn(f64, usize) -> f64) -> Vec<ScalarRow> {
        let x = |k: usize| 10.0 * (k % 11) as f64;
        let row = |k: usize| bare(k, x(k), read(x(k), k));
        (0..33).map(row).collect()
    }

    #[test]
    fn settings_that_all_read_the_extreme_are_a_limit_and_a_coarse_or_saturating_sensor_has_none() {
        let noise = |k: usize| 1e-3 * ((k * 37 % 13) as f64 - 6.0);
        let linear = Declared::Polynomial(1);
        let clipped = rows(|x, k| (0.15 + 0.1 * x + noise(k)).min(8.1921));
        let found = range_limits(&clipped, linear);
        assert_eq!(found.len(), 1);
        assert_eq!(
            (found[0].value, found[0].stimuli, found[0].origins.len()),
            (8.1921, [90.0, 80.0], 6)
        );
        let low = range_limits(&rows(|x, k| (0.1 * x - 2.5 + noise(k)).max(0.0)), linear);
        assert_eq!((low.len(), low[0].stimuli), (1, [20.0, 30.0]));
        // Only the last setting clips.
        assert_eq!(
            range_limits(&rows(|x, k| (0.1 * x + noise(k)).min(9.5)), linear)[0].stimuli,
            [100.0, 90.0]
        );
        // Controls: no limit, whole units, a response that bends and goes on scattering.
        for free in [
            rows(|x, k| 0.1 * x + noise(k)),
            rows(|x, _| (0.04 * x).round()),
            rows(|x, k| 10.0 * (x / 40.0).tanh() + noise(k)),
        ] {
            assert_eq!(range_limits(&free, linear), Vec::new());
        }
    }
}
