//! The groove of a session's own calibration from its table (`groove_x_mm`, `groove_y_mm`,
//! `groove_z_mm`).

use crate::TrackError;
use crate::known_groove::{KnownPlace, MAX_INTERVAL_S};
use nalgebra::Vector3;
use std::path::Path;
use wcal_session::{TextTable, TextTableLayout, read_text_table};

const GROOVE: [&str; 3] = ["groove_x_mm", "groove_y_mm", "groove_z_mm"];

/// Readings of a table with a known groove, in order of time; none where it has no such columns.
///
/// # Errors
/// Where the table cannot be read.
pub fn known_places(path: &Path) -> Result<Vec<KnownPlace>, TrackError> {
    let table: TextTable = read_text_table(path, &TextTableLayout::default())?;
    let column = |name: &str| table.column(name).ok();
    let (Some(time), [Some(x), Some(y), Some(z)]) = (column("t_s"), GROOVE.map(column)) else {
        return Ok(Vec::new());
    };
    let (role, speed, trajectory) = (column("role"), column("speed_mm_s"), column("trajectory"));
    let mut all: Vec<(Option<f64>, KnownPlace)> = Vec::new();
    for (k, (line, cells)) in table.rows.iter().enumerate() {
        let number = |column| table.number(k, column);
        if role.is_some_and(|c| &cells[c] == "rest") {
            continue;
        }
        if let (Some(t_s), Some(x), Some(y), Some(z)) =
            (number(time)?, number(x)?, number(y)?, number(z)?)
        {
            let settled = speed.map(number).transpose()?.flatten().map(|v| v == 0.0);
            let groove_mm = Vector3::new(x, y, z);
            let place = KnownPlace {
                line: *line,
                t_s,
                groove_mm,
                settled,
                visit: 0,
            };
            all.push((trajectory.map(number).transpose()?.flatten(), place));
        }
    }
    all.sort_by(|a, b| a.1.t_s.total_cmp(&b.1.t_s));
    let goes_on =
        |(id, a): &(Option<f64>, KnownPlace), (next, b): &(Option<f64>, KnownPlace)| match id {
            Some(id) => Some(id) == next.as_ref(),
            None => next.is_none() && b.t_s - a.t_s <= MAX_INTERVAL_S,
        };
    let visits = all.chunk_by(goes_on).enumerate();
    Ok(visits
        .flat_map(|(visit, of)| of.iter().map(move |p| KnownPlace { visit, ..p.1 }))
        .collect())
}
