//! Checks of whisker rows against geometry: reach of the wire, stage against groove, units.

use crate::error::InputError;
use crate::warning::SessionWarning;
use nalgebra::Vector3;
use wcal_core::observation::RestShape;
use wcal_core::{Role, Trajectory, WhiskerRow};

/// Groove and stage position may differ by this before it is reported, mm.
const AGREEMENT_MM: f64 = 0.05;
/// A ratio this close to 1000 (or 1/1000) is a unit error, not a position error.
const UNIT_RATIO_TOLERANCE: f64 = 0.02;

/// Length of the wire, mm.
fn length_mm(shape: &RestShape) -> f64 {
    match shape {
        RestShape::StraightArc { length_mm, .. } => *length_mm,
        RestShape::Polyline(points) => points.windows(2).map(|w| (w[1] - w[0]).norm()).sum(),
    }
}

/// Checks rows against the stage's way and the wire's reach.
pub(crate) fn check(
    rows: &[WhiskerRow],
    shape: &RestShape,
    trajectories: &[Trajectory],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    // A factor of 1000 is named as such before it is called out of reach.
    check_stage(rows, trajectories, warnings)?;
    check_reach(rows, length_mm(shape))
}

/// Every pose that is pressed must lie within the wire's length of its root.
fn check_reach(rows: &[WhiskerRow], length_mm: f64) -> Result<(), InputError> {
    for row in rows.iter().filter(|r| r.role != Role::Rest) {
        let Some(groove) = row.groove_mm else {
            continue;
        };
        let distance_mm = groove.norm();
        if distance_mm > length_mm {
            let expected =
                format!("a groove within reach of the wire ({length_mm:.3} mm from the root)");
            let error = error(row, "groove_x_mm", expected, format!("{distance_mm:.3} mm"));
            let in_um = distance_mm > 100.0 * length_mm && distance_mm < 1e3 * length_mm;
            return Err(if in_um {
                error.hint("um instead of mm?")
            } else {
                error
            });
        }
    }
    Ok(())
}

/// Compares groove with origin + stage * direction. A disagreement is a warning, unless it is a
/// factor of 1000.
fn check_stage(
    rows: &[WhiskerRow],
    trajectories: &[Trajectory],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    let (mut count, mut worst_mm, mut worst) = (0_usize, 0.0_f64, None);
    for row in rows {
        let (Some(groove), Some(stage_mm), Some(id)) =
            (row.groove_mm, row.stage_mm, row.trajectory)
        else {
            continue;
        };
        let Some(trajectory) = trajectories.iter().find(|t| t.id == id) else {
            continue;
        };
        let off_mm = (groove - trajectory.origin_mm - stage_mm * trajectory.direction).norm();
        if off_mm <= AGREEMENT_MM {
            continue;
        }
        unit_error(row, trajectory, groove, stage_mm)?;
        count += 1;
        if off_mm > worst_mm {
            (worst_mm, worst) = (off_mm, Some(row));
        }
    }
    if let Some(row) = worst {
        let line = row.line;
        let text = format!(
            "groove and origin + stage_mm * direction differ by more than {AGREEMENT_MM} mm in {count} row(s), most by {worst_mm:.3} mm at line {line}"
        );
        warnings.push(SessionWarning::other(&row.source, text));
    }
    Ok(())
}

/// A factor of 1000 between the stage's way and the groove's, in one of the numbers that the three
/// of them come from.
fn unit_error(
    row: &WhiskerRow,
    trajectory: &Trajectory,
    groove: Vector3<f64>,
    stage_mm: f64,
) -> Result<(), InputError> {
    let thousand = |ratio: f64| {
        [(1e3, "um"), (1e-3, "m")]
            .into_iter()
            .find(|(f, _)| (ratio / f - 1.0).abs() < UNIT_RATIO_TOLERANCE)
    };
    let hint = |unit: &str| format!("a factor of 1000: {unit} instead of mm?");
    let text = |v: Vector3<f64>| format!("({:.4}, {:.4}, {:.4})", v.x, v.y, v.z);
    let travelled_mm = (groove - trajectory.origin_mm).dot(&trajectory.direction);
    if let Some((_, unit)) =
        thousand(stage_mm / travelled_mm).filter(|_| travelled_mm.abs() > AGREEMENT_MM)
    {
        let expected = format!("about {travelled_mm:.4} mm, from the groove's position");
        return Err(error(row, "stage_mm", expected, format!("{stage_mm}")).hint(hint(unit)));
    }
    let from_stage = trajectory.origin_mm + stage_mm * trajectory.direction;
    // Near the base frame's origin everything is small: only a clear mismatch counts.
    let scaled =
        |f: f64| (groove / f - from_stage).norm() < AGREEMENT_MM && from_stage.norm() > 1.0;
    if let Some((_, unit)) = [(1e3, "um"), (1e-3, "m")]
        .into_iter()
        .find(|(f, _)| scaled(*f))
    {
        let expected = format!("a position near {} mm", text(from_stage));
        return Err(error(row, "groove_x_mm", expected, text(groove)).hint(hint(unit)));
    }
    // Groove less the stage's way is the origin in mm, against which the stated one is held.
    let root_mm = (groove - stage_mm * trajectory.direction).norm();
    let origin_mm = trajectory.origin_mm.norm();
    if origin_mm > 1e-6 && thousand(root_mm / origin_mm).is_some_and(|(factor, _)| factor > 1.0) {
        let expected = format!("an origin {root_mm:.3} mm from the root");
        let error = InputError::new("session.toml", expected, text(trajectory.origin_mm));
        return Err(error
            .field(format!("trajectory {}.origin_mm", trajectory.id))
            .hint(hint("m")));
    }
    Ok(())
}

fn error(row: &WhiskerRow, field: &str, expected: String, found: String) -> InputError {
    InputError::new(&row.source, expected, found)
        .at(row.line)
        .field(field)
}
