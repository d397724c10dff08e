//! `wcal fit-whisker`: the whisker's rest geometry from measured shapes, and its stiffness where
//! moments are known.
//!
//! `whisker.toml` (`format = "wcal-whisker/1"`):
//! - `[whisker]`: the keys of session.toml's table: `diameter_mm` (nominal), `length_mm`, then
//!   `straight_mm`, `arc_radius_mm` or, of a wire of free curvature, `rest_shape` (points, mm), and
//!   with `--moments` `youngs_gpa`, `shear_gpa` (in the nominal ratio). `wcal simulate --whisker`
//!   reads these.
//! - `[curvature]`, of a wire of free curvature: `s_mm` (places), `bend_y_per_mm`, `bend_z_per_mm`
//!   (about the base's y and z where the wire leaves the clamp, linear between the places) and
//!   their sds; `[[rest_models]]`: `model`, `unknowns`, `bic` of all that were tried.
//! - `[root]`: the clamp in the base frame: `turn_rad` (rotation vector), `offset_mm`.
//! - `[stiffness]`, with `--moments`: `youngs_gpa`, `sd_gpa`, `sd_by_geometry_gpa` (its part),
//!   `points`, `rms_nmm`, `left_out`.
//! - `[fit]`: `parameters` (names, in the order of what follows), `sd`, `covariance`,
//!   `covariance_shared` (the part from errors common to all shapes), `rms_mm`, `rms_over_sd`
//!   (residuals over the stated sd), `warnings`; `[[fit.shapes]]`: `name`, `rms_mm`, `largest_mm`,
//!   `largest_at_mm` (arc length).
//! - `[provenance]`: `program`, `command`, `created`, `inputs` with their SHA-256.

mod common_errors;
mod document;
mod dynamics;
mod stiffness;

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::picture_output::provenance;
use crate::progress::Progress;
use anyhow::Context;
use clap::{Args, ValueEnum};
use common_errors::moved_by_shared;
use document::{
    Geometry, Root, SHEAR_GPA, WhiskerDocument, YOUNGS_GPA, curvature, described, rest_models,
};
use dynamics::{DynamicsArgs, dynamics};
use nalgebra::Vector3;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use stiffness::stiffness;
use wcal_core::document::from_json;
use wcal_core::files::read_text;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_core::ranges::Range;
use wcal_core::shapes_document::{PairDocument, SHAPES_FORMAT, ShapesDocument};
use wcal_core::{InputFile, Provenance};
use wcal_mujoco::mjcf::{MjcfOptions, mjcf};
use wcal_rod::{MeasuredShape, RestFit, fit_rest};
use wcal_vision::rig::{Rig, RigWhisker};

/// Residual over stated deviation past which straight part, arc and frictionless groove do not
/// describe the lines.
const DOUBTFUL: f64 = 3.0;

/// Arguments of `wcal fit-whisker`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal fit-whisker shapes/shapes.json --rig rig.toml --out whisker
  wcal fit-whisker shapes/shapes.json --rig rig.toml --moments session --out whisker
  wcal fit-whisker shapes/shapes.json --rig rig.toml --dynamics \\
      --ring-down release.csv --out whisker

The keys of [whisker] in whisker.toml are those of session.toml; whisker.xml is the wire as a MuJoCo model.
Exit code 3: fitted, with shapes left out or residuals past what is stated.")]
pub struct FitWhiskerArgs {
    /// Shapes by `wcal stereo-shape`
    pub shapes: PathBuf,
    /// Rig with the nominal whisker
    #[arg(long, value_name = "rig.toml")]
    pub rig: PathBuf,
    /// Session whose twin.csv holds known base moments at its poses: fits Young's modulus too
    #[arg(long, value_name = "SESSION")]
    pub moments: Option<PathBuf>,
    /// Rest shape: best (by BIC), straight-arc or free-curvature
    #[arg(long, value_enum, default_value = "best", hide_possible_values = true)]
    pub rest: RestChoice,
    /// Damping and contact
    #[command(flatten)]
    pub dynamics: DynamicsArgs,
    /// Folder for whisker.toml and the MuJoCo model whisker.xml
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Models of the rest shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RestChoice {
    /// Whichever BIC asks for
    Best,
    /// Straight part and arc
    StraightArc,
    /// Curvature that is free along the wire, piecewise linear; the number of places by BIC
    FreeCurvature,
}

/// Format tag of `whisker.toml`.
pub const FORMAT: &str = "wcal-whisker/1";

/// Numbers of shapes.json: places and lengths of a wire, their standard deviations, and errors that
/// are small beside them.
const RANGES: &[Range] = &[
    Range::whole("seed", 0.0, 1.9e19),
    Range::whole("point", -9e15, 9e15),
    Range::real("centreline_sd_mm", 1e-6, 1e3),
    Range::real("pairs.centreline_mm", -1e4, 1e4),
    Range::real("pairs.length_mm", 0.0, 1e4),
    Range::real("pairs.length_sd_mm", 0.0, 1e3),
    Range::whole("errors.stations", 0.0, 1e6),
    Range::real("errors.stations_mm", 0.0, 1e4),
    Range::real("errors.floor_mm", 0.0, 1e3),
    Range::real("shared.centreline_mm", -1e7, 1e7),
    Range::real("shared.length_mm", -1e7, 1e7),
    Range::real("shared_covariance", -1e6, 1e6),
    Range::real("groove.position_mm", -1e4, 1e4),
    Range::real("groove.sd_mm", 0.0, 1e3),
    Range::real("groove.contact_arclength_mm", -1e4, 1e4),
    Range::real("groove.contact_arclength_sd_mm", 0.0, 1e3),
    Range::real("", -1e12, 1e12),
];
/// No wire is shorter; a rejected pair states 0.
const MIN_LENGTH_MM: f64 = 1.0;

const RESULT: ResultKind<'_> = ResultKind::new(
    "fit-whisker",
    "whisker.toml",
    "wcal-whisker/",
    &["whisker.xml", "dynamics.csv"],
);

