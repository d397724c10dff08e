//! What pairs are looked at with, and what is written and said of their shapes.

use super::drawing::{drawing, residuals};
use crate::output::{OutputFolder, Overwrite};
use crate::picture_output::provenance;
use crate::progress::Progress;
use anyhow::{Context, Result};
use clap::Args;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use wcal_core::files::{read, read_text};
use wcal_core::order_statistics::median;
use wcal_core::provenance::sha256_hex;
use wcal_core::shapes_document::{PairDocument, ShapesSource, rig_sha256};
use wcal_report::{Fact, ShapePair, ShapesInput, render_shapes};
use wcal_vision::calibrate::import::read_cameras;
use wcal_vision::pairs::PairFiles;
use wcal_vision::picture::Picture;
use wcal_vision::rig::Rig;
use wcal_vision::shape::folder::{ShapesResult, shapes_of_pairs};
use wcal_vision::stereo::StereoCameras;

/// Arguments of `wcal stereo-shape`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal stereo-shape SESSION --cameras calibration/stereo.json
  wcal stereo-shape scene/left scene/right --cameras calibration/stereo.json \\
      --rig rig.toml --out shapes

For a session, the pairs of its settled poses and its own rig are used. shapes.json is written into the session and named in session.toml.
Pairs of the holdout's poses are fitted separately, into shapes-holdout.json.

Exit code 3: finished, with pairs rejected or warnings that matter, each named; 1: no pair could be used.")]
pub(crate) struct StereoShapeArgs {
    /// Session with pictures of its poses; or left pictures: a folder or a pattern
    #[arg(value_name = "SESSION | LEFT")]
    pub left: String,
    /// Right pictures
    #[arg(requires_all = ["rig", "out"])]
    pub right: Option<String>,
    /// Calibration of the cameras: stereo.json, or another tool's (OpenCV, one file or two; Kalibr;
    /// both ROS files), whose uncertainties are unknown
    #[arg(long, num_args = 1..=2, required = true, value_name = "FILE")]
    pub cameras: Vec<PathBuf>,
    /// Rig: whisker, tags, groove; a session has its own
    #[arg(long, value_name = "rig.toml", requires = "right")]
    pub rig: Option<PathBuf>,
    /// Folder for shapes.json and report.html (annotated pictures, residuals, a rotatable 3D view);
    /// for a session, the page only
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print shapes.json on stdout
    #[arg(long)]
    pub json: bool,
}

/// What all pairs are looked at with.
pub(super) struct Shaper {
    stereo: StereoCameras,
    rig: Rig,
    pub(super) rig_file: PathBuf,
    /// Files read besides the pairs.
    read: Vec<PathBuf>,
    pub(super) source: ShapesSource,
}

impl Shaper {
    pub(super) fn new(args: &StereoShapeArgs, rig_file: PathBuf) -> Result<Self> {
        let stereo = read_cameras(&args.cameras)?
            .stereo_cameras()
            .map_err(anyhow::Error::msg)?;
        let rig = Rig::read(&rig_file)?;
        let files: Vec<PathBuf> = args.cameras.iter().chain([&rig_file]).cloned().collect();
        // A calibration may be two files (OpenCV, ROS): one hash stands for both.
        let mut calibration = Vec::new();
        for file in &args.cameras {
            calibration.extend(read(file)?);
        }
        // By values, not by bytes: a new comment in the file makes no other rig.
        let table = wcal_core::document::toml(&read_text(&rig_file)?)
            .with_context(|| format!("reading {}", rig_file.display()))?;
        let source = ShapesSource {
            cameras_sha256: sha256_hex(&calibration),
            rig_sha256: rig_sha256(&serde_json::to_value(&table)?),
            session: None,
        };
        Ok(Self {
            stereo,
            rig,
            rig_file,
            read: files,
            source,
        })
    }

    /// Shapes of pairs, with what they were made from; `session`: identifier of the session that
    /// they belong to.
    pub(super) fn shapes(
        &self,
        files: &[PairFiles],
        session: Option<&str>,
    ) -> Result<ShapesResult> {
        let mut result = {
            let (progress, done) = (Progress::new("stereo-shape"), AtomicUsize::new(0));
            let each = |name: &str| {
                let part = done.fetch_add(1, Ordering::Relaxed) as f64 / files.len() as f64;
                progress.at(&format!("pair {name}"), part);
            };
            shapes_of_pairs(&self.stereo, &self.rig, files, &each)
        };
        if self.stereo.covariance.is_none() {
            result.document.warnings.push(format!(
                "{} has no camera uncertainties: stated uncertainties exclude camera calibration",
                self.read[0].display()
            ));
        }
        let pictures = files.iter().flat_map(|f| [&f.left, &f.right]).flatten();
        result.document.provenance =
            provenance(self.read.iter().chain(pictures).map(PathBuf::as_path));
        result.document.source = ShapesSource {
            session: session.map(str::to_owned),
            ..self.source.clone()
        };
        Ok(result)
    }
}

