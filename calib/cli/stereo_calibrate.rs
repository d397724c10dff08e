//! `wcal stereo-calibrate`: both cameras from pairs of pictures of a board.

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::picture_output::provenance;
use crate::progress::Progress;
use anyhow::Context;
use clap::Args;
use clap::builder::PossibleValuesParser;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_vision::calibrate::board::{Board, Pattern, TagOrder};
use wcal_vision::calibrate::chessboard::BoardSize;
use wcal_vision::calibrate::document::{CameraDocument, StereoDocument};
use wcal_vision::calibrate::export::kalibr_distance_px;
use wcal_vision::calibrate::folders::calibrate_folders;
use wcal_vision::camera::{Lens, OPENCV5, lens_named, lenses};
use wcal_vision::pairs::list_pictures;

/// Names of all patterns.
fn patterns() -> impl Iterator<Item = &'static str> {
    ["chessboard", "charuco", "charuco-legacy"]
        .into_iter()
        .chain(TagOrder::all().map(|o| o.0))
}

/// Arguments of `wcal stereo-calibrate`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal stereo-calibrate board/left board/right --board 9x6 --square-mm 6 --out calibration

Writes stereo.json and the same cameras as OpenCV YAML, Kalibr YAML and ROS camera_info.
Exit code 3: calibrated, with views left out or warnings that matter; 1: refused, nothing written.")]
pub(crate) struct StereoCalibrateArgs {
    /// Left pictures: a folder, or a pattern such as `pictures/left*.jpg`
    pub left: String,
    /// Right pictures, paired with the left ones by the number in their names
    pub right: String,
    /// Inner corners, columns x rows (for an AprilGrid: upright tags, numbered row by row from the
    /// lower left as Kalibr does)
    #[arg(long, value_name = "CxR", value_parser = board_size)]
    pub board: BoardSize,
    /// Side of a square, mm (for an AprilGrid: of a tag)
    #[arg(long, value_name = "MM")]
    pub square_mm: f64,
    /// What is on the board: charuco-legacy is laid out as before OpenCV 4.6; the tags of an
    /// aprilgrid are numbered as Kalibr's, or else as the name says
    #[arg(long, default_value = "chessboard", value_parser = PossibleValuesParser::new(patterns()))]
    pub pattern: String,
    /// Side of a marker, mm (ChArUco); gap between tags, mm (AprilGrid)
    #[arg(long, value_name = "MM")]
    pub marker_mm: Option<f64>,
    /// Dictionary (ChArUco) or family (AprilGrid)
    #[arg(long, value_name = "NAME")]
    pub dictionary: Option<String>,
    /// Number of the first tag (AprilGrid); where the pictures show another row of numbers they are
    /// taken, and said
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first_tag: u32,
    /// Model of both cameras' lenses: opencv5 (five coefficients) for normal and mildly wide ones,
    /// fisheye (Kannala-Brandt, equidistant) for wide fields, also of more than 180 degrees
    #[arg(long, value_name = "MODEL", default_value = OPENCV5.model(), value_parser = PossibleValuesParser::new(lenses().map(Lens::model)))]
    pub lens: String,
    /// Folder for stereo.json and its exports
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print stereo.json on stdout
    #[arg(long)]
    pub json: bool,
}

fn board_size(text: &str) -> Result<BoardSize, String> {
    let (columns, rows) = text
        .split_once(['x', 'X'])
        .ok_or("expected CxR, e.g. 9x6")?;
    let number = |t: &str| t.trim().parse::<usize>().map_err(|e| format!("{t}: {e}"));
    let size = BoardSize {
        columns: number(columns)?,
        rows: number(rows)?,
    };
    if size.columns < 2 || size.rows < 2 || size.columns > 100 || size.rows > 100 {
        return Err(format!("expected 2 to 100 columns and rows, found {size}"));
    }
    Ok(size)
}

const RESULT: ResultKind<'_> = ResultKind::new(
    "stereo-calibrate",
    "stereo.json",
    "wcal-stereo/",
    &["opencv.yml", "kalibr-camchain.yaml", "ros-*.yaml"],
);

/// Smallest side of a square, mm; other programs ask for metres.
const MIN_SQUARE_MM: f64 = 0.5;

/// Distance of Kalibr's camera from the calibrated one that matters: corners are good to less than
/// this, px.
const KALIBR_APART_PX: f64 = 0.5;

