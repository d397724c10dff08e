//! `wcal twin`: the twin's base moments at a session's poses.

mod mujoco;
mod rows;

use crate::output::{Overwrite, check_file, write_file};
use crate::progress::Progress;
use crate::session_folder::expect_session;
use clap::{Args, ValueEnum};
use rows::{Text, of_trajectory, row};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_core::{Role, WhiskerData};
use wcal_mujoco::groove;
use wcal_rod::{Line, Outcome, Rod, WORKING_STEP_MM};
use wcal_session::load;

/// Arguments of `wcal twin`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal twin my-session --engine rod --out my-session/twin.csv
  wcal twin my-session --engine mujoco --preset released --out my-session/twin.csv

One line a reading: point, moment_1_nmm, moment_2_nmm, contact_arclength_mm, branch, settled (docs/src/formats.md).
Preset released is the released cable, paper the measured one with the clamp right to second order.
Exit code 3: readings without a moment, not at rest, or with several equilibria.")]
pub(crate) struct TwinArgs {
    /// Session folder (kind "whisker")
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
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
}

/// Models of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Engine {
    /// Quasi-static Kirchhoff rod, frictionless groove
    Rod,
    /// MuJoCo's cable in the released groove tip
    Mujoco,
}

/// MuJoCo twins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Preset {
    /// As released with the paper
    Released,
    /// The session's whisker, 40 links, clamp corrected
    Paper,
}

/// First line of the table; labels of another simulator have fewer columns.
const COLUMNS: &str = "point,moment_1_nmm,moment_2_nmm,contact_arclength_mm,branch,settled";

/// Runs the command: 0, or 3 where some reading has no moment.
///
/// # Errors
/// A session of another kind, or a file that cannot be read or written.
pub(crate) fn run(args: &TwinArgs) -> anyhow::Result<ExitCode> {
    check_file(
        &args.out,
        "twin",
        |first| first == COLUMNS,
        args.overwrite.force,
    )?;
    expect_session(&args.session, "twin")?;
    let session = load(&args.session)?;
    let data = session.whisker()?;
    let lines = match args.engine {
        Engine::Rod => {
            let progress = Progress::new("twin");
            progress.stage("rod");
            by_rod(data)?
        }
        Engine::Mujoco => {
            let preset = match args.preset {
                Preset::Released => groove::Preset::Released,
                Preset::Paper => groove::Preset::Paper,
            };
            mujoco::by_mujoco(data, preset)?
        }
    };
    let mut text = format!("{COLUMNS}\n");
    let mut missing = Vec::new();
    for (row, line) in data.rows.iter().zip(lines) {
        // A wire at rest carries no moment, whatever the engine.
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
    write_file(&args.out, text.as_bytes())?;
    eprintln!(
        "twin: {} readings, {} without a moment; {}",
        data.rows.len(),
        missing.len(),
        args.out.display()
    );
    if !missing.is_empty() {
        let points = missing.join(", ");
        eprintln!("twin: warning: no certain equilibrium at points {points}");
    }
    Ok(crate::printing::exit_code(missing.is_empty()))
}

fn by_rod(data: &WhiskerData) -> anyhow::Result<Vec<Text>> {
    let rod = Rod::new(&data.whisker, WORKING_STEP_MM)?;
    let mut lines: Vec<Text> = vec![None; data.rows.len()];
    for trajectory in &data.trajectories {
        let at = of_trajectory(data, trajectory.id);
        let line = Line {
            origin_mm: trajectory.origin_mm,
            direction: trajectory.direction,
        };
        let xs: Vec<f64> = at.iter().map(|a| a.1).collect();
        for (outcome, &(k, _)) in rod.follow(&line, &xs).iter().zip(&at) {
            let branch = match outcome {
                Outcome::Held(held) => {
                    let row = row(
                        data,
                        &held.moment_nmm,
                        Some(held.arclength_mm),
                        "first-touch",
                        true,
                    );
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
