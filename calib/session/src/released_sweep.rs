//! The layout of the WhiskerFBG release (github hao-l1/WhiskerFBG, arXiv 2410.14005) for a sweep over an object, as readings along the
//! arm's way.
//!
//! The optical record has one row a sample at 2 kHz: wavelengths w_2 and w_6 (sensing) and w_4 (strain-isolated), nm. The arm's log has
//! `ind`, the number of a sample, and `py`, the arm's place then, m. The authors' filter, with n samples to the mean:
//!
//! `f_c(i) = 1/n sum_{j=0}^{n-1} w_c(i - j)`,   `z_c = mean of f_c over samples 1500 .. 1700`   (free wire)
//! `shift_c(i) = (f_c(i) - z_c) - (f_4(i) - z_4)`,   true of the time `(i - (n - 1) / 2) / rate`.

use crate::error::InputError;
use crate::text_table::TextTable;

/// Samples a second, samples of the trailing mean, and samples whose mean is the zero (first, one past the last).
const RATE_HZ: f64 = 2000.0;
const MEAN_SAMPLES: usize = 300;
const ZERO_SAMPLES: [usize; 2] = [1500, 1700];
/// Columns: the two sensing gratings, then the strain-isolated one.
const GRATINGS: [&str; 3] = ["fbg_2", "fbg_6", "fbg_4"];
/// Wavelengths of gratings in the C and L bands, nm.
const WAVELENGTHS_NM: [f64; 2] = [1450.0, 1650.0];
/// An arm reaches no farther than this, m: more is millimetres.
const MAX_REACH_M: f64 = 3.0;
/// A sweep that is shorter passes nothing, m.
const MIN_WAY_M: f64 = 1e-3;
/// More rows than this are no record that was meant: seven hours.
const MAX_SAMPLES: usize = 50_000_000;

/// A reading of the sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepReading {
    /// Time of validity since the first sample, s.
    pub t_s: f64,
    /// Temperature-compensated shifts of the two sensing gratings, nm.
    pub shift_nm: [f64; 2],
    /// Way of the arm, mm.
    pub way_mm: f64,
}

fn numbers(table: &TextTable, name: &str) -> Result<Vec<f64>, InputError> {
    let column = table.column(name)?;
    (0..table.rows.len())
        .map(|k| {
            let error =
                |found: &str| InputError::new(&table.file, "a number", found).at(table.rows[k].0).field(name);
            table.number(k, column)?.filter(|v| v.is_finite()).ok_or_else(|| error(&table.rows[k].1[column]))
        })
        .collect()
}

