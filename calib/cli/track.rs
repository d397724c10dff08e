//! `wcal track`: from a recording of wavelengths to contact points.

use crate::artefact::{CalibrationModel, read_calibration, standing};
use crate::predict::{Moments, moments_of_map, moments_of_model};
use crate::train::burn_device;
use anyhow::{Context, bail};
use clap::Args;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_session::write_atomic;
use wcal_track::Sample;
use wcal_track::model_file::load;

/// Arguments of `wcal track`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal track readings.csv --calibration calibration.json --model model --out track.csv

TABLE as for `wcal predict`, with t_s in every row, some ten readings a second. Columns of track.csv: point, t_s, moments and whether
the calibration vouches for them, probability of contact, contact_{x,y,z}_mm in the base frame and their covariance (mm2). The network
was trained on SIMULATED sweeps. Exit code 4: readings outside the valid region (marked), or a calibration that is unverified, expired
or failed: nothing is written then without --force, with which every row says so.")]
pub struct TrackArgs {
    /// Table of readings
    pub table: PathBuf,
    /// calibration.json of verify
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    /// Folder of `wcal train`
    #[arg(long, value_name = "DIR")]
    pub model: PathBuf,
    /// Speed of the base along +z, where it is constant and known, mm/s
    #[arg(long, value_name = "MM/S")]
    pub base_mm_s: Option<f64>,
    /// Table to write
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
    /// Track although the calibration does not vouch for it; every row says so
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// Where a file cannot be used, or a row has no time.
pub fn run(args: &TrackArgs) -> anyhow::Result<ExitCode> {
    let file = read_calibration(&args.calibration)?;
    let (tracker, _) = load(&args.model, &burn_device())?;
    let mut doubts = standing(&file, jiff::Timestamp::now())?;
    if file.verification == wcal_core::VerificationStatus::Unverified {
        doubts.push("the calibration was never verified".to_owned());
    }
    for doubt in &doubts {
        eprintln!("{}: {doubt}", if args.force { "warning" } else { "refused" });
    }
    if !doubts.is_empty() && !args.force {
        return Ok(ExitCode::from(4));
    }
    let rows = match &file.model {
        CalibrationModel::Map(artefact) => {
            moments_of_map(&args.table, artefact).with_context(|| args.calibration.display().to_string())?
        }
        CalibrationModel::Physical(model) => moments_of_model(&args.table, model)?,
        CalibrationModel::Scalar(_) => {
            bail!("{}: expected a whisker's calibration, found a scalar one", args.calibration.display())
        }
    };
    let doubtful = u8::from(!doubts.is_empty());
    let mut csv = String::from(
        "point,t_s,moment_1_nmm,moment_2_nmm,outside_valid_region,calibration_doubtful,contact_probability,\
         contact_x_mm,contact_y_mm,contact_z_mm,var_xx_mm2,var_yy_mm2,var_zz_mm2,cov_xy_mm2,cov_xz_mm2,cov_yz_mm2\n",
    );
    let mut stream = tracker.stream();
    let mut last_s = f64::NEG_INFINITY;
    for Moments { point, t_s, moment_nmm, valid, .. } in &rows {
        let t_s = t_s.with_context(|| {
            format!("{}: point {point}: t_s: expected a time, found none", args.table.display())
        })?;
        if !(t_s > last_s) {
            bail!(
                "{}: point {point}: t_s: expected a later time than {last_s}, found {t_s}",
                args.table.display()
            );
        }
        last_s = t_s;
        let p = stream.push(&Sample { t_s, moment_nmm: *moment_nmm, base_mm_s: args.base_mm_s });
        let c = p.covariance_mm2;
        write!(
            csv,
            "{point},{t_s},{:.6},{:.6},{},{doubtful}",
            moment_nmm[0],
            moment_nmm[1],
            u8::from(!valid)
        )?;
        write!(csv, ",{:.4}", p.contact)?;
        for x in p.point_mm.iter().chain(&[c[0][0], c[1][1], c[2][2], c[0][1], c[0][2], c[1][2]]) {
            write!(csv, ",{x:.4}")?;
        }
        csv.push('\n');
    }
    write_atomic(&args.out, csv.as_bytes())?;
    let outside = rows.iter().filter(|r| !r.valid).count();
    if outside > 0 {
        eprintln!(
            "{outside} of {} readings lie outside the valid region; marked in outside_valid_region",
            rows.len()
        );
    }
    Ok(ExitCode::from(if outside == 0 || args.force { 0 } else { 4 }))
}
