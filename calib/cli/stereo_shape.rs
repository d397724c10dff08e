//! `wcal stereo-shape`: the wire's shape and the groove's contact from pairs of pictures.

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::picture_output::provenance;
use crate::progress::Progress;
use crate::report::put_page;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use wcal_core::shapes_document::PairDocument;
use wcal_report::{Fact, Page, ShapePair, ShapePicture, ShapesInput};
use wcal_vision::calibrate::import::read_cameras;
use wcal_vision::pairs::{PairFiles, list_pictures, pair_files};
use wcal_vision::picture::Picture;
use wcal_vision::rig::Rig;
use wcal_vision::shape::drawing::{drawing, residuals};
use wcal_vision::shape::folder::{ShapesResult, shapes_of_pairs};
use wcal_vision::shape::overlay::overlay_png;

/// Arguments of `wcal stereo-shape`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal stereo-shape scene/left scene/right --cameras calibration/stereo.json --rig rig.toml --out shapes --report

Exit code 3: finished, with pairs rejected or warnings that matter, each named; 1: no pair could be used.")]
pub struct StereoShapeArgs {
    /// Left pictures: a folder or a pattern
    pub left: String,
    /// Right pictures
    pub right: String,
    /// Calibration of the cameras: stereo.json, or another tool's (OpenCV, one file or two; Kalibr; both ROS files), whose errors are
    /// not known
    #[arg(long, num_args = 1..=2, required = true, value_name = "FILE")]
    pub cameras: Vec<PathBuf>,
    /// Rig: whisker, tags, groove
    #[arg(long, value_name = "rig.toml")]
    pub rig: PathBuf,
    /// Pictures of the same scene without the wire, left and right (a picture, a folder or a pattern; several are averaged):
    /// cables and texture in them are not taken for the wire
    #[arg(long, num_args = 2, value_names = ["LEFT", "RIGHT"])]
    pub background: Option<Vec<String>>,
    /// Folder for shapes.json and the overlays
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write over what is no earlier result
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Draw what was found into the pictures (overlay-*.png beside shapes.json)
    #[arg(long)]
    pub overlays: bool,
    /// Write report.html: pictures with what was found, residuals, and the shapes in space, to be turned; no network needed
    #[arg(long)]
    pub report: bool,
    /// Print shapes.json on stdout
    #[arg(long)]
    pub json: bool,
}

const RESULT: ResultKind<'_> = ResultKind {
    command: "stereo-shape",
    document: "shapes.json",
    says: "wcal-shapes/",
    files: &["report.html", "report.json", "overlay-*.png"],
    kept: &[],
    resumes: false,
};

/// Runs the command: 0, or 3 where pairs were rejected or warnings matter.
///
/// # Errors
/// Where the files cannot be read or no pair can be used.
pub fn run(args: &StereoShapeArgs) -> anyhow::Result<ExitCode> {
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let stereo = read_cameras(&args.cameras)?.stereo_cameras().map_err(anyhow::Error::msg)?;
    let rig = Rig::read(&args.rig)?;
    let files = pair_files(&list_pictures(&args.left)?, &list_pictures(&args.right)?)?;
    let mut backgrounds = Vec::new();
    let background = match args.background.as_deref() {
        Some([left, right]) => Some([
            empty_scene(left, stereo.cameras[0].image_size_px, &mut backgrounds)?,
            empty_scene(right, stereo.cameras[1].image_size_px, &mut backgrounds)?,
        ]),
        _ => None,
    };
    let mut result = {
        let (progress, done) = (Progress::new("stereo-shape"), AtomicUsize::new(0));
        let each = |name: &str| {
            let part = done.fetch_add(1, Ordering::Relaxed) as f64 / files.len() as f64;
            progress.at(&format!("pair {name}"), part);
        };
        shapes_of_pairs(&stereo, &rig, &files, background.as_ref(), &each)
    };
    if stereo.covariance.is_none() {
        result.document.warnings.push(format!(
            "{} states no errors of the cameras: the standard deviations hold without them",
            args.cameras[0].display()
        ));
    }
    let pictures = files.iter().flat_map(|f| [&f.left, &f.right]).flatten();
    let read = args.cameras.iter().chain([&args.rig]).chain(pictures).chain(&backgrounds);
    result.document.provenance = provenance(read.map(PathBuf::as_path));
    let text = serde_json::to_string_pretty(&result.document)?;
    out.put("shapes.json", text.as_str());
    if args.overlays {
        put_overlays(&result, &files, &mut out)?;
    }
    if args.report {
        put_report(args, &result, &files, &mut out)?;
    }
    if result.document.provenance.simulated {
        eprintln!("stereo-shape: SIMULATED: the pictures are rendered, not taken");
    }
    out.finish()?;
    let mut clean = result.document.warnings.is_empty();
    for warning in &result.document.warnings {
        eprintln!("stereo-shape: warning: {warning}");
    }
    let mut good = 0;
    for pair in &result.document.pairs {
        clean &= pair.status == "ok" && pair.warnings.is_empty();
        good += usize::from(pair.status == "ok");
        if pair.status != "ok" {
            eprintln!("stereo-shape: {} rejected: {}", pair.name, pair.why);
        }
        for warning in &pair.warnings {
            eprintln!("stereo-shape: {}: warning: {warning}", pair.name);
        }
    }
    eprintln!(
        "stereo-shape: {good} of {} pairs; processor time: {}",
        result.document.pairs.len(),
        result.times
    );
    if args.json {
        println!("{text}");
    }
    anyhow::ensure!(
        good > 0,
        "expected at least one usable pair, found none; {} states each reason",
        args.out.join("shapes.json").display()
    );
    Ok(if clean { ExitCode::SUCCESS } else { ExitCode::from(3) })
}

