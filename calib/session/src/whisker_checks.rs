//! Checks of whisker rows against geometry: reach of the wire, stage against groove, units.

use crate::error::InputError;
use crate::warning::{SessionWarning, WarningKind};
use nalgebra::Vector3;
use wcal_core::observation::RestShape;
use wcal_core::{Role, Trajectory, WhiskerRow};

/// Groove and stage position may differ by this before it is reported, mm.
const AGREEMENT_MM: f64 = 0.05;
/// A ratio this close to 1000 (or 1/1000) is a unit error, not a position error.
const UNIT_RATIO_TOLERANCE: f64 = 0.02;

/// Length of the wire, mm.
pub(crate) fn length_mm(shape: &RestShape) -> f64 {
    match shape {
        RestShape::StraightArc { length_mm, .. } => *length_mm,
        RestShape::Polyline(points) => points.windows(2).map(|w| (w[1] - w[0]).norm()).sum(),
    }
}

/// Every pose that is pressed must lie within the wire's length of its root.
pub(crate) fn check_reach(rows: &[WhiskerRow], length_mm: f64) -> Result<(), InputError> {
    for row in rows.iter().filter(|r| r.role != Role::Rest) {
        let Some(groove) = row.groove_mm else { continue };
        let distance_mm = groove.norm();
        if distance_mm > length_mm {
            let expected = format!("a groove within reach of the wire ({length_mm:.3} mm from the root)");
            let error = error(row, "groove_x_mm", expected, format!("{distance_mm:.3} mm"));
            let in_um = distance_mm > 100.0 * length_mm && distance_mm < 1e3 * length_mm;
            return Err(if in_um { error.hint("um instead of mm?") } else { error });
        }
    }
    Ok(())
}

/// Compares groove with origin + stage * direction. A disagreement is a warning, unless it is a factor of 1000.
pub(crate) fn check_stage(
    rows: &[WhiskerRow],
    trajectories: &[Trajectory],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(), InputError> {
    let (mut count, mut worst_mm, mut worst) = (0_usize, 0.0_f64, None);
    for row in rows {
        let (Some(groove), Some(stage_mm), Some(id)) = (row.groove_mm, row.stage_mm, row.trajectory) else {
            continue;
        };
        let Some(trajectory) = trajectories.iter().find(|t| t.id == id) else { continue };
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
        let (limit_mm, rows, line) = (AGREEMENT_MM, count, row.line);
        let kind = WarningKind::StageDisagrees { limit_mm, rows, worst_mm, line };
        warnings.push(SessionWarning::new(&row.source, kind));
    }
    Ok(())
}

fn unit_error(
    row: &WhiskerRow,
    trajectory: &Trajectory,
    groove: Vector3<f64>,
    stage_mm: f64,
) -> Result<(), InputError> {
    let near = |ratio: f64, factor: f64| (ratio / factor - 1.0).abs() < UNIT_RATIO_TOLERANCE;
    let travelled_mm = (groove - trajectory.origin_mm).dot(&trajectory.direction);
    let expected = format!("about {travelled_mm:.4} mm, from the groove's position");
    if travelled_mm.abs() > AGREEMENT_MM {
        let ratio = stage_mm / travelled_mm;
        if near(ratio, 1e3) || near(ratio, 1e-3) {
            let unit = if ratio > 1.0 { "um" } else { "m" };
            let error = error(row, "stage_mm", expected, format!("{stage_mm}"));
            return Err(error.hint(format!("a factor of 1000: {unit} instead of mm?")));
        }
    }
    let from_stage = trajectory.origin_mm + stage_mm * trajectory.direction;
    for factor in [1e3, 1e-3] {
        let scaled = groove / factor;
        if groove.norm() > 1e-6 && (scaled - from_stage).norm() < AGREEMENT_MM {
            let expected =
                format!("a position near ({:.3}, {:.3}, {:.3}) mm", from_stage.x, from_stage.y, from_stage.z);
            let found = format!("({}, {}, {})", groove.x, groove.y, groove.z);
            let unit = if factor > 1.0 { "um" } else { "m" };
            let error = error(row, "groove_x_mm", expected, found);
            // Near the base frame's origin everything is small: only a clear mismatch counts.
            if from_stage.norm() > 1.0 {
                return Err(error.hint(format!("a factor of 1000: {unit} instead of mm?")));
            }
        }
    }
    let origin_from_groove = groove - stage_mm * trajectory.direction;
    if trajectory.origin_mm.norm() > 1e-6
        && near(origin_from_groove.norm() / trajectory.origin_mm.norm(), 1e3)
    {
        let o = trajectory.origin_mm;
        let found = format!("({}, {}, {})", o.x, o.y, o.z);
        let expected = format!("an origin {:.3} mm from the root", origin_from_groove.norm());
        let field = format!("trajectory {}.origin_mm", trajectory.id);
        return Err(InputError::new("session.toml", expected, found)
            .field(field)
            .hint("a factor of 1000: m instead of mm?"));
    }
    Ok(())
}

fn error(row: &WhiskerRow, field: &str, expected: String, found: String) -> InputError {
    InputError::new(&row.source, expected, found).at(row.line).field(field)
}
