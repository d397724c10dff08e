//! `wcal fit-gpr`: the wavelength-to-moment map of a session.

use crate::labels::{LabelSource, MomentLabels, moment_labels};
use crate::output::{OutputFolder, Overwrite, ResultKind, text_of};
use crate::progress::Progress;
use crate::session_folder::expect_session;
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_calibration::{CalibrationModel, WireParts, provenance, seal};
use wcal_core::map_document::{MapDocument, RestZero};
use wcal_core::text::chance;
use wcal_core::{Role, VerificationStatus, WhiskerData, WhiskerRow};
use wcal_gpr::{FitOptions, MapTraining, document, fit_map, test_rest};
use wcal_session::load;
use wcal_verify::whisker::sensitivity::lost_sensitivity;
use wcal_verify::whisker::twin_check::label_faults;

/// Arguments of `wcal fit-gpr`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal fit-gpr fixtures/whiskerfbg --labels twin --out calibration
  wcal fit-gpr fixtures/whiskerfbg --preset released --out as-released

Fits calibration and rest rows only. Exit code 3: a map was fitted, but the readings barely determine a moment,
rows had no label, or the
readings at rest belong to another zero than the loaded ones and were left out.")]
pub struct FitGprArgs {
    /// Session folder (kind "whisker")
    pub session: PathBuf,
    /// Folder for calibration.json, fit-gpr.json and report.html
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Where the moments come from [default: twin where the session has twin.csv, else rod]
    #[arg(long, value_enum)]
    pub labels: Option<LabelSource>,
    /// Reproduce the released code's map instead of choosing one
    #[arg(long, value_enum)]
    pub preset: Option<MapPreset>,
    /// Print fit-gpr.json on stdout
    #[arg(long)]
    pub json: bool,
}

/// Named settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MapPreset {
    /// Thin plate as in the code released with arXiv 2410.14005
    Released,
}

const RESULT: ResultKind<'_> = ResultKind {
    made_of: |folder| text_of(folder, "calibration.json", "session"),
    ..ResultKind::new(
        "fit-gpr",
        "fit-gpr.json",
        "wcal-map/",
        &["calibration.json", "report.html"],
    )
};

/// Runs the command.
///
/// # Errors
/// A session, label source or setting that cannot be used, or a file that cannot be written.
pub fn run(args: &FitGprArgs) -> anyhow::Result<ExitCode> {
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    expect_session(&args.session, "fit-gpr")?;
    let session = load(&args.session)?;
    out.refuse_other(&session.id)?;
    for warning in &session.warnings {
        eprintln!("warning: {warning}");
    }
    let data = session.whisker()?;
    // Gratings that do not respond to the load would still give a map, of their noise.
    if let Some(why) = lost_sensitivity(data)? {
        bail!("fit-gpr: session {:?}: {why}", session.id);
    }
    let default = if data.twin.is_empty() {
        LabelSource::Rod
    } else {
        LabelSource::Twin
    };
    let progress = Progress::new("fit-gpr");
    progress.stage("moments of the poses");
    let source = args.labels.unwrap_or(default);
    let labels = moment_labels(data, source)?;
    // The rod at the same poses is a second measurement of the moments.
    let faults = if source == LabelSource::Twin {
        label_faults(data)?
    } else {
        Vec::new()
    };
    for fault in &faults {
        eprintln!(
            "warning: {} labels of {}: {}",
            fault.points.len(),
            labels.source,
            fault.detail
        );
    }
    let (mut training, unlabelled) = training_set(data, &labels);
    for point in &unlabelled {
        eprintln!(
            "warning: point {point} has no label in {}; not fitted",
            labels.source
        );
    }
    let mut options = FitOptions {
        released: args.preset.is_some(),
        labels: labels.source.clone(),
        fbg: data.fbg.clone(),
        ..FitOptions::default()
    };
    progress.stage("fitting and cross-validating the maps");
    let whose = || format!("session {:?}", session.id);
    // The released map is reproduced as it is.
    let rest = if options.released {
        None
    } else {
        test_rest(&training, &options).with_context(whose)?
    };
    if rest.as_ref().is_some_and(|r| r.left_out) {
        // The free wire stays inside the valid region.
        let at_rest = training
            .shifts_pm
            .iter()
            .zip(&training.trajectory)
            .filter(|(_, t)| t.is_none());
        options.domain_pm = at_rest.map(|(shift, _)| *shift).collect();
        training = training.loaded();
    }
    let mut fit = fit_map(&training, &options).with_context(whose)?;
    fit.artefact.rest = rest;
    drop(progress);
    let poses = training.trajectory.iter().flatten().count();
    let mut result = document(&fit, &training, poses);
    result.simulated = session.simulated;
    // A fit alone vouches for nothing: the calibration says that it is not verified.
    let calibration = seal(
        &session.id,
        VerificationStatus::Unverified,
        None,
        CalibrationModel::Map(fit.artefact),
        provenance(&session, 1),
        Some(WireParts {
            whisker: &data.whisker,
            moments: &data.moments,
            contact: None,
        }),
    )?;

    out.put("calibration.json", serde_json::to_vec_pretty(&calibration)?);
    out.put("fit-gpr.json", serde_json::to_vec_pretty(&result)?);
    out.finish()?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&result)?);
    } else {
        print_text(&result);
    }
    for warning in &result.identifiability.warnings {
        eprintln!("warning: {warning}");
    }
    let left_out = result.rest.as_ref().is_some_and(|r| r.left_out);
    let warned = !result.identifiability.warnings.is_empty();
    Ok(crate::printing::exit_code(
        !warned && unlabelled.is_empty() && faults.is_empty() && !left_out,
    ))
}

