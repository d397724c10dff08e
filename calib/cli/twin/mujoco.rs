//! MuJoCo's labels at a session's poses: other equilibria, the error against the session's labels
//! and against the rod.

use super::rows::{Text, of_trajectory, row};
use crate::progress::Progress;
use nalgebra::Vector3;
use std::sync::atomic::{AtomicUsize, Ordering};
use wcal_core::WhiskerData;
use wcal_core::order_statistics::median;
use wcal_mujoco::MujocoEngine;
use wcal_mujoco::compare::statics;
use wcal_mujoco::groove::{Preset, paper_options};
use wcal_mujoco::labels::{PoseLabel, labels};
use wcal_rod::{Line, Rod, WORKING_STEP_MM};

/// A pose with what is known of it.
struct Pose<'a> {
    /// Row of the session.
    row: usize,
    point: i64,
    label: &'a PoseLabel,
    /// By the rod in a frictionless groove, N mm; none where it is not held.
    ideal_nmm: Option<Vector3<f64>>,
    /// The session's own label, components.
    outside: Option<[f64; 2]>,
}

/// Rows of the table.
///
/// # Errors
/// Where the engine is missing or dies.
pub(crate) fn by_mujoco(data: &WhiskerData, preset: Preset) -> anyhow::Result<Vec<Text>> {
    let mut rows: Vec<Vec<usize>> = Vec::new();
    let mut places: Vec<Vec<Vector3<f64>>> = Vec::new();
    for trajectory in &data.trajectories {
        let mut at = of_trajectory(data, trajectory.id);
        at.sort_by(|a, b| a.1.total_cmp(&b.1));
        places.push(
            at.iter()
                .map(|(_, x)| trajectory.origin_mm + trajectory.direction * *x)
                .collect(),
        );
        rows.push(at.into_iter().map(|a| a.0).collect());
    }
    let progress = Progress::new("twin");
    // Every place twice.
    let runs = 2 * places.iter().flatten().count();
    let done = AtomicUsize::new(0);
    let each = || {
        let part = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / runs as f64;
        progress.at("MuJoCo", part.min(0.99));
    };
    let labels = labels(&data.whisker, preset, &places, &each)?;
    drop(progress);
    let rod = Rod::new(&data.whisker, WORKING_STEP_MM)?;
    let mut poses: Vec<Pose<'_>> = Vec::new();
    for (t, trajectory) in data.trajectories.iter().enumerate() {
        let line = Line {
            origin_mm: trajectory.origin_mm,
            direction: trajectory.direction,
        };
        let xs: Vec<f64> = rows[t]
            .iter()
            .filter_map(|k| data.rows[*k].stage_mm)
            .collect();
        for (n, outcome) in rod.follow(&line, &xs).iter().enumerate() {
            let point = data.rows[rows[t][n]].point;
            poses.push(Pose {
                row: rows[t][n],
                point,
                label: &labels[t][n],
                ideal_nmm: outcome.equilibrium().map(|e| e.moment_nmm),
                outside: data
                    .twin
                    .iter()
                    .find(|l| l.point == point)
                    .map(|l| l.moment_nmm),
            });
        }
    }
    let mut lines: Vec<Text> = vec![None; data.rows.len()];
    for pose in &poses {
        if let Some(why) = doubt(data, pose.label) {
            eprintln!("twin: point {}: no certain moment: {why}", pose.point);
        }
        lines[pose.row] = Some(line(data, pose));
    }
    summary(data, &poses);
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

fn line(data: &WhiskerData, pose: &Pose<'_>) -> (String, bool) {
    let label = pose.label;
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

/// Median and largest, and where that is.
fn spread(mut values: Vec<(f64, i64)>) -> Option<(f64, f64, i64)> {
    values.retain(|v| v.0.is_finite());
    let (largest, at) = values.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some((median(values.iter().map(|v| v.0))?, *largest, *at))
}

/// Says what is known of all poses together.
fn summary(data: &WhiskerData, poses: &[Pose<'_>]) {
    let say = |line: String| eprintln!("twin: {line}");
    let (sure, unsure): (Vec<&Pose<'_>>, Vec<&Pose<'_>>) =
        poses.iter().partition(|p| p.label.certain());
    let points: Vec<String> = unsure.iter().map(|p| p.point.to_string()).collect();
    say(match points.len() {
        0 => format!(
            "the wire rests in one place at each of {} poses",
            poses.len()
        ),
        n => format!(
            "{n} of {} poses have no certain moment: {}",
            poses.len(),
            points.join(", ")
        ),
    });
    let full = full_scale(data);
    let offs = sure
        .iter()
        .filter_map(|p| Some(off(data, &p.label.moment_nmm?, p.outside.as_ref()?, full)));
    let offs: Vec<f64> = offs.collect();
    if !offs.is_empty() {
        say(format!(
            "{} labels of the session, at poses with a certain moment: within {:.1e} of full scale",
            offs.len(),
            offs.iter().copied().fold(0.0, f64::max)
        ));
    }
    let worst = |of: &dyn Fn(&PoseLabel) -> f64| {
        spread(poses.iter().map(|p| (of(p.label), p.point)).collect())
            .map_or_else(String::new, |(middle, most, at)| {
                format!("{middle:.2e} (median), {most:.2e} at most (point {at})")
            })
    };
    say(format!(
        "still creeping over the second half of the settling, by damping and friction: {} N mm; {} of {} poses chatter; the wire sinks into the tip: {} mm",
        worst(&|l| l.creep_nmm),
        poses.iter().filter(|p| p.label.chatters).count(),
        poses.len(),
        worst(&|l| l.overlap_mm)
    ));
    // Only on our branch: elsewhere a difference is no error of the twin's.
    let held = sure.iter().filter(|p| p.label.arclength_mm.is_some());
    let changes: Vec<(f64, f64, i64)> = held
        .filter_map(|p| {
            let ideal = p.ideal_nmm?;
            let (change, size) = (p.label.moment_nmm? - ideal, ideal.norm());
            Some((
                100.0 * change.dot(&ideal) / (size * size),
                100.0 * change.norm() / size,
                p.point,
            ))
        })
        .collect();
    let count = changes.len() as f64;
    if let Some((_, largest, at)) = changes.iter().max_by(|a, b| a.1.total_cmp(&b.1)) {
        say(format!(
            "against the rod in an ideal groove, over {} poses: {:+.2} % of the moment along it, RMS {:.2} %, {largest:.2} % at most (point {at})",
            changes.len(),
            changes.iter().map(|c| c.0).sum::<f64>() / count,
            (changes.iter().map(|c| c.1 * c.1).sum::<f64>() / count).sqrt(),
        ));
    }
}
