//! Values that an instrument writes where it has none: overflow and "not connected". Which those are shows in their column, not in a list:
//! a code is one of the usual numbers *and* lies further from the column's other values than these lie from each other.

use crate::error::InputError;
use std::collections::BTreeMap;

/// No quantity of a calibration is this large: SCPI's 9.9e37 and 9.91e37, the largest float, 1e38 and their like.
const HUGE: f64 = 1e30;
/// More rows than this share are no single overflows.
const MAX_SHARE: f64 = 0.5;
/// Fewer values beside a code say nothing of their column.
const MIN_OTHERS: usize = 4;

/// One of the numbers that instruments use as codes: huge, all nines, an end of a converter's range, or a power-up value.
fn usual(value: f64) -> bool {
    let size = value.abs();
    if size >= HUGE {
        return true;
    }
    let digits: Vec<char> = format!("{size}").chars().filter(char::is_ascii_digit).collect();
    let nines = digits.len() >= 3 && digits.iter().all(|d| *d == '9');
    // Ends of 7 to 32 bits: 127, 128, 255, ..., 32767, 8388607, 4294967295.
    let end = (7..=32).any(|bits| {
        let power = 2f64.powi(bits);
        size == power || size == power - 1.0
    });
    // DS18B20 after power-up reads 85; absolute zero is no reading.
    nines || end || value == 85.0 || value == -273.15
}

/// How a column is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColumnSource {
    /// Set by the operator: progressions such as 1, 2, 4, ..., 4096 are usual.
    Setting,
    /// Read from an instrument.
    Reading,
}

impl ColumnSource {
    /// Distance from the other values in their range, from which on a usual code is one.
    fn distance(self) -> f64 {
        match self {
            // Further out than the next decade of a progression.
            Self::Setting => 30.0,
            Self::Reading => 1.0,
        }
    }
}

/// The codes among `values`; `expected` gives what the other columns of a code's rows let expect, so that a value in line with them stays.
pub(crate) fn codes(values: &[f64], kind: ColumnSource, expected: impl Fn(f64) -> Option<f64>) -> Vec<f64> {
    let mut count: BTreeMap<u64, usize> = BTreeMap::new();
    for v in values.iter().filter(|v| usual(**v)) {
        *count.entry(v.to_bits()).or_default() += 1;
    }
    let is_code = |code: f64, rows: usize| {
        // Several codes stand in one column of readings; a setting is judged beside all other settings.
        let beside = |v: &f64| match kind {
            ColumnSource::Reading => !usual(*v),
            ColumnSource::Setting => *v != code && v.abs() < HUGE,
        };
        let others: Vec<f64> = values.iter().copied().filter(beside).collect();
        if kind == ColumnSource::Reading && code.abs() >= HUGE {
            return true;
        }
        if others.len() < MIN_OTHERS {
            return false;
        }
        let low = others.iter().copied().fold(f64::INFINITY, f64::min);
        let high = others.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let outside = (low - code).max(code - high);
        #[allow(clippy::cast_precision_loss)]
        let few = rows as f64 <= MAX_SHARE * values.len() as f64;
        let far = outside > kind.distance() * (high - low) && outside > 0.0;
        // Nearer to what the row lets expect than a quarter of the way to the others: it is a reading.
        let in_line = || expected(code).is_some_and(|e| (code - e).abs() < 0.25 * outside);
        few && far && (code.abs() >= HUGE || !in_line())
    };
    count
        .into_iter()
        .map(|(bits, rows)| (f64::from_bits(bits), rows))
        .filter(|(v, n)| is_code(*v, *n))
        .map(|c| c.0)
        .collect()
}

/// Refuses a column in which most rows hold a code: it is no column of readings.
///
/// # Errors
/// Where `coded` rows are more than half of `of`.
pub(crate) fn refuse_most(file: &str, column: &str, coded: usize, of: usize) -> Result<(), InputError> {
    if 2 * coded <= of {
        return Ok(());
    }
    let found = format!("overflow values in {coded} of {of} rows");
    Err(InputError::new(file, "readings in most rows", found).field(column))
}