/// Calibration and rest rows with their labels; readings of one pose share a group, and so do all
/// rest readings.
pub fn training_set(data: &WhiskerData, labels: &MomentLabels) -> (MapTraining, Vec<i64>) {
    let mut out = MapTraining::default();
    let mut unlabelled = Vec::new();
    let mut poses: Vec<Option<(u32, i64)>> = Vec::new();
    let mut noise: Vec<[f64; 2]> = Vec::new();
    for (row, label) in data.rows.iter().zip(&labels.moments_nmm) {
        // Rows for verification test the map later, so they must not shape it.
        if !matches!(row.role, Role::Calibration | Role::Rest) {
            continue;
        }
        let Some(moment_nmm) = *label else {
            unlabelled.push(row.point);
            continue;
        };
        // Readings of one pose stay together: split, one would be tested on its own repetition.
        let pose = pose_of(row);
        let group = poses.iter().position(|p| *p == pose).unwrap_or_else(|| {
            poses.push(pose);
            poses.len() - 1
        });
        out.shifts_pm.push(row.compensated_pm(&data.fbg));
        out.moments_nmm.push(moment_nmm);
        out.trajectory.push(if row.role == Role::Rest {
            None
        } else {
            row.trajectory
        });
        out.pose.push(u32::try_from(group).unwrap_or(u32::MAX));
        out.point.push(row.point);
        if let (Some(sd), Some(samples)) = (row.shift_sd_pm, row.samples) {
            noise.push(sd.map(|s| s * s / f64::from(samples.max(1))));
        }
    }
    // Samples of one window are averaged, so the reading's own noise is sd / sqrt(samples).
    if !noise.is_empty() && noise.len() == out.len() {
        let n = noise.len() as f64;
        out.noise_sd_pm =
            Some([0, 1].map(|g| (noise.iter().map(|v| v[g]).sum::<f64>() / n).sqrt()));
    }
    (out, unlabelled)
}

/// Trajectory and place on it to 1 um; none at rest. A row without stage position is its own pose
/// (by point).
fn pose_of(row: &WhiskerRow) -> Option<(u32, i64)> {
    let trajectory = row.trajectory.filter(|_| row.role != Role::Rest)?;
    Some((
        trajectory,
        row.stage_mm
            .map_or(i64::MIN + row.point, |s| (s * 1e3).round() as i64),
    ))
}

fn print_text(result: &MapDocument) {
    println!(
        "{}{} poses, labels from {}; errors in N mm (moment 1, moment 2)",
        if result.simulated { "SIMULATED: " } else { "" },
        result.points,
        result.labels
    );
    println!(
        "{:<22}{:>20}{:>20}{:>18}",
        "map", "leave-one-out", "leave-traj.-out", "coverage of 95 %"
    );
    for c in &result.candidates {
        let pair = |v: [f64; 2]| format!("{:.4} / {:.4}", v[0], v[1]);
        println!(
            "{:<22}{:>20}{:>20}{:>18}",
            if c.name == result.chosen {
                format!("{} (chosen)", c.name)
            } else {
                c.name.clone()
            },
            pair(c.loo_rmse_nmm),
            c.loto_rmse_nmm.map_or_else(|| "-".to_owned(), pair),
            format!("{:.2} / {:.2}", c.coverage95[0], c.coverage95[1]),
        );
    }
    if let Some(rest) = &result.rest {
        let RestZero {
            readings,
            offset_nmm: [a, b],
            p_value,
            ..
        } = rest;
        let verdict = if rest.left_out {
            "another zero than the loaded poses: left out, the zero of a track is its own"
        } else {
            "the zero of the loaded poses"
        };
        println!(
            "{readings} readings at rest: {verdict} (they put the free wire at {a:.3} / {b:.3} N mm, {})",
            chance(*p_value)
        );
    }
    println!(
        "condition number of wavelength from moment: {:.2}",
        result.identifiability.condition
    );
}