/// Runs the command: 0, or 3 where shapes were left out or residuals are past what is stated.
///
/// # Errors
/// Where the files cannot be read or no geometry comes out.
pub fn run(args: &FitWhiskerArgs) -> anyhow::Result<ExitCode> {
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let document: ShapesDocument = from_json(&read_text(&args.shapes)?, SHAPES_FORMAT, &[RANGES])
        .with_context(|| {
        format!(
            "{}: expected shapes.json of `wcal stereo-shape`",
            args.shapes.display()
        )
    })?;
    let rig = Rig::read(&args.rig)?.whisker;
    let nominal = nominal(&rig, &args.rig)?;
    let (mut usable, mut warnings) = (Vec::new(), Vec::new());
    for pair in &document.pairs {
        match measured(pair) {
            Ok(shape) => usable.push(shape),
            Err(why) => warnings.push(format!("{} is omitted: {why}", pair.name)),
        }
    }
    let choice = match args.rest {
        RestChoice::Best => wcal_rod::RestChoice::Best,
        RestChoice::StraightArc => wcal_rod::RestChoice::StraightArc,
        RestChoice::FreeCurvature => wcal_rod::RestChoice::FreeCurvature,
    };
    let progress = Progress::new("fit-whisker");
    progress.stage("rest shape");
    let mut fit = fit_rest(&nominal, &usable, choice)?;
    // Errors that all shapes share do not average out with their number.
    let moved = moved_by_shared(&document, &usable)?;
    if !moved.is_empty() {
        fit.add_common_errors(&nominal, &moved)?;
    }
    warnings.extend(doubts(&fit, moved.is_empty()));
    progress.stage("stiffness");
    let stiffness = args
        .moments
        .as_ref()
        .map(|session| stiffness(session, &nominal, &fit))
        .transpose()?;
    if let Some(s) = &stiffness {
        warnings.extend(
            s.left_out
                .iter()
                .map(|why| format!("moments: {why}: left out")),
        );
    }
    drop(progress);
    for warning in &warnings {
        eprintln!("fit-whisker: warning: {warning}");
    }
    let rest_shape = fit.model.rest_shape(&fit.values)?;
    let (turn, offset) = fit.model.root(&fit.values);
    let mut result = WhiskerDocument {
        format: FORMAT,
        whisker: Geometry::new(rig.diameter_mm, &rest_shape, stiffness.as_ref()),
        root: Root {
            turn_rad: turn.scaled_axis().into(),
            offset_mm: offset.into(),
        },
        curvature: curvature(&fit),
        stiffness,
        dynamics: None,
        fit: described(&fit, &warnings),
        rest_models: rest_models(&fit),
        provenance: provenance(
            [args.shapes.as_path(), args.rig.as_path()]
                .into_iter()
                .chain(args.moments.as_deref()),
        ),
    };
    // The MuJoCo model needs moduli, nominal ones where none was fitted.
    let fitted = WhiskerSpec {
        rest_shape,
        youngs_gpa: result.whisker.youngs_gpa.unwrap_or(YOUNGS_GPA),
        shear_gpa: result.whisker.shear_gpa.unwrap_or(SHEAR_GPA),
        ..nominal
    };
    let mut options = MjcfOptions::default();
    if args.dynamics.dynamics {
        let (found, fitted) = dynamics(&args.dynamics, &fitted, &mut out)?;
        (result.dynamics, options) = (Some(found), fitted);
    }
    let options = MjcfOptions {
        root_turn_rad: Vector3::from(result.root.turn_rad),
        root_offset_mm: Vector3::from(result.root.offset_mm),
        provenance: stated(&result.provenance),
        ..options
    };
    out.put("whisker.xml", mjcf(&fitted, &options)?);
    out.put("whisker.toml", toml::to_string(&result)?);
    out.finish()?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&result)?);
    } else {
        print_result(&result, &fit);
    }
    if result.provenance.simulated {
        eprintln!("fit-whisker: SIMULATED: the shapes or moments are not measured");
    }
    eprintln!("fit-whisker: {}", args.out.join("whisker.toml").display());
    Ok(crate::printing::exit_code(warnings.is_empty()))
}