/// Mean of the pictures without the wire; their files are added to `files`.
fn empty_scene(source: &str, size_px: [usize; 2], files: &mut Vec<PathBuf>) -> anyhow::Result<Picture> {
    let listed = list_pictures(source)?;
    let pictures = listed.iter().map(|p| Picture::read(p)).collect::<Result<Vec<_>, _>>()?;
    let mean = Picture::mean(&pictures)?;
    anyhow::ensure!(
        [mean.width, mean.height] == size_px,
        "background {source}: expected {}x{} px as calibrated, found {}x{}",
        size_px[0],
        size_px[1],
        mean.width,
        mean.height
    );
    files.extend(listed);
    Ok(mean)
}

/// Overlays of every usable pair: `overlay-NAME-left.png` and `-right.png`.
fn put_overlays(
    result: &ShapesResult,
    files: &[PairFiles],
    out: &mut OutputFolder<'_>,
) -> anyhow::Result<()> {
    for ((pair, fit), file) in result.document.pairs.iter().zip(&result.fits).zip(files) {
        let Some(fit) = fit else { continue };
        for (camera, source) in [&file.left, &file.right].into_iter().enumerate() {
            let Some(source) = source else { continue };
            let simulated = result.document.provenance.simulated;
            let png = overlay_png(&Picture::read(source)?, camera, &result.stereo, fit, pair, simulated)?;
            out.put(&format!("overlay-{}-{}.png", pair.name, ["left", "right"][camera]), png);
        }
    }
    Ok(())
}

/// `report.html`: the shapes in space, and every usable pair.
fn put_report(
    args: &StereoShapeArgs,
    result: &ShapesResult,
    files: &[PairFiles],
    out: &mut OutputFolder<'_>,
) -> anyhow::Result<()> {
    let document = &result.document;
    let mut pairs = Vec::new();
    for ((pair, fit), file) in document.pairs.iter().zip(&result.fits).zip(files) {
        if let (Some(fit), Some(left), Some(right)) = (fit, &file.left, &file.right) {
            let mut pictures = Vec::new();
            for (camera, (side, source)) in [("left", left), ("right", right)].into_iter().enumerate() {
                let drawn = drawing(&Picture::read(source)?, camera, &result.stereo, fit, pair)?;
                pictures.push(ShapePicture {
                    side: side.to_owned(),
                    size_px: drawn.size_px,
                    jpeg_base64: drawn.jpeg_base64,
                    tags: drawn.tags,
                    curve: drawn.curve,
                    seen: drawn.seen,
                    unseen: drawn.unseen,
                    groove: drawn.groove,
                });
            }
            pairs.push(ShapePair { pictures, residuals: residuals(fit), ..described(pair) });
        }
    }
    let rejected = document.pairs.iter().filter(|p| p.status != "ok");
    let made = &document.provenance;
    let input = ShapesInput {
        title: format!("{} of {} pairs used", pairs.len(), document.pairs.len()),
        simulated: made.simulated,
        facts: vec![
            Fact::new("left pictures", args.left.clone()),
            Fact::new("right pictures", args.right.clone()),
            Fact::new("rig", args.rig.display().to_string()),
            Fact::new("program", made.program.clone()),
            Fact::new("made", made.created.split('.').next().unwrap_or_default().replace('T', " ") + " UTC"),
        ],
        warnings: document.warnings.clone(),
        rejected: rejected.map(|p| [p.name.clone(), p.why.clone()]).collect(),
        pairs,
    };
    put_page(out, "report", &Page::Shapes(input))
}

/// A pair's numbers in words.
fn described(pair: &PairDocument) -> ShapePair {
    let widest = pair.centreline_sd_mm.iter().fold(0.0f64, |a, b| a.max(*b));
    let [left, right] = pair.residual_rms_px;
    let mut facts = vec![
        Fact::new("length", format!("{:.3} ± {:.3} mm", pair.length_mm, pair.length_sd_mm)),
        Fact::new("largest sd across the wire", format!("{widest:.4} mm")),
        Fact::new("RMS from the curve, left / right", format!("{left:.3} / {right:.3} px")),
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
        format!("Not seen from {:.1} to {:.1} mm ({}).", gap.from_mm, gap.to_mm, gap.hidden_in.join(", "))
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
