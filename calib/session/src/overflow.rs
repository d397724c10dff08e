//! Values that an instrument writes where it has none: overflow and "not connected". A code is one of the usual numbers *and* lies further from the
//! column's other values than these lie from each other.

use crate::error::InputError;

/// No quantity of a calibration is this large: SCPI's 9.9e37 and 9.91e37, the largest float, 1e38 and their like.
const HUGE: f64 = 1e30;
/// Fewer values beside a code say nothing of their column.
const MIN_OTHERS: usize = 4;

/// One of the numbers that instruments use as codes: huge, all nines, an end of a converter's range, or a power-up value.
fn usual(value: f64) -> bool {
    let size = value.abs();
    let digits: Vec<char> = format!("{size}").chars().filter(char::is_ascii_digit).collect();
    let nines = digits.len() >= 3 && digits.iter().all(|d| *d == '9');
    // Ends of 7 to 32 bits: 127, 128, 255, ..., 32767, 8388607, 4294967295.
    let end = (7..=32).any(|bits| [2f64.powi(bits), 2f64.powi(bits) - 1.0].contains(&size));
    // DS18B20 after power-up reads 85; absolute zero is no reading.
    size >= HUGE || nines || end || value == 85.0 || value == -273.15
}

/// The codes among `values`. Half of a column and more is its content; what a person `set` is a code only where it is no quantity.
pub(crate) fn codes(values: &[f64], set: bool) -> Vec<f64> {
    let others: Vec<f64> = values.iter().copied().filter(|v| !usual(*v)).collect();
    let [low, high] =
        others.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)]);
    let far = |code: f64| others.len() >= MIN_OTHERS && (low - code).max(code - high) > high - low;
    let few = |code: f64| 2 * values.iter().filter(|v| **v == code).count() <= values.len();
    let is_code = |code: &f64| code.abs() >= HUGE || (!set && usual(*code) && far(*code) && few(*code));
    let mut found: Vec<f64> = values.iter().copied().filter(is_code).collect();
    found.sort_by(f64::total_cmp);
    found.dedup();
    found
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_told_from_readings_by_their_column() {
        let volts = [0.1, 0.2, 0.3, 0.4, 0.5];
        for code in
            [9.9e37, -9.9e37, 1e38, 3.4028234e38, 999_999.0, 9999.0, -127.0, 32767.0, 8_388_607.0, 99.99]
        {
            let with: Vec<f64> = volts.iter().copied().chain([code]).collect();
            assert_eq!(codes(&with, false), [code]);
        }
        // In range, or no further out than the others are wide: a reading.
        assert!(codes(&[-180.0, -127.0, -60.0, 20.0, 50.0], false).is_empty());
        assert!(codes(&[2e5, 4e5, 6e5, 8e5, 999_999.0, 1.2e6], false).is_empty());
        assert!(codes(&[1000.0, 9000.0, 20000.0, 30000.0, 32767.0], false).is_empty());
        // An unusual number, however far out, is a matter of the noise.
        assert!(codes(&[0.1, 0.2, 0.3, 0.4, 5000.0], false).is_empty());
        // Loads in powers of two are set so.
        let powers: Vec<f64> = (0..13).map(|k| 2f64.powi(k)).collect();
        assert!(codes(&powers, true).is_empty());
        assert_eq!(codes(&[0.0, 1.0, 2.0, 3.0, 9.9e37], true), [9.9e37]);
        // A huge number is none whatever stands beside it.
        assert_eq!(codes(&[0.1, 9.9e37], false), [9.9e37]);
        // Half of a column and more is its content.
        assert!(codes(&[0.1, 0.2, 0.3, 0.4, 9999.0, 9999.0, 9999.0, 9999.0, 9999.0], false).is_empty());
    }
}