/// The wire as the rig has it.
fn nominal(rig: &RigWhisker, place: &Path) -> anyhow::Result<WhiskerSpec> {
    anyhow::ensure!(
        rig.arc_curvature_per_mm > 0.0 && rig.straight_mm < rig.length_mm,
        "{}: expected a whisker with straight_mm and arc_radius_mm, found none",
        place.display()
    );
    Ok(WhiskerSpec {
        diameter_mm: rig.diameter_mm,
        youngs_gpa: YOUNGS_GPA,
        shear_gpa: SHEAR_GPA,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc {
            straight_mm: rig.straight_mm,
            arc_radius_mm: 1.0 / rig.arc_curvature_per_mm,
            length_mm: rig.length_mm,
        },
        gravity_direction: None,
    })
}

/// What a user should know of a fit of the rest shape.
fn doubts(fit: &RestFit, no_common_errors: bool) -> Vec<String> {
    let mut all = Vec::new();
    if no_common_errors {
        all.push(
            "the shapes state no shared errors: common errors (cameras, light, the wire's end) are not in the standard deviations"
                .to_owned(),
        );
    }
    all.extend(
        fit.excluded
            .iter()
            .map(|(name, why)| format!("{name} is omitted: {why}")),
    );
    if fit.covariance.is_none() {
        let found = fit.shapes.len();
        all.push(format!(
            "expected three shapes or more for standard deviations, found {found}"
        ));
    }
    if fit.rms_over_sd > DOUBTFUL {
        all.push(format!(
            "the residuals are {:.1} times their stated uncertainty: a {} in a frictionless groove does not explain the shapes",
            fit.rms_over_sd,
            fit.model.name()
        ));
    }
    all
}

fn print_result(result: &WhiskerDocument, fit: &RestFit) {
    for model in &result.rest_models {
        println!(
            "{:<18} {:>10.1}  ({} unknowns)",
            format!("bic {}", model.model),
            model.bic,
            model.unknowns
        );
    }
    for (k, name) in fit.model.names().iter().enumerate() {
        let sd = fit
            .sd(k)
            .map_or_else(|| "sd not known".to_owned(), |sd| format!("sd {sd:.5}"));
        println!("{name:<18} {:>10.5}  {sd}", fit.values[k]);
    }
    if let Some(s) = &result.stiffness {
        println!(
            "{:<18} {:>10.5}  sd {:.5} (by the geometry {:.5}); {} points, RMS {:.4} N mm",
            "youngs_gpa", s.youngs_gpa, s.sd_gpa, s.sd_by_geometry_gpa, s.points, s.rms_nmm
        );
    }
    println!(
        "{} shapes, RMS {:.4} mm, {:.2} of the stated sd",
        fit.shapes.len(),
        fit.rms_mm,
        fit.rms_over_sd
    );
}

/// Provenance in one line: program, command, time and every input with its SHA-256.
fn stated(p: &Provenance) -> String {
    let input = |i: &InputFile| format!("{} sha256 {}", i.path, i.sha256);
    let inputs = p.inputs.iter().map(input).collect::<Vec<_>>().join(", ");
    let mark = if p.simulated { "SIMULATED; " } else { "" };
    format!(
        "{mark}{}: {}; {}; {inputs}",
        p.program,
        p.command.join(" "),
        p.created
    )
}

/// A usable pair as a shape: free, or held at one place.
fn measured(pair: &PairDocument) -> Result<MeasuredShape, String> {
    if pair.status != "ok" {
        return Err(pair.why.clone());
    }
    let held = pair.groove.as_ref().filter(|g| g.contact != "none");
    if held.is_some_and(|g| g.contacts_mm.len() > 1) {
        return Err("expected one contact, found the groove's two rims".to_owned());
    }
    if !(pair.length_mm >= MIN_LENGTH_MM) {
        return Err(format!(
            "expected a length_mm of {MIN_LENGTH_MM} or more, found {}",
            pair.length_mm
        ));
    }
    if pair.centreline_mm.len() < 2 {
        return Err("expected a centre line, found none".to_owned());
    }
    if pair.centreline_sd_mm.len() != pair.centreline_mm.len() {
        let (points, sds) = (pair.centreline_mm.len(), pair.centreline_sd_mm.len());
        return Err(format!(
            "expected a standard deviation for each of {points} points, found {sds}"
        ));
    }
    Ok(MeasuredShape {
        name: pair.name.clone(),
        centreline_mm: pair
            .centreline_mm
            .iter()
            .map(|p| Vector3::from(*p))
            .collect(),
        sd_mm: pair.centreline_sd_mm.clone(),
        length_mm: [pair.length_mm, pair.length_sd_mm],
        groove: held.map(|g| (Vector3::from(g.position_mm), g.contact_arclength_mm)),
    })
}
