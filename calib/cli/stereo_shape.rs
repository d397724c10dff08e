//! `wcal stereo-shape`: the wire's shape and the groove's contact from pairs of pictures.

mod drawing;
mod session;
mod shaper;

use crate::output::{OutputFolder, ResultKind};
pub(crate) use shaper::StereoShapeArgs;
use shaper::{Shaper, put_results, report_pairs};
use std::path::Path;
use std::process::ExitCode;
use wcal_vision::pairs::{list_pictures, pair_files};

const RESULT: ResultKind<'_> = ResultKind::new(
    "stereo-shape",
    "shapes.json",
    "wcal-shapes/",
    &["report.html"],
);

/// Runs the command: 0, or 3 where pairs were rejected or warnings matter.
///
/// # Errors
/// Where the files cannot be read or no pair can be used.
pub(crate) fn run(args: &StereoShapeArgs) -> anyhow::Result<ExitCode> {
    let out = match &args.out {
        Some(folder) => Some(OutputFolder::open(&RESULT, folder, args.overwrite.force)?),
        None => None,
    };
    let rig_file = args
        .rig
        .clone()
        .unwrap_or_else(|| Path::new(&args.left).join("rig.toml"));
    let shaper = Shaper::new(args, rig_file)?;
    let Some(right) = &args.right else {
        return session::run(args, &shaper, out);
    };
    let files = pair_files(&list_pictures(&args.left)?, &list_pictures(right)?)?;
    let result = shaper.shapes(&files, None)?;
    let text = serde_json::to_string(&result.document)?;
    put_results(args, &shaper, &result, &files, out)?;
    if args.json {
        println!("{text}");
    }
    let (good, clean) = report_pairs(&result);
    let place = args.out.clone().unwrap_or_default().join("shapes.json");
    anyhow::ensure!(
        good > 0,
        "expected at least one usable pair, found none; {} states each reason",
        place.display()
    );
    Ok(crate::printing::exit_code(clean))
}
