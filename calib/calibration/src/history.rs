//! Calibrations of one unit over time.
//!
//! ```text
//! E_n = |a - b| / sqrt(U_a^2 + U_b^2)                        two calibrations differ where it is above 1 (ISO/IEC 17043)
//! q(t) = q_0 + r t, weights 1 / u_i^2                        drift r of a quantity
//! |r| h + U_r h + U = 2 U                                    the time h after which a drift may cost as much as U
//! ```
//!
//! Why it drifts, calibrations alone do not say.

use crate::artefact::{CalibrationModel, read_calibration};
use crate::error::CalibrationError;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use wcal_core::data_sheet::DataSheet;
use wcal_core::text::{number, readable, with_unit};

/// Days of a month, mean of the Gregorian calendar.
const MONTH_DAYS: f64 = 30.436_875;
/// Half width of a 95 % interval in standard deviations.
const NORMAL_95: f64 = 1.96;
/// Longest time until the next calibration that is named, months.
const LONGEST_MONTHS: f64 = 60.0;
/// Calibrations that make a drift.
const LEAST: usize = 3;
/// Most files that are looked at.
const MOST: usize = 1000;

/// One calibration of the unit.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct HistoryEntry {
    /// File.
    pub file: PathBuf,
    /// When it was made, RFC 3339.
    pub created: String,
    /// Months since the first one.
    pub months: f64,
    /// Sensitivity and zero with their 95 % half widths; zero null where 0 is not in the range.
    pub sensitivity: [f64; 2],
    /// See `sensitivity`.
    pub zero: Option<[f64; 2]>,
    /// Expanded uncertainty of a reading, in the unit of the stimulus; null where it has none.
    pub expanded: Option<f64>,
}

/// What became of a quantity.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct QuantityHistory {
    /// `sensitivity` or `zero`.
    pub quantity: String,
    /// Unit.
    pub unit: String,
    /// E_n of each calibration against the one before.
    pub e_n: Vec<f64>,
    /// Change a month with its 95 % interval; null with fewer than three calibrations.
    pub per_month: Option<[f64; 3]>,
    /// Value of that line at the first calibration.
    pub at_first: Option<f64>,
    /// What it may be off before it alone costs the stated uncertainty of a reading; null where none
    /// is stated.
    pub limit: Option<f64>,
}

/// All of it.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct CalibrationHistory {
    /// Format and version.
    #[schemars(extend("const" = "wcal-history/1"))]
    pub format: String,
    /// A calibration of a simulated session is among them.
    pub simulated: bool,
    /// Calibrations, the oldest first.
    pub entries: Vec<HistoryEntry>,
    /// Sensitivity and zero.
    pub quantities: Vec<QuantityHistory>,
    /// Day until which the drift costs less than the stated uncertainty; null where none is known.
    pub recalibrate_by: Option<String>,
    /// The same, months since the first calibration.
    pub recalibrate_month: Option<f64>,
}

