//! Tracks of a table of readings.

use super::motion;
use super::object::{object_score, say_object_score};
use super::output::{FORMAT, TrackFiles, TrackRow};
use super::surface::write_surface;
use super::{Outcome, TrackArgs, exit_code, refuse_surface};
use crate::simulated::is_simulated;
use anyhow::{Context, Result, bail};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use serde_json::json;
use std::collections::HashMap;
use std::path::Path;
use std::process::ExitCode;
use wcal_calibration::{MomentRow, MomentTable};
use wcal_contact::groove_table::known_places;
use wcal_contact::known_groove::{KnownGroove, velocities};
use wcal_contact::motion_table::is_motion_column;
use wcal_contact::row_tracker::{RowInput, RowTracker};
use wcal_contact::trust::WhiskerModel;
use wcal_core::FbgSpec;
use wcal_core::stream::{Flags, StreamMoments};
use wcal_session::{SessionWarning, TextTable, TextTableLayout, WarningKind, read_text_table};
use wcal_track::stream::BasePose;

/// A step this many times the median is a gap.
const GAP_STEPS: f64 = 4.0;

/// Median time between the rows of a table, s; none without times.
///
/// # Errors
/// Where the table cannot be read.
pub fn median_step_s(path: &Path) -> Result<Option<f64>> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    let Ok(column) = table.column("t_s") else { return Ok(None) };
    let times: Vec<f64> = (0..table.rows.len())
        .map(|k| table.number(k, column))
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .flatten()
        .collect();
    Ok(median(times.windows(2).map(|w| w[1] - w[0]).collect()))
}

