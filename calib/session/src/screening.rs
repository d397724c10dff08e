//! What is checked of a scalar table as a whole, once its rows are read: overflow codes, copies, the direction against the moves.
//! Rows without a value of their own are left out and counted in a warning; what contradicts itself is an error that names the way out.

use crate::copies::{self, copies};
use crate::error::InputError;
use crate::overflow::{codes, refuse_most};
use crate::sequence::{Step, contradicted_direction};
use crate::warning::{SessionWarning, WarningKind};
use wcal_core::Role;

/// What the screening sees of a row.
pub(crate) struct View {
    /// Line in the file.
    pub line: usize,
    /// Point.
    pub point: i64,
    /// Sealed rows are no copies here: a sealed copy of an open row refuses the session.
    pub role: Role,
    /// Stimulus or commanded position.
    pub setting: f64,
    /// Response or measured position.
    pub reading: f64,
    /// Time, s.
    pub t_s: Option<f64>,
    /// Direction.
    pub direction: Option<f64>,
    /// Temperature, deg C.
    pub temperature_degc: Option<f64>,
    /// Further covariates.
    pub more: Vec<f64>,
}

/// Names of the columns of a table.
pub(crate) struct Names<'a> {
    pub setting: &'a str,
    pub reading: &'a str,
    pub more: &'a [String],
}

/// A row of a scalar table.
pub(crate) trait Screened {
    /// What the screening sees of it.
    fn view(&self) -> View;
}

/// Leaves out rows of `rows` without a value of their own. `reference`: rows of the session's points table, where this is another table.
///
/// # Errors
/// Where columns contradict each other, or a temperature is none.
pub(crate) fn screen<R: Screened>(
    file: &str,
    names: &Names<'_>,
    rows: &mut Vec<R>,
    reference: &[R],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    let beside: Vec<View> = reference.iter().map(R::view).collect();
    let views: Vec<View> = rows.iter().map(R::view).collect();
    let mut kept = vec![true; rows.len()];
    for overflow in overflows(names, &views, &beside) {
        overflow.rows.iter().for_each(|&k| kept[k] = false);
        refuse_most(file, &overflow.column, overflow.rows.len(), rows.len())?;
        let (lines, points) = overflow.rows.iter().map(|&k| (views[k].line, views[k].point)).unzip();
        let kind = WarningKind::Overflow { column: overflow.column, value: overflow.value, lines, points };
        warnings.push(SessionWarning::new(file, kind));
    }
    let open: Vec<usize> = (0..rows.len()).filter(|&k| kept[k] && views[k].role != Role::Holdout).collect();
    let compared: Vec<copies::Row> = open.iter().map(|&k| compared(&views[k])).collect();
    let again: Vec<usize> = copies(&compared).into_iter().map(|k| open[k]).collect();
    if !again.is_empty() {
        again.iter().for_each(|&k| kept[k] = false);
        let (lines, points) = again.iter().map(|&k| (views[k].line, views[k].point)).unzip();
        warnings.push(SessionWarning::new(file, WarningKind::Copied { lines, points, of: rows.len() }));
    }
    let stays: Vec<&View> = views.iter().zip(&kept).filter(|(_, k)| **k).map(|(v, _)| v).collect();
    consistent(file, names, &stays)?;
    let mut keep = kept.into_iter();
    rows.retain(|_| keep.next().unwrap_or(true));
    Ok(())
}

/// A code in a column and the rows that hold it.
struct Overflow {
    column: String,
    value: f64,
    rows: Vec<usize>,
}

/// Overflow codes of every column.
fn overflows(names: &Names<'_>, views: &[View], beside: &[View]) -> Vec<Overflow> {
    let mut out = Vec::new();
    let mut add = |column: &str, set: bool, value: &dyn Fn(&View) -> Option<f64>| {
        let values: Vec<f64> = views.iter().chain(beside).filter_map(value).collect();
        for code in codes(&values, set) {
            let rows: Vec<usize> = (0..views.len()).filter(|&k| value(&views[k]) == Some(code)).collect();
            if !rows.is_empty() {
                out.push(Overflow { column: column.to_owned(), value: code, rows });
            }
        }
    };
    add(names.setting, true, &|v| Some(v.setting));
    add(names.reading, false, &|v| Some(v.reading));
    add("temperature_degc", false, &|v| v.temperature_degc);
    for (k, name) in names.more.iter().enumerate() {
        add(name, false, &|v| v.more.get(k).copied());
    }
    out
}

fn compared(view: &View) -> copies::Row {
    copies::Row {
        setting: [view.setting, view.direction.unwrap_or(0.0)],
        reading: view.reading,
        t_s: view.t_s,
        more: view.more.iter().copied().chain(view.temperature_degc).collect(),
    }
}

/// Temperatures, directions and clock of the rows that stay.
fn consistent(file: &str, names: &Names<'_>, views: &[&View]) -> Result<(), InputError> {
    let kelvin = |t: f64| !(-60.0..=200.0).contains(&t);
    if let Some(v) = views.iter().find(|v| v.temperature_degc.is_some_and(kelvin)) {
        let found = format!("{}", v.temperature_degc.unwrap_or_default());
        let expected = "a temperature between -60 and 200 deg C";
        return Err(InputError::new(file, expected, found)
            .at(v.line)
            .field("temperature_degc")
            .hint("kelvin?"));
    }
    let first = views.first().filter(|v| views.len() > 1 && v.t_s.is_some());
    if let Some(v) = first.filter(|first| views.iter().all(|v| v.t_s == first.t_s)) {
        let found = format!("t_s {} in all {} rows", v.t_s.unwrap_or_default(), views.len());
        let error = InputError::new(file, "a time that runs", found).at(v.line).field("t_s");
        return Err(error.hint("leave --time out at import: the order of the rows then stands for it"));
    }
    let steps: Vec<Step> = views.iter().map(|v| (v.line, v.setting, v.direction)).collect();
    contradicted_direction(file, names.setting, &steps).map_or(Ok(()), Err)
}