/// The calibrations in `folder`, or one folder below it.
///
/// # Errors
/// A file that cannot be read, fewer than two calibrations of transducers, or other units.
pub fn history(folder: &Path) -> Result<CalibrationHistory, CalibrationError> {
    let (mut found, mut simulated) = (Vec::new(), false);
    for file in files(folder)? {
        let read = read_calibration(&file)?;
        let CalibrationModel::Scalar(model) = &read.model else {
            continue;
        };
        let Some(sheet) = model.data_sheet() else {
            continue;
        };
        let created: jiff::Timestamp = read.provenance.created.parse().map_err(|e| {
            CalibrationError::content(&file, format!("provenance.created: expected a time: {e}"))
        })?;
        simulated |= read.provenance.simulated;
        found.push((created, file, sheet));
    }
    found.sort_by_key(|(created, _, _)| *created);
    let Some((first, _, sheet)) = found.first().filter(|_| found.len() > 1) else {
        let detail = format!(
            "expected two calibrations of a transducer or more, found {}",
            found.len()
        );
        return Err(CalibrationError::content(folder, detail));
    };
    let (first, units) = (*first, units(sheet));
    let mut entries = Vec::new();
    for (created, file, sheet) in &found {
        if self::units(sheet) != units {
            let detail = format!("expected units {units:?}, found {:?}", self::units(sheet));
            return Err(CalibrationError::content(file, detail));
        }
        let value = |name: &str| {
            let c = sheet.characteristics.iter().find(|c| c.name == name)?;
            Some([c.value, c.half95?])
        };
        let Some(sensitivity) = value("sensitivity") else {
            return Err(CalibrationError::content(
                file,
                "expected a sensitivity, found none",
            ));
        };
        entries.push(HistoryEntry {
            file: file.clone(),
            created: created.to_string(),
            months: created.duration_since(first).as_secs_f64() / 86_400.0 / MONTH_DAYS,
            sensitivity,
            zero: value("zero"),
            expanded: sheet.uncertainty.as_ref().map(|u| u.expanded),
        });
    }
    let zeros: Option<Vec<[f64; 2]>> = entries.iter().map(|e| e.zero).collect();
    let months: Vec<f64> = entries.iter().map(|e| e.months).collect();
    let worth = worth(&found, &entries);
    let of = |quantity: &str, unit: &str, values: Vec<[f64; 2]>| {
        let (per_month, at_first) = drift(&months, &values).unzip();
        let worth = worth.map(|[expanded, sensitivity, zero]| match quantity {
            "sensitivity" => expanded / sensitivity,
            _ => expanded / zero,
        });
        QuantityHistory {
            quantity: quantity.to_owned(),
            unit: unit.to_owned(),
            e_n: values.windows(2).map(|p| e_n(p[0], p[1])).collect(),
            per_month,
            at_first,
            limit: worth.filter(|limit| limit.is_finite()),
        }
    };
    let slopes = entries.iter().map(|e| e.sensitivity).collect();
    let mut quantities = vec![of("sensitivity", &units[1], slopes)];
    quantities.extend(zeros.map(|zeros| of("zero", &units[2], zeros)));
    let (recalibrate_by, recalibrate_month) = recalibrate_by(&found, &entries, &quantities).unzip();
    Ok(CalibrationHistory {
        format: "wcal-history/1".to_owned(),
        simulated,
        entries,
        quantities,
        recalibrate_by,
        recalibrate_month,
    })
}

/// Expanded uncertainty of a reading of the last calibration, and what a change of the sensitivity
/// and of the zero by 1 costs, all in the unit of the stimulus.
fn worth(
    found: &[(jiff::Timestamp, PathBuf, DataSheet)],
    entries: &[HistoryEntry],
) -> Option<[f64; 3]> {
    let (entry, (_, _, sheet)) = (entries.last()?, found.last()?);
    let slope = entry.sensitivity[0].abs();
    let reach = sheet.range[0].abs().max(sheet.range[1].abs());
    // A share of the stimulus, or a shift of all.
    Some([entry.expanded?, reach / slope, 1.0 / slope])
}

/// calibration.json files in a folder and one below.
fn files(folder: &Path) -> Result<Vec<PathBuf>, CalibrationError> {
    let listed = |folder: &Path| -> Result<Vec<PathBuf>, CalibrationError> {
        let io = |source| CalibrationError::Io {
            path: folder.to_owned(),
            source,
        };
        let entries = std::fs::read_dir(folder).map_err(io)?;
        let mut all: Vec<PathBuf> = entries.flatten().map(|e| e.path()).take(MOST).collect();
        all.sort();
        Ok(all)
    };
    let is_own = |path: &PathBuf| {
        let name = path
            .file_name()
            .and_then(|n| n.to_str())
            .unwrap_or_default();
        // One that was judged as failed is a copy.
        let is_named = name.contains("calibration") && name.ends_with(".json");
        path.is_file() && is_named && !name.starts_with("judged-")
    };
    let mut found = Vec::new();
    for path in listed(folder)? {
        if path.is_dir() {
            found.extend(listed(&path)?.into_iter().filter(is_own));
        } else if is_own(&path) {
            found.push(path);
        }
    }
    Ok(found)
}

/// Units of the stimulus, the sensitivity and the zero.
fn units(sheet: &DataSheet) -> [String; 3] {
    let of = |name: &str| {
        let c = sheet.characteristics.iter().find(|c| c.name == name);
        c.map(|c| c.unit.clone()).unwrap_or_default()
    };
    [sheet.range_unit.clone(), of("sensitivity"), of("zero")]
}

fn e_n(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).abs() / a[1].hypot(b[1]).max(f64::MIN_POSITIVE)
}