/// Says what was rejected and why; how many pairs can be used, and whether nothing was to be said
/// of any.
pub(super) fn report_pairs(result: &ShapesResult) -> (usize, bool) {
    let document = &result.document;
    if document.provenance.simulated {
        eprintln!("stereo-shape: SIMULATED: the pictures are rendered, not taken");
    }
    for warning in &document.warnings {
        eprintln!("stereo-shape: warning: {warning}");
    }
    let (mut good, mut clean) = (0, document.warnings.is_empty());
    for pair in &document.pairs {
        clean &= pair.status == "ok" && pair.warnings.is_empty();
        good += usize::from(pair.status == "ok");
        if pair.status != "ok" {
            eprintln!("stereo-shape: {} rejected: {}", pair.name, pair.why);
        }
        for warning in &pair.warnings {
            eprintln!("stereo-shape: {}: warning: {warning}", pair.name);
        }
    }
    let used = format!("stereo-shape: {good} of {} pairs", document.pairs.len());
    let grooves = document.pairs.iter().filter_map(|p| p.groove.as_ref());
    let sds: Vec<f64> = grooves.map(|g| g.contact_arclength_sd_mm).collect();
    match median(sds.iter().copied()) {
        Some(sd) => {
            eprintln!(
                "{used}; contact along the wire known to {sd:.3} mm (median of {})",
                sds.len()
            )
        }
        None => eprintln!("{used}; no contact: the rig's tag is seen in none"),
    }
    (good, clean)
}

/// `shapes.json` and `report.html` (the shapes in space, and every usable pair) into the output
/// folder, where one was asked for.
pub(super) fn put_results(
    args: &StereoShapeArgs,
    shaper: &Shaper,
    result: &ShapesResult,
    files: &[PairFiles],
    out: Option<OutputFolder<'_>>,
) -> Result<()> {
    let Some(mut out) = out else { return Ok(()) };
    let document = &result.document;
    out.put("shapes.json", serde_json::to_string(document)?);
    let mut pairs = Vec::new();
    for ((pair, fit), file) in document.pairs.iter().zip(&result.fits).zip(files) {
        if let (Some(fit), Some(left), Some(right)) = (fit, &file.left, &file.right) {
            let drawn = |camera: usize, source: &Path| {
                drawing(&Picture::read(source)?, camera, &shaper.stereo, fit, pair)
            };
            let pictures = vec![drawn(0, left)?, drawn(1, right)?];
            pairs.push(ShapePair {
                pictures,
                residuals: residuals(fit),
                ..described(pair)
            });
        }
    }
    let rejected = document.pairs.iter().filter(|p| p.status != "ok");
    let made = &document.provenance;
    let input = ShapesInput {
        title: format!("{} of {} pairs used", pairs.len(), document.pairs.len()),
        simulated: made.simulated,
        facts: vec![
            match &args.right {
                Some(right) => Fact::new("pictures", format!("{} and {right}", args.left)),
                None => Fact::new("session", args.left.clone()),
            },
            Fact::new("rig", shaper.rig_file.display().to_string()),
            Fact::new("program", made.program.clone()),
            Fact::new(
                "made",
                made.created
                    .split('.')
                    .next()
                    .unwrap_or_default()
                    .replace('T', " ")
                    + " UTC",
            ),
        ],
        warnings: document.warnings.clone(),
        rejected: rejected.map(|p| [p.name.clone(), p.why.clone()]).collect(),
        pairs,
    };
    out.put("report.html", render_shapes(&input));
    out.finish()
}

/// A pair's numbers in words.
fn described(pair: &PairDocument) -> ShapePair {
    let widest = pair.centreline_sd_mm.iter().fold(0.0f64, |a, b| a.max(*b));
    let [left, right] = pair.residual_rms_px;
    let mut facts = vec![
        Fact::new(
            "length",
            format!("{:.3} ± {:.3} mm", pair.length_mm, pair.length_sd_mm),
        ),
        Fact::new("largest sd across the wire", format!("{widest:.4} mm")),
        Fact::new(
            "RMS from the curve, left / right",
            format!("{left:.3} / {right:.3} px"),
        ),
    ];
    if let Some(g) = &pair.groove {
        let (at, sd) = (g.contact_arclength_mm, g.contact_arclength_sd_mm);
        facts.push(Fact::new(
            format!("contact ({})", g.contact),
            format!("{at:.3} ± {sd:.3} mm from the root"),
        ));
        facts.push(Fact::new(
            "from the vertex that the rig tag states",
            format!("{:.3} mm", g.distance_from_vertex_mm),
        ));
    }
    let gaps = pair.gaps.iter().map(|gap| {
        format!(
            "Not seen from {:.1} to {:.1} mm ({}).",
            gap.from_mm,
            gap.to_mm,
            gap.hidden_in.join(", ")
        )
    });
    ShapePair {
        name: pair.name.clone(),
        facts,
        remarks: gaps.chain(pair.warnings.iter().cloned()).collect(),
        centreline_mm: pair.centreline_mm.clone(),
        groove_mm: pair.groove.as_ref().map(|g| g.position_mm),
        ..ShapePair::default()
    }
}
