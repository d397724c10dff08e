//! What `wcal track` is asked for, what it assumes, and how every track ends.

use anyhow::Result;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_track::reading::MotionAccuracy;
use wcal_track::sliding::FrictionPrior;
use wcal_track::track_document::{TrackDocument, WhiskerDocument};
use wcal_track::track_table::TrackFiles;
use wcal_track::whisker_track::Outcome;

/// Arguments of `wcal track`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal track session --calibration calibration.json --out track.csv
  wcal track readings.csv --motion arm.csv --calibration calibration.json --out track.csv

Where the motion is known, physics locates the contact; with --model a network does. Columns and
status words: docs/src/formats.md; methods: docs/src/guide/tracking.md.

Exit code 3: readings lost or flagged, or a motion that the network may not know. 4: readings outside the valid region, or regions that
miss the known groove: the table is written, and its rows say so. 4 as well: a calibration or model that cannot be trusted: nothing is
written. With --force it is, and the exit code is 3 where rows are flagged, a missed groove included, else 0.")]
pub struct TrackArgs {
    /// Table, recording (.mcap) or session; without it the rig's interrogator
    pub source: Option<PathBuf>,
    /// calibration.json of verify
    ///
    /// ID=FILE for one of several whiskers.
    #[arg(long, value_name = "[ID=]FILE", required = true)]
    pub calibration: Vec<String>,
    /// Folder of `wcal-lab train`; not needed where the motion is known
    ///
    /// ID=DIR for one of several whiskers.
    #[arg(long, value_name = "[ID=]DIR")]
    pub model: Vec<String>,
    /// Log of the relative motion of base and object
    ///
    /// A CSV with t_s and object_x_mm .. object_z_mm, or base_x_mm .. base_z_mm with base_qw ..
    /// base_qz; _m for metres. Default: such columns of the table.
    #[arg(
        help_heading = "Motion",
        long,
        value_name = "CSV",
        conflicts_with = "model"
    )]
    pub motion: Option<PathBuf>,
    /// rig.toml or its folder; a session has its own
    #[arg(help_heading = "Live", long, value_name = "RIG")]
    pub rig: Option<PathBuf>,
    /// Addresses of `wcal virtual-bench` in place of the rig's
    #[arg(
        help_heading = "Live",
        long,
        value_name = "ADDRESSES.json",
        requires = "rig"
    )]
    pub bench: Option<PathBuf>,
    /// Speed of the base along +z, mm/s, constant and known
    #[arg(help_heading = "Motion", long, value_name = "MM/S")]
    pub base_mm_s: Option<f64>,
    /// The base moves along its +z past an object at rest
    ///
    /// At a speed within the training range: rows in contact are not motion-assumed and have the
    /// network's regions.
    #[arg(help_heading = "Motion", long, requires = "model")]
    pub sweep: bool,
    /// Duration at the start, free of contact, that gives the zero
    ///
    /// In s, its mean moments; 0 keeps the calibration's zero. Default: a table uses the free
    /// readings at its start where they can be identified, a stream the calibration's zero.
    #[arg(help_heading = "Whisker", long, value_name = "S")]
    pub tare_s: Option<f64>,
    /// Relative sd of the diameter of another wire of this kind
    ///
    /// 0.01 for 1 %; its stiffness is then an unknown.
    #[arg(
        help_heading = "Whisker",
        long,
        value_name = "SHARE",
        conflicts_with = "model"
    )]
    pub diameter_sd: Option<f64>,
    /// Friction coefficient of the object, with its standard deviation
    ///
    /// As "0.1 +- 0.05". Default: anything from 0 to 0.3; a slide one way says nothing of it.
    #[arg(
        help_heading = "Motion",
        long,
        value_name = "MU +- SD",
        conflicts_with = "model"
    )]
    pub friction: Option<FrictionPrior>,
    /// Table to write
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
    /// Recording of a live run, which can be tracked again
    #[arg(help_heading = "Live", long, value_name = "MCAP")]
    pub mcap: Option<PathBuf>,
    /// Serve a page on 127.0.0.1 that shows the contacts of a stream or recording as they come; its
    /// address is printed on stderr
    ///
    /// PORT: default a free one. The page with its last state is kept as OUT.live.html beside the
    /// table.
    #[arg(help_heading = "Live", long, value_name = "PORT", num_args = 0..=1, default_missing_value = "0")]
    pub live_page: Option<u16>,
    /// Stop a stream after this time, s, by its own clock
    #[arg(help_heading = "Live", long, value_name = "S")]
    pub seconds: Option<f64>,
    /// Track though it cannot be trusted, or overwrite --out
    ///
    /// With a calibration or model that cannot be trusted every row says so.
    #[arg(long)]
    pub force: bool,
    /// Print the summary (track.json) on stdout
    #[arg(long)]
    pub json: bool,
}

/// Rows per second of a stream: near 10 networks are trained. Lag of its filter, s; its start, free
/// of contact, that the noise is estimated from, s.
pub(crate) const RATE_HZ: f64 = 10.0;
pub(crate) const LAG_S: f64 = 0.1;
pub(crate) const PREFIX_S: f64 = 3.0;
/// Standard deviations of a logged motion: each coordinate, mm, and the offset of its clock, s.
pub(crate) const ACCURACY: MotionAccuracy = MotionAccuracy {
    moved_sd_mm: 0.02,
    clock_sd_s: 0.01,
    window_sd_s: 0.0,
};

/// The end of every track: summary, sentences, and the exit code, with why it is not 0 and what to
/// do in the last line.
///
/// # Errors
/// When the disk does not take it.
pub(crate) fn conclude(
    args: &TrackArgs,
    files: TrackFiles,
    document: &TrackDocument,
    (said, outcome): (Vec<String>, Outcome),
) -> Result<ExitCode> {
    let text = files.finish(document)?;
    if args.json {
        println!("{text}");
    }
    if document.simulated {
        eprintln!("track: SIMULATED: the readings or the calibration are not measured");
    }
    let sum = |of: fn(&WhiskerDocument) -> u64| document.whiskers().map(of).sum::<u64>();
    let [rows, outside, flagged] = [
        sum(|w| w.rows),
        sum(|w| w.outside_valid_region),
        sum(|w| w.flagged_rows),
    ];
    if outside > 0 {
        eprintln!(
            "{outside} of {rows} readings lie outside the valid region; marked in outside_valid_region"
        );
    }
    if flagged > 0 {
        eprintln!("{flagged} of {rows} rows are flagged in status");
    }
    said.iter().for_each(|line| eprintln!("{line}"));
    if let Some(why) = outcome.sentence(args.force) {
        eprintln!("track: {why}");
    }
    Ok(ExitCode::from(outcome.exit_code(args.force)))
}