/// Runs the command: 0, or 3 where views were left out or warnings matter.
///
/// # Errors
/// Where the pictures cannot be used or the calibration is refused.
pub(crate) fn run(args: &StereoCalibrateArgs) -> anyhow::Result<ExitCode> {
    anyhow::ensure!(
        args.square_mm.is_finite() && args.square_mm > 0.0,
        "--square-mm: expected a length > 0, found {}",
        args.square_mm
    );
    anyhow::ensure!(
        args.square_mm >= MIN_SQUARE_MM,
        "--square-mm {}: expected at least {MIN_SQUARE_MM} mm: is it {} mm, given in metres?",
        args.square_mm,
        1e3 * args.square_mm
    );
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let marker = || {
        args.marker_mm
            .context("--marker-mm is needed for this pattern")
    };
    let pattern = match args.pattern.as_str() {
        "chessboard" => Pattern::Chessboard,
        charuco @ ("charuco" | "charuco-legacy") => Pattern::Charuco {
            marker_mm: marker()?,
            dictionary: args
                .dictionary
                .clone()
                .context("--dictionary is needed for ChArUco boards, e.g. DICT_4X4_50")?,
            legacy: charuco == "charuco-legacy",
        },
        aprilgrid => Pattern::AprilGrid {
            gap_mm: marker()?,
            family: args.dictionary.clone().unwrap_or_else(|| "tag36h11".into()),
            order: TagOrder {
                first: args.first_tag,
                ..TagOrder::all()
                    .find(|o| o.0 == aprilgrid)
                    .map(|o| o.1)
                    .unwrap_or_default()
            },
        },
    };
    let lens = lens_named(&args.lens, Lens::model).map_err(anyhow::Error::msg)?;
    let board = Board {
        size: args.board,
        square_mm: args.square_mm,
        pattern,
    };
    let (mut document, _) = {
        let progress = Progress::new("stereo-calibrate");
        calibrate_folders(&args.left, &args.right, &board, lens, &|stage| {
            progress.stage(stage)
        })?
    };
    let pictures = [list_pictures(&args.left)?, list_pictures(&args.right)?].concat();
    document.provenance = provenance(pictures.iter().map(PathBuf::as_path));
    // Before anything is written: they say why a board that is stated wrongly gives no cameras.
    for view in &document.rejected_views {
        eprintln!("stereo-calibrate: {} left out: {}", view.view, view.why);
    }
    for warning in &document.warnings {
        eprintln!("stereo-calibrate: warning: {warning}");
    }
    let text = serde_json::to_string_pretty(&document)?;
    for (name, content) in wcal_vision::calibrate::export::exports(&document)? {
        out.put(&name, content);
    }
    out.put("stereo.json", text.as_str());
    out.finish()?;
    let apart_px = kalibr_distance_px(&document)?;
    let far = apart_px > KALIBR_APART_PX;
    // Lenses that four coefficients describe need no word.
    if apart_px > 0.001 {
        let warning = if far { "warning: " } else { "" };
        eprintln!(
            "stereo-calibrate: {warning}kalibr-camchain.yaml has four coefficients for five, fitted over the picture: at most {apart_px:.2} px apart"
        );
    }
    if document.provenance.simulated {
        eprintln!("stereo-calibrate: SIMULATED: the pictures are rendered, not taken");
    }
    eprintln!(
        "stereo-calibrate: {} pairs, RMS {:.4} px, held-out epipolar distance {:.4} px (95 %: {:.4})",
        document.views.len(),
        document.rms_px,
        document.held_out.epipolar_mean_px,
        document.held_out.epipolar_p95_px
    );
    eprintln!(
        "stereo-calibrate: the scale follows the stated {} mm: no picture of the board shows an error common to all its sizes",
        args.square_mm
    );
    if args.json {
        println!("{text}");
    } else {
        println!("{}", dimensions(&document));
    }
    let clean = document.rejected_views.is_empty() && document.warnings.is_empty() && !far;
    Ok(crate::printing::exit_code(clean))
}

/// Two-sided 95 % of a Gaussian.
const NORMAL_95: f64 = 1.96;

/// Baseline and focal lengths with their 95 % half widths.
fn dimensions(document: &StereoDocument) -> String {
    let t = [0, 1, 2].map(|k| document.right_from_left[k][3]);
    let baseline = t.iter().map(|v| v * v).sum::<f64>().sqrt();
    // The translation is the last part of the covariance: sd of |t| along t.
    let first = document.covariance.len().saturating_sub(3);
    let block = document.covariance.iter().skip(first).enumerate();
    let along = block.map(|(i, row)| {
        let part = row.iter().skip(first).zip(t).map(|(c, v)| c * v);
        t[i] * part.sum::<f64>()
    });
    let sd = along.sum::<f64>().max(0.0).sqrt() / baseline;
    let focal = |(side, camera): (&str, &CameraDocument)| {
        let sd = camera.sd.get("fx").copied().unwrap_or(f64::NAN);
        format!("{side} {:.2} ± {:.2} px", camera.k[0][0], NORMAL_95 * sd)
    };
    let focal: Vec<String> = ["left", "right"]
        .into_iter()
        .zip(&document.cameras)
        .map(focal)
        .collect();
    format!(
        "baseline {baseline:.3} ± {:.3} mm; focal length {} (95 %)",
        NORMAL_95 * sd,
        focal.join(", ")
    )
}