/// The optical record and the arm's log as readings, one at each row of the log at which both are known.
///
/// # Errors
/// A missing column, a cell that is no number, a record that ends before the zero or before the log does, wavelengths that are not
/// nanometres, ways that are not metres, sample numbers that do not go forward: by file, line and column.
pub fn released_sweep(optic: &TextTable, action: &TextTable) -> Result<Vec<SweepReading>, InputError> {
    let samples = optic.rows.len();
    if samples < ZERO_SAMPLES[1] {
        let expected = format!(
            "{} samples or more (the zero is the mean of samples {} to {})",
            ZERO_SAMPLES[1], ZERO_SAMPLES[0], ZERO_SAMPLES[1]
        );
        return Err(InputError::new(&optic.file, expected, samples.to_string()));
    }
    if samples > MAX_SAMPLES {
        return Err(InputError::new(
            &optic.file,
            format!("at most {MAX_SAMPLES} samples"),
            samples.to_string(),
        ));
    }
    // Sums up to each sample: a trailing mean is the difference of two. Counted from the first reading, so that few digits are lost.
    let mut sums = Vec::with_capacity(GRATINGS.len());
    for name in GRATINGS {
        let all = numbers(optic, name)?;
        let [low, high] = WAVELENGTHS_NM;
        if let Some(k) = all.iter().position(|w| !(low..=high).contains(w)) {
            let expected = format!("a wavelength in nm ({low} to {high})");
            return Err(InputError::new(&optic.file, expected, all[k].to_string())
                .at(optic.rows[k].0)
                .field(name));
        }
        let mut sum = vec![0.0];
        all.iter().for_each(|w| sum.push(sum[sum.len() - 1] + (w - all[0])));
        sums.push(sum);
    }
    let mean = |c: usize, i: usize| {
        let from = (i + 1).saturating_sub(MEAN_SAMPLES);
        (sums[c][i + 1] - sums[c][from]) / (i + 1 - from) as f64
    };
    let zero = |c: usize| {
        let [from, to] = ZERO_SAMPLES;
        (from..to).map(|i| mean(c, i)).sum::<f64>() / (to - from) as f64
    };
    let zeros = [0, 1, 2].map(zero);

    let (at, way_m) = (numbers(action, "ind")?, numbers(action, "py")?);
    let error = |k: usize, field: &str, expected: String, found: f64| {
        Err(InputError::new(&action.file, expected, found.to_string()).at(action.rows[k].0).field(field))
    };
    for (k, (i, y)) in at.iter().zip(&way_m).enumerate() {
        if !(*i >= 0.0 && *i < samples as f64 && i.fract() == 0.0) {
            return error(
                k,
                "ind",
                format!("the number of one of the {samples} samples of {}", optic.file),
                *i,
            );
        }
        if k > 0 && *i <= at[k - 1] {
            return error(k, "ind", format!("a later sample than {}", at[k - 1]), *i);
        }
        if y.abs() > MAX_REACH_M {
            return error(k, "py", format!("metres (an arm reaches {MAX_REACH_M} m)"), *y);
        }
    }
    let way = way_m.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], y| [a.min(*y), b.max(*y)]);
    if !(way[1] - way[0] >= MIN_WAY_M) {
        let expected = format!("a sweep of {MIN_WAY_M} m or more");
        return Err(InputError::new(&action.file, expected, (way[1] - way[0]).to_string()).field("py"));
    }
    // The mean is true of its middle: the arm's place is interpolated there.
    let lag = (MEAN_SAMPLES - 1) as f64 / 2.0;
    let reading = |i: &f64| {
        let middle = i - lag;
        let after = at.partition_point(|a| *a < middle);
        let before = after.checked_sub(1)?;
        let u = (middle - at[before]) / (at.get(after)? - at[before]);
        let f = [0, 1, 2].map(|c| mean(c, *i as usize) - zeros[c]);
        Some(SweepReading {
            t_s: middle / RATE_HZ,
            shift_nm: [f[0] - f[2], f[1] - f[2]],
            way_mm: 1e3 * (way_m[before] + (way_m[after] - way_m[before]) * u),
        })
    };
    let readings: Vec<SweepReading> = at.iter().filter_map(reading).collect();
    if readings.len() < 2 {
        let expected = "two rows or more that the record covers";
        return Err(InputError::new(&action.file, expected, readings.len().to_string()));
    }
    Ok(readings)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::text_table::{TextTableLayout, read_text_table};

    fn table(text: &str) -> TextTable {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        std::fs::write(&path, text).unwrap();
        read_text_table(&path, &TextTableLayout::default()).unwrap()
    }

    /// Gratings drift together by temperature; grating 2 feels a ramp of 1e-6 nm a sample from sample 2000 on.
    fn optic(samples: usize, scale: f64) -> TextTable {
        let mut text = "fbg_1,fbg_2,fbg_4,fbg_6\n".to_owned();
        for i in 0..samples {
            let warm = 1e-5 * i as f64;
            let bending = 1e-6 * (i as f64 - 2000.0).max(0.0);
            let w = [1540.0, 1545.0 + warm + bending, 1542.0 + warm, 1543.0 + warm].map(|w| w * scale);
            text += &format!("{},{},{},{}\n", w[0], w[1], w[2], w[3]);
        }
        table(&text)
    }

    fn action(scale: f64) -> TextTable {
        let mut text = ",py,ind\n".to_owned();
        for k in 0..20 {
            text += &format!("{k},{},{}\n", scale * (-0.1 + 0.0002 * f64::from(k)), 2500 + 100 * k);
        }
        table(&text)
    }

    #[test]
    fn shifts_are_filtered_zeroed_and_compensated_and_the_way_is_of_their_time() {
        let all = released_sweep(&optic(5000, 1.0), &action(1.0)).unwrap();
        // Two rows of the log are earlier than the middle of the first mean.
        assert_eq!(all.len(), 18);
        let first = all[0];
        assert!((first.t_s - (2700.0 - 149.5) / 2000.0).abs() < 1e-12, "{first:?}");
        assert!(
            (first.shift_nm[0] - 1e-6 * 550.5).abs() < 1e-9 && first.shift_nm[1].abs() < 1e-9,
            "{first:?}"
        );
        assert!((first.way_mm - (-100.0 + 0.2 * 0.505)).abs() < 1e-9, "{first:?}");
    }

    #[test]
    fn other_layouts_and_units_are_named() {
        let said = |o: &TextTable, a: &TextTable| released_sweep(o, a).unwrap_err().to_string();
        let bare = table("fbg_2,fbg_6\n1545,1543\n1545,1543\n");
        assert!(said(&bare, &action(1.0)).contains("1700 samples"), "{}", said(&bare, &action(1.0)));
        let rows = "1545,1543\n".repeat(1700);
        let bare = table(&format!("fbg_2,fbg_6\n{rows}"));
        assert!(said(&bare, &action(1.0)).contains("fbg_4"), "{}", said(&bare, &action(1.0)));
        let good = optic(5000, 1.0);
        assert!(said(&optic(5000, 1e-3), &action(1.0)).contains("wavelength in nm"));
        assert!(said(&good, &action(1e3)).contains("metres"));
        assert!(said(&good, &action(1e-3)).contains("a sweep of"));
        assert!(said(&optic(3000, 1.0), &action(1.0)).contains("one of the 3000 samples"));
        let back = table(",py,ind\n0,0.1,2500\n1,0.11,2400\n");
        let named = said(&good, &back);
        assert!(named.contains("later sample") && named.contains('3'), "{named}");
        let words = table(",py,ind\n0,here,2500\n1,0.11,2600\n");
        assert!(said(&good, &words).contains("py"));
    }
}
