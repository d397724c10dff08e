//! `wcal twin`: the twin's base moments at a session's poses.

use anyhow::bail;
use clap::{Args, ValueEnum};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_core::{Role, SessionData, WhiskerRow};
use wcal_rod::{Line, Outcome, Rod, WORKING_STEP_MM};
use wcal_session::load;

/// Arguments of `wcal twin`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal twin my-session --engine rod --out my-session/twin.csv

One line a reading: point, moment_1_nmm, moment_2_nmm, contact_arclength_mm, branch (first-touch, rest, not-touched, snapped,
slipped-off), settled. Where the wire is not held on the branch from first touch there is no moment, and the exit code is 3.")]
pub struct TwinArgs {
    /// Session folder (kind \"whisker\")
    pub session: PathBuf,
    /// Model of the wire
    #[arg(long, value_enum, default_value = "rod")]
    pub engine: Engine,
    /// Table to write
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
}

/// Models of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Quasi-static Kirchhoff rod, frictionless groove
    Rod,
}

/// Runs the command: 0, or 3 where some reading has no moment.
///
/// # Errors
/// A session of another kind, or a file that cannot be read or written.
pub fn run(args: &TwinArgs) -> anyhow::Result<ExitCode> {
    let Engine::Rod = args.engine;
    let session = load(&args.session)?;
    let SessionData::Whisker(data) = &session.data else {
        bail!("twin: expected a session of kind \"whisker\", found {:?}", session.kind);
    };
    let rod = Rod::new(&data.whisker, WORKING_STEP_MM)?;
    let mut lines: Vec<Option<(String, bool)>> = vec![None; data.rows.len()];
    for trajectory in &data.trajectories {
        let of_it = |row: &WhiskerRow| row.role != Role::Rest && row.trajectory == Some(trajectory.id);
        let at: Vec<(usize, f64)> = (0..data.rows.len())
            .filter(|&k| of_it(&data.rows[k]))
            .filter_map(|k| data.rows[k].stage_mm.map(|x| (k, x)))
            .collect();
        let line = Line { origin_mm: trajectory.origin_mm, direction: trajectory.direction };
        let xs: Vec<f64> = at.iter().map(|a| a.1).collect();
        for (outcome, &(k, _)) in rod.follow(&line, &xs).iter().zip(&at) {
            let branch = match outcome {
                Outcome::Held(held) => {
                    let moment = data.moments.components_nmm(&held.moment_nmm);
                    let text = format!(
                        "{:.9},{:.9},{:.6},first-touch,true",
                        moment[0], moment[1], held.arclength_mm
                    );
                    lines[k] = Some((text, true));
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
    eprintln!(
        "twin: warning: no equilibrium on the branch from first touch at points {}",
        missing.join(", ")
    );
    Ok(ExitCode::from(3))
}
