//! MuJoCo's labels at a session's poses: other equilibria, and the error against the session's
//! labels.

use super::rows::{Text, of_trajectory, row};
use crate::progress::Progress;
use nalgebra::Vector3;
use std::sync::atomic::{AtomicUsize, Ordering};
use wcal_core::WhiskerData;
use wcal_mujoco::MujocoEngine;
use wcal_mujoco::compare::statics;
use wcal_mujoco::groove::{Preset, paper_options};
use wcal_mujoco::labels::{PoseLabel, labels};

/// Rows of the table.
///
/// # Errors
/// Where the engine is missing or dies.
pub(super) fn by_mujoco(data: &WhiskerData, preset: Preset) -> anyhow::Result<Vec<Text>> {
    let (mut rows, mut places) = (Vec::new(), Vec::new());
    for trajectory in &data.trajectories {
        let mut at = of_trajectory(data, trajectory.id);
        // In order of travel: a wire that rests keeps where it came from.
        at.sort_by(|a, b| a.1.total_cmp(&b.1));
        let place = |(_, x): &(usize, f64)| trajectory.origin_mm + trajectory.direction * *x;
        places.push(at.iter().map(place).collect::<Vec<Vector3<f64>>>());
        rows.extend(at.into_iter().map(|a| a.0));
    }
    let progress = Progress::new("twin");
    let done = AtomicUsize::new(0);
    let each = || {
        // Every place twice.
        let part = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / (2 * rows.len()) as f64;
        progress.at("MuJoCo", part.min(0.99));
    };
    let labels = labels(&data.whisker, preset, &places, &each)?;
    drop(progress);
    let mut lines: Vec<Text> = vec![None; data.rows.len()];
    let (full, mut unsure, mut offs) = (full_scale(data), Vec::new(), Vec::new());
    for (&k, label) in rows.iter().zip(labels.iter().flatten()) {
        let point = data.rows[k].point;
        if let Some(why) = doubt(data, label) {
            eprintln!("twin: point {point}: no certain moment: {why}");
        }
        // Where the equilibrium is not certain, a distance from the session's label says nothing.
        if !label.certain() {
            unsure.push(point.to_string());
        } else if let Some(moment) = label.moment_nmm
            && let Some(own) = data.twin.iter().find(|l| l.point == point)
        {
            offs.push(off(data, &moment, &own.moment_nmm, full));
        }
        lines[k] = Some(line(data, label));
    }
    match unsure.len() {
        0 => eprintln!(
            "twin: the wire rests in one place at each of {} poses",
            rows.len()
        ),
        n => eprintln!(
            "twin: {n} of {} poses have no certain moment: {}",
            rows.len(),
            unsure.join(", ")
        ),
    }
    if !offs.is_empty() {
        eprintln!(
            "twin: {} labels of the session, at poses with a certain moment: within {:.1e} of full scale",
            offs.len(),
            offs.iter().copied().fold(0.0, f64::max)
        );
    }
    // What the cable itself gets wrong, without any contact.
    if preset == Preset::Paper {
        let found = MujocoEngine::start().and_then(|mut engine| {
            statics(&mut engine, &data.whisker, &paper_options(&data.whisker))
        })?;
        eprintln!(
            "twin: links and clamp alone ({} links, under the rod's own force): base moment off by {:.3} %, loaded point by {:.3} %",
            found.links,
            found.moment_error * 100.0,
            found.point_error * 100.0
        );
    }
    Ok(lines)
}

fn line(data: &WhiskerData, label: &PoseLabel) -> (String, bool) {
    let Some(moment) = label.moment_nmm else {
        return (",,,unstable,false".to_owned(), false);
    };
    let branch = match (label.arclength_mm, &label.elsewhere) {
        (_, Some(_)) => "several",
        (Some(_), None) => "held",
        (None, None) => "free",
    };
    let text = row(data, &moment, label.arclength_mm, branch, label.settled);
    (text, label.certain())
}

/// Full scale of the session's own labels, N mm.
fn full_scale(data: &WhiskerData) -> f64 {
    let span = |c: usize| {
        let values = data.twin.iter().map(|l| l.moment_nmm[c]);
        let (low, high) = values.fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(x), h.max(x)));
        high - low
    };
    span(0).max(span(1))
}

/// Largest difference of a moment's components from a label, share of full scale.
fn off(data: &WhiskerData, moment: &Vector3<f64>, label: &[f64; 2], full: f64) -> f64 {
    let ours = data.moments.components_nmm(moment);
    (0..2)
        .map(|c| (ours[c] - label[c]).abs())
        .fold(0.0, f64::max)
        / full
}

/// Why a pose has no certain moment; none where it has one.
fn doubt(data: &WhiskerData, label: &PoseLabel) -> Option<String> {
    if label.moment_nmm.is_none() {
        return Some("a step went wrong (NaN or infinity)".to_owned());
    }
    if let Some(other) = &label.elsewhere {
        let place = other
            .arclength_mm
            .map_or("free".to_owned(), |s| format!("held at {s:.2} mm"));
        let m = data.moments.components_nmm(&other.moment_nmm);
        let moment = format!("({:.4}, {:.4}) N mm", m[0], m[1]);
        return Some(format!(
            "come to straight from the start it is {place}, {moment}"
        ));
    }
    (!label.settled).then(|| format!("not at rest ({:.1e} rad/s)", label.fastest_rad_s))
}
