//! Rows of the table that `wcal twin` writes.

use nalgebra::Vector3;
use wcal_core::{Role, WhiskerData, WhiskerRow};

/// A row's text behind the point, and whether its moment is certain.
pub(super) type Text = Option<(String, bool)>;

/// Rows of a trajectory with their stage positions, in the order of the table.
pub(super) fn of_trajectory(data: &WhiskerData, id: u32) -> Vec<(usize, f64)> {
    let of_it = |row: &WhiskerRow| row.role != Role::Rest && row.trajectory == Some(id);
    let rows = data.rows.iter().enumerate().filter(|(_, row)| of_it(row));
    rows.filter_map(|(k, row)| Some((k, row.stage_mm?)))
        .collect()
}

/// The text of a reading with a moment: base axes, N mm; place of the contact, mm.
pub(super) fn row(
    data: &WhiskerData,
    moment: &Vector3<f64>,
    at_mm: Option<f64>,
    branch: &str,
    settled: bool,
) -> String {
    let moment = data.moments.components_nmm(moment);
    let at = at_mm.map_or_else(String::new, |s| format!("{s:.6}"));
    format!("{:.9},{:.9},{at},{branch},{settled}", moment[0], moment[1])
}
