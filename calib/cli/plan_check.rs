//! Which effects a plan can distinguish, before anything is measured: the second half of
//! `wcal stage-sweep --dry-run`.
//!
//! It needs no data: the readings that a typical sensor would give at the planned poses are made
//! from the rod. What is never distinguished here cannot be distinguished by any number of
//! repetitions.

use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::fmt::Write as _;
use wcal_acquisition::plan::{Plan, Pose, Step};
use wcal_acquisition::rig::{Rig, TrajectoryRig};
use wcal_core::WhiskerData;
use wcal_core::plan_check_document::PlanCheck;
use wcal_session::{SESSION_FORMAT, load};
use wcal_verify::whisker::plan_check::plan_check;

/// What the readings of a grating determine before any effect: the sensitivity to two moments, and
/// a zero.
const UNKNOWNS: usize = 3;

/// What the steps of a plan on a rig can show.
///
/// # Errors
/// Where the wire cannot be modelled, or has no equilibrium at the planned poses.
pub(crate) fn of_plan(rig: &Rig, plan: &Plan, steps: &[Step]) -> Result<PlanCheck> {
    let readings = steps
        .iter()
        .filter(|s| matches!(s, Step::Settled(_) | Step::Moving { .. }))
        .count();
    ensure!(
        readings >= UNKNOWNS,
        "so few readings show no effect: {readings} where sensitivity and zero alone take {UNKNOWNS}"
    );
    Ok(plan_check(&planned_session(rig, plan, steps)?)?)
}

/// Time to turn the mount, s, and between poses at the least.
const TURN_S: f64 = 10.0;

/// The session that the plan would record, without readings: by the session reader itself, so that
/// rig and poses are checked as a session's.
fn planned_session(rig: &Rig, plan: &Plan, steps: &[Step]) -> Result<WhiskerData> {
    let folder = tempfile::tempdir().context("making a folder for the planned session")?;
    std::fs::write(folder.path().join("session.toml"), session_toml(rig, plan)?)?;
    std::fs::write(folder.path().join("points.csv"), points(steps, rig)?)?;
    Ok(load(folder.path())?.whisker()?.clone())
}

fn session_toml(rig: &Rig, plan: &Plan) -> Result<String> {
    let trajectory =
        |t: &TrajectoryRig| json!({"id": t.id, "origin_mm": t.origin_mm, "direction": t.direction});
    let mut root = json!({
        "format": SESSION_FORMAT,
        "id": "plan",
        "kind": "whisker",
        "medium": plan.medium,
        "files": {"points": "points.csv"},
        "whisker": rig.whisker,
        "fbg": {"temperature_compensated": true},
        "trajectory": rig.trajectory.iter().map(trajectory).collect::<Vec<_>>(),
    });
    if let Some(moments) = &rig.moments {
        root["moments"] = json!(moments);
    }
    Ok(toml::to_string(&root)?)
}

fn points(steps: &[Step], rig: &Rig) -> Result<String> {
    let mut out =
        "point,role,trajectory,t_s,stage_mm,direction,speed_mm_s,dwell_s,groove_x_mm,groove_y_mm,groove_z_mm,fbg_1_shift_nm,fbg_2_shift_nm,temperature_degc\n"
            .to_owned();
    // A reference grating or sensor sees the room drift and come back, from its own zero; how much
    // does not matter here.
    let thermometer = rig.grating("fbg_ref").is_some();
    let temperature = |point: f64| {
        let drift_degc = 0.1 * (std::f64::consts::PI * point / steps.len() as f64).sin();
        if thermometer {
            format!("{drift_degc:.5}")
        } else {
            String::new()
        }
    };
    let (mut t_s, mut point, mut at_mm) = (0.0, 0_u32, rig.stage.retract_mm);
    for step in steps {
        let (pose, moving): (&Pose, bool) = match step {
            Step::Soak | Step::Sync { .. } => continue,
            Step::Mount { .. } => {
                (t_s, at_mm) = (t_s + TURN_S, rig.stage.retract_mm);
                continue;
            }
            Step::Settled(pose) => (pose, false),
            Step::Moving { pose, .. } => (pose, true),
        };
        t_s += (pose.stage_mm - at_mm).abs() / pose.speed_mm_s.max(1e-3)
            + pose.dwell_s
            + pose.average_s;
        at_mm = pose.stage_mm;
        let groove = rig
            .trajectory(pose.trajectory)
            .map(|t| t.groove_mm(pose.stage_mm));
        let groove = groove.map_or_else(
            || ",,".to_owned(),
            |g| format!("{:.6},{:.6},{:.6}", g.x, g.y, g.z),
        );
        let role = serde_json::to_value(pose.role)?;
        // Shifts of 0 hold the place: the readings themselves are made from the rod.
        writeln!(
            out,
            "{point},{},{},{t_s:.3},{:.6},{},{},{},{groove},0,0,{}",
            role.as_str().unwrap_or("calibration"),
            pose.trajectory,
            pose.stage_mm,
            pose.direction,
            if moving { pose.speed_mm_s } else { 0.0 },
            if moving { 0.0 } else { pose.dwell_s },
            temperature(f64::from(point)),
        )?;
        point += 1;
    }
    Ok(out)
}
