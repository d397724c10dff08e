//! `wcal twin`: the twin's base moments at a session's poses.

use anyhow::bail;
use clap::{Args, ValueEnum};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_core::{Role, SessionData, WhiskerData, WhiskerRow};
use wcal_mujoco::groove::{self, PoseLabel};
use wcal_rod::{Line, Outcome, Rod, WORKING_STEP_MM};
use wcal_session::load;

/// Arguments of `wcal twin`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal twin my-session --engine rod --out my-session/twin.csv
  wcal twin my-session --engine mujoco --preset released --out my-session/twin.csv

One line a reading: point, moment_1_nmm, moment_2_nmm, contact_arclength_mm, branch, settled. Branch by the rod: first-touch, rest,
not-touched, snapped, slipped-off; where the wire is not held on the branch from first touch there is no moment. Branch by MuJoCo: held,
rest, free (the wire is out of the groove), unstable (a step went wrong: no moment), several: come to straight from the start, past the places between, the wire rests elsewhere, so that the way and MuJoCo's
version decide on the moment. With preset released, labels of the session's own twin.csv that lie on another branch are named. MuJoCo runs with the released groove tip; preset released is
the released cable, paper the measured one with the clamp right to second order. Exit code 3: readings without a moment, not at rest, or
with several equilibria.")]
pub struct TwinArgs {
    /// Session folder (kind \"whisker\")
    pub session: PathBuf,
    /// Model of the wire
    #[arg(long, value_enum, default_value = "rod")]
    pub engine: Engine,
    /// Which MuJoCo twin
    #[arg(long, value_enum, default_value = "paper")]
    pub preset: Preset,
    /// Table to write
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
}

/// Models of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Quasi-static Kirchhoff rod, frictionless groove
    Rod,
    /// MuJoCo's cable in the released groove tip
    Mujoco,
}

/// MuJoCo twins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// As released with the paper
    Released,
    /// The session's whisker, 40 links, clamp corrected
    Paper,
}

/// Runs the command: 0, or 3 where some reading has no moment.
///
/// # Errors
/// A session of another kind, or a file that cannot be read or written.
pub fn run(args: &TwinArgs) -> anyhow::Result<ExitCode> {
    let session = load(&args.session)?;
    let SessionData::Whisker(data) = &session.data else {
        bail!("twin: expected a session of kind \"whisker\", found {:?}", session.kind);
    };
    let lines = match args.engine {
        Engine::Rod => by_rod(data)?,
        Engine::Mujoco => by_mujoco(data, args.preset)?,
    };
    let mut text = String::from("point,moment_1_nmm,moment_2_nmm,contact_arclength_mm,branch,settled\n");
    let mut missing = Vec::new();
    for (row, line) in data.rows.iter().zip(lines) {
        let (line, held) = match line {
            Some(line) => line,
            None if row.role == Role::Rest => ("0,0,,rest,true".to_owned(), true),
            None => (",,,no-pose,false".to_owned(), false),
        };
        if !held {
            missing.push(row.point.to_string());
        }
        writeln!(text, "{},{line}", row.point)?;
    }
    wcal_session::write_atomic(&args.out, text.as_bytes())?;
    eprintln!(
        "twin: {} readings, {} without a moment; {}",
        data.rows.len(),
        missing.len(),
        args.out.display()
    );
    if missing.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    eprintln!("twin: warning: no certain equilibrium at points {}", missing.join(", "));
    Ok(ExitCode::from(3))
}

/// A row's text behind the point, and whether its moment is certain.
type Text = Option<(String, bool)>;

/// Rows of a trajectory with their stage positions, in order of travel.
fn of_trajectory(data: &WhiskerData, id: u32) -> Vec<(usize, f64)> {
    let of_it = |row: &WhiskerRow| row.role != Role::Rest && row.trajectory == Some(id);
    (0..data.rows.len())
        .filter(|&k| of_it(&data.rows[k]))
        .filter_map(|k| data.rows[k].stage_mm.map(|x| (k, x)))
        .collect()
}

fn by_rod(data: &WhiskerData) -> anyhow::Result<Vec<Text>> {
    let rod = Rod::new(&data.whisker, WORKING_STEP_MM)?;
    let mut lines: Vec<Text> = vec![None; data.rows.len()];
    for trajectory in &data.trajectories {
        let at = of_trajectory(data, trajectory.id);
        let line = Line { origin_mm: trajectory.origin_mm, direction: trajectory.direction };
        let xs: Vec<f64> = at.iter().map(|a| a.1).collect();
        for (outcome, &(k, _)) in rod.follow(&line, &xs).iter().zip(&at) {
            let branch = match outcome {
                Outcome::Held(held) => {
                    let row = row(data, &held.moment_nmm, Some(held.arclength_mm), "first-touch", true);
                    lines[k] = Some((row, true));
                    continue;
                }
                Outcome::NotTouched => {
                    lines[k] = Some(("0,0,,not-touched,true".to_owned(), true));
                    continue;
                }
                Outcome::Snapped { .. } => "snapped",
                Outcome::SlippedOff { .. } => "slipped-off",
            };
            lines[k] = Some((format!(",,,{branch},false"), false));
        }
    }
    Ok(lines)
}

fn row(data: &WhiskerData, moment: &Vector3<f64>, at_mm: Option<f64>, branch: &str, settled: bool) -> String {
    let moment = data.moments.components_nmm(moment);
    let at = at_mm.map_or_else(String::new, |s| format!("{s:.6}"));
    format!("{:.9},{:.9},{at},{branch},{settled}", moment[0], moment[1])
}