/// Median slope and the line through the medians (Theil 1950, Sen 1968) of rows that hold no usual code, at `x`.
pub(crate) fn line_at(rows: &[(f64, f64)], x: f64) -> Option<f64> {
    /// Rows that are paired; more tell no more.
    const MAX_ROWS: usize = 200;
    let plain: Vec<(f64, f64)> = rows.iter().copied().filter(|r| !usual(r.1) && r.0.abs() < HUGE).collect();
    let some: Vec<(f64, f64)> =
        plain.iter().copied().step_by(plain.len().div_ceil(MAX_ROWS).max(1)).collect();
    let slopes: Vec<f64> = some
        .iter()
        .enumerate()
        .flat_map(|(i, a)| some[..i].iter().map(move |b| (a.1 - b.1) / (a.0 - b.0)))
        .filter(|s| s.is_finite())
        .collect();
    let slope = median(slopes)?;
    let start = median(some.iter().map(|r| r.1 - slope * r.0).collect())?;
    Some(start + slope * x)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(values: &[f64], kind: ColumnSource) -> Vec<f64> {
        codes(values, kind, |_| None)
    }

    #[test]
    fn codes_are_told_from_readings_by_their_column() {
        let volts = [0.1, 0.2, 0.3, 0.4, 0.5];
        for code in
            [9.9e37, -9.9e37, 1e38, 3.4028234e38, 999_999.0, 9999.0, -127.0, 32767.0, 8_388_607.0, 99.99]
        {
            let with: Vec<f64> = volts.iter().copied().chain([code]).collect();
            assert_eq!(found(&with, ColumnSource::Reading), [code]);
        }
        // In range, or no further out than the others are wide: a reading.
        assert!(found(&[-180.0, -127.0, -60.0, 20.0, 50.0], ColumnSource::Reading).is_empty());
        assert!(found(&[2e5, 4e5, 6e5, 8e5, 999_999.0, 1.2e6], ColumnSource::Reading).is_empty());
        assert!(found(&[1000.0, 9000.0, 20000.0, 30000.0, 32767.0], ColumnSource::Reading).is_empty());
        // An unusual number, however far out, is a matter of the noise.
        assert!(found(&[0.1, 0.2, 0.3, 0.4, 5000.0], ColumnSource::Reading).is_empty());
        // Loads in powers of two are set so.
        let powers: Vec<f64> = (0..13).map(|k| 2f64.powi(k)).collect();
        assert!(found(&powers, ColumnSource::Setting).is_empty());
        assert_eq!(found(&[0.0, 1.0, 2.0, 3.0, 9.9e37], ColumnSource::Setting), [9.9e37]);
        // A huge number is none whatever stands beside it.
        assert_eq!(found(&[0.1, 9.9e37], ColumnSource::Reading), [9.9e37]);
        // Half of a column and more is its content.
        assert!(
            found(&[0.1, 0.2, 0.3, 0.4, 9999.0, 9999.0, 9999.0, 9999.0, 9999.0], ColumnSource::Reading)
                .is_empty()
        );
    }

    #[test]
    fn a_reading_in_line_with_its_stimulus_stays() {
        let rows: Vec<(f64, f64)> = (0..8).map(|k| (f64::from(k), 10.0 * f64::from(k))).collect();
        assert_eq!(line_at(&rows, 99.9), Some(999.0));
        let values: Vec<f64> = rows.iter().map(|r| r.1).chain([999.0]).collect();
        assert!(codes(&values, ColumnSource::Reading, |_| line_at(&rows, 99.9)).is_empty());
        assert_eq!(codes(&values, ColumnSource::Reading, |_| line_at(&rows, 4.0)), [999.0]);
    }
}