/// Slope over time with its 95 % interval, and the line's value at the first time.
fn drift(months: &[f64], values: &[[f64; 2]]) -> Option<([f64; 3], f64)> {
    // Calibrations of one day say nothing of a month.
    let span = months.last()? - months.first()?;
    if values.len() < LEAST || span < 1.0 / MONTH_DAYS {
        return None;
    }
    let weight = |v: &[f64; 2]| (NORMAL_95 / v[1].max(f64::MIN_POSITIVE)).powi(2);
    let sum = |f: &dyn Fn(usize) -> f64| -> f64 {
        (0..values.len()).map(|k| weight(&values[k]) * f(k)).sum()
    };
    let total = sum(&|_| 1.0);
    let middle = sum(&|k| months[k]) / total;
    let square = sum(&|k| (months[k] - middle).powi(2));
    let level = sum(&|k| values[k][0]) / total;
    let slope = sum(&|k| (months[k] - middle) * (values[k][0] - level)) / square;
    // Calibrations that scatter more than they state say less of the drift.
    let left = sum(&|k| (values[k][0] - level - slope * (months[k] - middle)).powi(2));
    let scatter = (left / (values.len() - 2) as f64).max(1.0).sqrt();
    let half = NORMAL_95 * scatter / square.sqrt();
    let at_first = level + slope * (months[0] - middle);
    (square > 0.0).then_some(([slope, slope - half, slope + half], at_first))
}

/// The day on which the drift may cost as much as the stated uncertainty of a reading, and the same
/// in months since the first calibration.
fn recalibrate_by(
    found: &[(jiff::Timestamp, PathBuf, DataSheet)],
    entries: &[HistoryEntry],
    quantities: &[QuantityHistory],
) -> Option<(String, f64)> {
    let drifting = quantities
        .iter()
        .filter_map(|q| Some((q.per_month?, q.limit)));
    // Shares of the stated uncertainty that a month may cost.
    let a_month = drifting.map(|([_, low, high], limit)| Some(low.abs().max(high.abs()) / limit?));
    let a_month: Vec<f64> = a_month.collect::<Option<_>>()?;
    let months = (1.0 / a_month.iter().sum::<f64>()).min(LONGEST_MONTHS);
    if a_month.is_empty() || !months.is_finite() {
        return None;
    }
    let hours = (24.0 * MONTH_DAYS * months) as i64;
    let last = found.last()?.0;
    let by = last
        .checked_add(jiff::Span::new().try_hours(hours).ok()?)
        .ok()?;
    Some((
        by.strftime("%Y-%m-%d").to_string(),
        entries.last()?.months + months,
    ))
}

impl CalibrationHistory {
    /// No calibration differs from the one before by more than both state.
    pub fn holds(&self) -> bool {
        self.quantities
            .iter()
            .flat_map(|q| &q.e_n)
            .all(|e| *e <= 1.0)
    }

    /// Lines for the terminal.
    pub fn lines(&self) -> Vec<String> {
        let stated =
            |[value, half]: [f64; 2]| format!("{} ± {}", number(value, 7), number(half, 2));
        let entry = |e: &HistoryEntry| {
            let zero = e
                .zero
                .map_or(String::new(), |z| format!(", zero {}", stated(z)));
            format!(
                "{}  sensitivity {}{zero}  {}",
                &e.created[..10.min(e.created.len())],
                stated(e.sensitivity),
                e.file.display()
            )
        };
        let mut lines: Vec<String> = self.entries.iter().map(entry).collect();
        for q in &self.quantities {
            let worst = q.e_n.iter().copied().fold(0.0, f64::max);
            let beyond = q.e_n.iter().filter(|e| **e > 1.0).count();
            let drift = q.per_month.map_or(String::new(), |[r, low, high]| {
                let [r, low, high] = [r, low, high].map(readable);
                with_unit(&format!("; a month {r} [{low}, {high}]"), &q.unit)
            });
            lines.push(format!(
                "{}: largest E_n {worst:.2}, {beyond} of {} changes beyond their uncertainty{drift}",
                q.quantity,
                q.e_n.len()
            ));
        }
        lines.push(match &self.recalibrate_by {
            Some(day) => format!(
                "recalibrate by {day}: until then the drift costs less than the stated uncertainty"
            ),
            None => "no day for the next calibration: a drift takes three calibrations over more than a day".to_owned(),
        });
        lines.push("why it changed, calibrations alone do not say".to_owned());
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_is_the_slope_of_the_weighted_line() {
        let months = [0.0, 1.0, 2.0, 3.0];
        let values = months.map(|t| [2.0 + 0.01 * t, 0.002]);
        let ([slope, low, high], first) = drift(&months, &values).unwrap_or_default();
        assert!((slope - 0.01).abs() < 1e-12 && low < 0.01 && high > 0.01);
        assert!((first - 2.0).abs() < 1e-12);
        // sd 0.002 / 1.96, sum of squares 5.
        assert!((0.5 * (high - low) - 0.002 / 5f64.sqrt()).abs() < 1e-9);
        assert!(
            drift(&months[..2], &values[..2]).is_none(),
            "negative control"
        );
        assert!((e_n([1.0, 0.03], [1.05, 0.04]) - 1.0).abs() < 1e-12);
    }
}