fn by_mujoco(data: &WhiskerData, preset: Preset) -> anyhow::Result<Vec<Text>> {
    let preset = match preset {
        Preset::Released => groove::Preset::Released,
        Preset::Paper => groove::Preset::Paper,
    };
    let mut rows: Vec<Vec<usize>> = Vec::new();
    let mut places: Vec<Vec<Vector3<f64>>> = Vec::new();
    for trajectory in &data.trajectories {
        let mut at = of_trajectory(data, trajectory.id);
        at.sort_by(|a, b| a.1.total_cmp(&b.1));
        places.push(at.iter().map(|(_, x)| trajectory.origin_mm + trajectory.direction * *x).collect());
        rows.push(at.into_iter().map(|a| a.0).collect());
    }
    let labels = groove::labels(&data.whisker, preset, &places)?;
    let mut lines: Vec<Text> = vec![None; data.rows.len()];
    let rod = Rod::new(&data.whisker, WORKING_STEP_MM)?;
    let mut against: Vec<(f64, i64)> = Vec::new();
    for ((trajectory, rows), labels) in data.trajectories.iter().zip(&rows).zip(&labels) {
        let line = Line { origin_mm: trajectory.origin_mm, direction: trajectory.direction };
        let xs: Vec<f64> = rows.iter().filter_map(|k| data.rows[*k].stage_mm).collect();
        let held = rod.follow(&line, &xs);
        for ((k, label), outcome) in rows.iter().zip(labels).zip(&held) {
            let point = data.rows[*k].point;
            say(point, label);
            let Some(moment) = label.moment_nmm else {
                lines[*k] = Some((",,,unstable,false".to_owned(), false));
                continue;
            };
            let branch = match (label.arclength_mm, label.straight_nmm.is_none()) {
                (_, false) => "several",
                (Some(_), true) => "held",
                (None, true) => "free",
            };
            let text = row(data, &moment, label.arclength_mm, branch, label.settled);
            lines[*k] = Some((text, label.settled && label.straight_nmm.is_none()));
            if let (Some(e), "held") = (outcome.equilibrium(), branch) {
                against.push(((moment - e.moment_nmm).norm() / e.moment_nmm.norm(), point));
            }
        }
    }
    if preset == groove::Preset::Released {
        name_other_branches(data, &rod, &rows, &labels);
    }
    against.sort_by(|a, b| a.0.total_cmp(&b.0));
    if let (Some(middle), Some(last)) = (against.get(against.len() / 2), against.last()) {
        eprintln!(
            "twin: moments differ from the frictionless rod's at the same groove places by {:.1} % (median), {:.1} % at most (point {}): \
             clamp, friction, the tip's play and the contact's softness",
            middle.0 * 100.0,
            last.0 * 100.0,
            last.1
        );
    }
    Ok(lines)
}

/// What is remarkable about a label.
fn say(point: i64, label: &PoseLabel) {
    let Some(here) = label.moment_nmm else {
        return eprintln!("twin: point {point}: a step went wrong (NaN or infinity): no moment");
    };
    if let Some(there) = label.straight_nmm {
        eprintln!(
            "twin: point {point} has several equilibria: come to straight from the start the moment is {:.3} N mm instead of {:.3}",
            there.norm(),
            here.norm()
        );
    }
    if !label.settled {
        eprintln!("twin: point {point} is not at rest: {:.2e} rad/s", label.fastest_rad_s);
    }
}

/// Labels of an outside twin farther than this share of their full scale are on another branch.
const OTHER_BRANCH: f64 = 0.01;

/// Compares with the session's own labels: where they leave our branch although it is stable, they are on another equilibrium.
fn name_other_branches(data: &WhiskerData, rod: &Rod, rows: &[Vec<usize>], labels: &[Vec<PoseLabel>]) {
    let scale = |values: &mut dyn Iterator<Item = f64>| {
        let (low, high) = values.fold((0.0_f64, 0.0_f64), |(l, h), x| (l.min(x), h.max(x)));
        high - low
    };
    let outside = &data.twin;
    let full = (0..2).map(|c| scale(&mut outside.iter().map(|l| l.moment_nmm[c]))).fold(0.0, f64::max);
    let (mut largest, mut close, mut all) = (0.0_f64, 0, 0);
    for ((trajectory, rows), labels) in data.trajectories.iter().zip(rows).zip(labels) {
        let line = Line { origin_mm: trajectory.origin_mm, direction: trajectory.direction };
        for (&k, label) in rows.iter().zip(labels) {
            let point = data.rows[k].point;
            let theirs = outside.iter().find(|l| l.point == point);
            let (Some(moment), Some(theirs)) = (label.moment_nmm, theirs) else { continue };
            let ours = data.moments.components_nmm(&moment);
            all += 1;
            let off = (0..2).map(|c| (ours[c] - theirs.moment_nmm[c]).abs()).fold(0.0, f64::max) / full;
            if off < OTHER_BRANCH {
                close += 1;
                largest = largest.max(off);
                continue;
            }
            let held = data.rows[k].stage_mm.map(|x| rod.follow(&line, &[x]));
            let stable = held.and_then(|o| o[0].equilibrium().map(|e| rod.smallest_eigenvalue(e)));
            eprintln!(
                "twin: point {point}: the session's label is {:.0} % of full scale away, on another equilibrium; the branch from first touch is {}",
                off * 100.0,
                stable.map_or("lost there".to_owned(), |e| format!(
                    "stable there (smallest eigenvalue {e:.4} N)"
                ))
            );
        }
    }
    if all > 0 {
        eprintln!("twin: {close} of {all} labels of the session agree, within {largest:.1e} of full scale");
    }
}