fn median(mut steps: Vec<f64>) -> Option<f64> {
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// Tracks the readings of a table.
///
/// # Errors
/// Where the table cannot be used, or a row has no time.
pub fn track(args: &TrackArgs, path: &Path, loaded: &WhiskerModel<'_>) -> Result<ExitCode> {
    let calibration = loaded.calibration()?;
    let MomentTable { rows, warnings } =
        calibration.moments(path).with_context(|| loaded.place.display().to_string())?;
    let of_motion =
        |w: &SessionWarning| matches!(&w.kind, WarningKind::UnknownColumn(c) if is_motion_column(c));
    for warning in warnings.iter().filter(|w| !of_motion(w)) {
        eprintln!("warning: {warning}");
    }
    let fbg = calibration.fbg();
    check(path, &rows, fbg)?;
    let poses = base_poses(path)?;
    refuse_surface(args, !poses.is_empty())?;
    let places = known_places(path)?;
    let step_s = median(rows.windows(2).filter_map(|w| Some(w[1].t_s? - w[0].t_s?)).collect());
    let past_groove = velocities(&places, GAP_STEPS * step_s.unwrap_or_default());
    let doubts = loaded.doubts.codes();
    let mut files = TrackFiles::create(&args.out, false)?;
    let found = loaded.row_tracker("", args.sweep, args.tare_s);
    let (Some(mut tracker), Some(card)) = (found, loaded.network.as_ref().map(|n| &n.card)) else {
        bail!("--model: expected one, found none");
    };
    tracker.groove = KnownGroove::new(places, &card.whisker);
    let mut last: Option<(f64, Option<BasePose>)> = None;
    let (mut outside, mut flagged, mut unusable) = (0_u64, 0_u64, 0_u64);
    for m in &rows {
        let (t_s, line) = (m.t_s.unwrap_or_default(), m.line);
        let mut flags = Flags::default();
        if last.zip(step_s).is_some_and(|((before, _), step)| t_s - before > GAP_STEPS * step) {
            // What happened in between is not known: the tracker starts anew.
            flags = flags.with(Flags::GAP);
            tracker.restart();
            tracker.history.gap();
        }
        if fbg.needs_reference() && !m.reference {
            flags = flags.with(Flags::REFERENCE_LOST);
        }
        let base = poses.get(&m.line).copied();
        let velocity = last.and_then(|(before, old)| velocity_mm_s(&old?, &base?, t_s - before));
        let base = base.map(|b| BasePose { velocity_mm_s: velocity, ..b });
        let base_mm_s = velocity.map(|v| v.z).or(args.base_mm_s);
        last = Some((t_s, base));
        let usable = !flags.has(Flags::REFERENCE_LOST);
        let moments =
            usable.then_some(StreamMoments { moment_nmm: m.moment_nmm, sd_nmm: m.sd_nmm, valid: m.valid });
        let known = velocity.or(past_groove.get(&line).copied());
        let velocity_mm_s = known.or(args.base_mm_s.map(|v| Vector3::z() * v));
        let row = tracker.push(&RowInput { t_s, moments, base, base_mm_s, velocity_mm_s });
        let flags = flags.with(row.flags);
        outside += u64::from(usable && !m.valid);
        flagged += u64::from(!flags.none());
        unusable += u64::from(!usable);
        files.row(&TrackRow {
            point: m.point,
            t_s,
            whisker: "",
            flags,
            doubts: &doubts,
            moments: row.moments,
            answer: row.answer.as_ref(),
            base_mm_s,
            base,
            touching: None,
            segment: row.segment,
            regions: &row.regions,
            several: row.several,
        })?;
    }
    let RowTracker { motion: motions, history: found, groove, several_rows, .. } = tracker;
    let simulated = is_simulated(path) || loaded.file.provenance.simulated;
    if simulated {
        eprintln!("track: SIMULATED: the readings or the calibration are not measured");
    }
    let mut summary = json!({
        "format": FORMAT, "source": path, "simulated": simulated, "out": args.out, "rows": rows.len(), "flagged_rows": flagged, "unusable_rows": unusable,
        "outside_valid_region": outside, "doubts": loaded.doubts.messages(), "lag_s": 0.0, "tare_s": args.tare_s,
        "object_class": args.object_class,
        "calibration_sha256": loaded.file.content_sha256, "model_sha256": card.weights_sha256,
        "trained_on_simulation": card.trained_on_simulation,
        "segments": found.segments(), "untrained_motion": motion::summary(&motions), "known_groove": groove.as_ref().and_then(KnownGroove::summary),
        "several_contacts": motion::several_summary(several_rows),
    });
    let on_object = object_score(path, &found.contacts_mm())?;
    summary["object"] = json!(on_object);
    if args.surface {
        summary["surface"] = write_surface(&args.out, &[&found])?;
    }
    files.finish(&summary, args.json)?;
    if outside > 0 {
        eprintln!(
            "{outside} of {} readings lie outside the valid region; marked in outside_valid_region",
            rows.len()
        );
    }
    if flagged > 0 {
        eprintln!("{flagged} of {} rows are flagged in status", rows.len());
    }
    say_object_score(on_object.as_ref());
    motion::say(&motions, "", rows.len() as u64);
    motion::say_several("", several_rows);
    if let Some(said) = groove.as_ref().and_then(KnownGroove::message) {
        eprintln!("{said}");
    }
    let misstated = groove.as_ref().is_some_and(KnownGroove::misstated);
    Ok(exit_code(
        args,
        Outcome { outside: outside > 0, misstated, lost: unusable > 0, untrained: motions.any() },
    ))
}

/// Times that go forward, and a reference where the calibration needs one.
fn check(path: &Path, rows: &[MomentRow], fbg: &FbgSpec) -> Result<()> {
    let name = path.display();
    let mut last_s = f64::NEG_INFINITY;
    for m in rows {
        let Some(t_s) = m.t_s else { bail!("{name}: point {}: t_s: expected a time, found none", m.point) };
        if t_s <= last_s {
            bail!("{name}: point {}: t_s: expected a later time than {last_s}, found {t_s}", m.point);
        }
        last_s = t_s;
    }
    if fbg.needs_reference() && !rows.iter().any(|m| m.reference) {
        bail!(
            "{name}: fbg_ref_nm: expected the strain-isolated grating, since the calibration compensates temperature with it; found \
             none"
        );
    }
    Ok(())
}

const POSE: [&str; 7] = ["base_x_mm", "base_y_mm", "base_z_mm", "base_qw", "base_qx", "base_qy", "base_qz"];

/// Poses of the base by line, where the table has its columns.
fn base_poses(path: &Path) -> Result<HashMap<usize, BasePose>> {
    let table: TextTable = read_text_table(path, &TextTableLayout::default())?;
    let present = POSE.iter().filter(|c| table.column(c).is_ok()).count();
    if present == 0 {
        return Ok(HashMap::new());
    }
    let columns = POSE.iter().map(|c| table.column(c)).collect::<Result<Vec<_>, _>>()?;
    let mut poses = HashMap::new();
    for (k, (line, _)) in table.rows.iter().enumerate() {
        let values = columns.iter().map(|c| table.number(k, *c)).collect::<Result<Vec<_>, _>>()?;
        let Some(v) = values.into_iter().collect::<Option<Vec<f64>>>() else { continue };
        let turn = Quaternion::new(v[3], v[4], v[5], v[6]);
        if (turn.norm() - 1.0).abs() >= 1e-3 {
            bail!(
                "{}: line {line}: base_qw..base_qz: expected a unit quaternion, found norm {}",
                path.display(),
                turn.norm()
            );
        }
        let place = Translation3::new(v[0], v[1], v[2]);
        let world_from_base = Isometry3::from_parts(place, UnitQuaternion::new_normalize(turn));
        poses.insert(*line, BasePose { world_from_base, velocity_mm_s: None });
    }
    Ok(poses)
}

/// Velocity of the base between two poses, base frame, mm/s.
fn velocity_mm_s(before: &BasePose, now: &BasePose, dt_s: f64) -> Option<Vector3<f64>> {
    let moved = now.world_from_base.translation.vector - before.world_from_base.translation.vector;
    (dt_s > 0.0).then(|| now.world_from_base.rotation.inverse() * moved / dt_s)
}
