//! `wcal stereo-shape SESSION`: shapes of the poses that a session pictured, written into it.

use super::shaper::{Shaper, StereoShapeArgs, put_results, report_pairs};
use crate::output::OutputFolder;
use anyhow::{Context, Result, bail, ensure};
use std::path::Path;
use std::process::ExitCode;
use wcal_acquisition::pose_pictures::{PosePair, pose_pairs};
use wcal_acquisition::rig::Rig as BenchRig;
use wcal_core::files::{read_text, write_atomic};
use wcal_core::shapes_document::{SHAPES_FORMAT, ShapesDocument};
use wcal_session::set_entries;
use wcal_vision::pairs::PairFiles;

/// Shapes of the table's rows and of the sealed ones: file, and key of `[files]`.
const RESULTS: [(bool, &str, &str); 2] = [
    (false, "shapes.json", "shapes"),
    (true, "shapes-holdout.json", "holdout_shapes"),
];

/// Fits the pairs of the session's poses, writes them into the session and names them in
/// session.toml.
pub(super) fn run(
    args: &StereoShapeArgs,
    shaper: &Shaper,
    mut out: Option<OutputFolder<'_>>,
) -> Result<ExitCode> {
    let folder = Path::new(&args.left);
    let id = session_id(folder)?;
    // Files of others are found now, not after all pairs are fitted.
    for (_, file, _) in RESULTS {
        check_own(&folder.join(file), args.overwrite.force)?;
    }
    let bench = BenchRig::parse(
        &shaper.rig_file.display().to_string(),
        &read_text(&shaper.rig_file)?,
    )?;
    let names: Vec<&str> = bench.camera.iter().map(|c| c.name.as_str()).collect();
    let [left, right] = names[..] else {
        bail!(
            "{}: expected two cameras, found {}",
            shaper.rig_file.display(),
            names.len()
        )
    };
    let mut clean = true;
    let mut entries = vec![
        (
            "provenance",
            "cameras_sha256",
            shaper.source.cameras_sha256.as_str(),
        ),
        (
            "provenance",
            "shapes_rig_sha256",
            shaper.source.rig_sha256.as_str(),
        ),
    ];
    let mut documents = Vec::new();
    for (sealed, file, key) in RESULTS {
        let poses = pose_pairs(folder, &id, [left, right], sealed)?;
        if poses.is_empty() {
            ensure!(
                sealed,
                "{}: expected pictures/pictures.csv with pictures of its poses, found none",
                args.left
            );
            continue;
        }
        let files: Vec<PairFiles> = poses.iter().map(pair).collect();
        let mut result = shaper.shapes(&files, Some(&id))?;
        out_of_groove(&mut result.document, &poses);
        // The page shows the table's poses alone: nobody looks at the sealed ones here.
        if !sealed {
            put_results(args, shaper, &result, &files, out.take())?;
        }
        let (good, all) = report_pairs(&result);
        ensure!(
            sealed || good > 0,
            "expected at least one usable pair, found none"
        );
        clean &= all;
        documents.push((file, serde_json::to_string(&result.document)?));
        entries.push(("files", key, file));
    }
    // The session names what is there: files first.
    for (file, text) in &documents {
        write_atomic(&folder.join(file), text.as_bytes())?;
    }
    set_entries(folder, &entries)?;
    if let Some((_, text)) = documents.first().filter(|_| args.json) {
        println!("{text}");
    }
    Ok(crate::printing::exit_code(clean))
}

fn session_id(folder: &Path) -> Result<String> {
    let path = folder.join("session.toml");
    let text = read_text(&path).context("expected a session folder, or two folders of pictures")?;
    let table = wcal_core::document::toml(&text).with_context(|| path.display().to_string())?;
    let id = table
        .get("id")
        .and_then(toml::Value::as_str)
        .map(str::to_owned);
    id.with_context(|| format!("{}: expected an id, found none", path.display()))
}

/// Refuses to replace what is no shapes document.
fn check_own(path: &Path, force: bool) -> Result<()> {
    if force || !path.exists() {
        return Ok(());
    }
    let own = serde_json::from_str::<ShapesDocument>(&read_text(path)?)
        .is_ok_and(|d| d.format == SHAPES_FORMAT);
    ensure!(
        own,
        "{}: expected an earlier result of `wcal stereo-shape`, found something else (--force replaces it)",
        path.display()
    );
    Ok(())
}

fn pair(pose: &PosePair) -> PairFiles {
    let [left, right] = pose.files.clone();
    PairFiles {
        name: format!("{:05}", pose.point),
        left,
        right,
        point: Some(pose.point),
        refused: pose.refused.clone(),
    }
}

/// A loaded pose whose wire does not sit in the groove says nothing of the contact.
fn out_of_groove(document: &mut ShapesDocument, poses: &[PosePair]) {
    for (pair, _) in document
        .pairs
        .iter_mut()
        .zip(poses)
        .filter(|(_, pose)| pose.loaded)
    {
        if pair.status != "ok" {
            continue;
        }
        let warning = match pair.groove.as_ref().map(|g| g.contact.as_str()) {
            Some("vertex") => continue,
            Some(other) => format!("the wire is not in the groove's vertex (contact {other})"),
            None => "the rig tag is not seen: no contact".to_owned(),
        };
        pair.warnings.push(warning);
    }
}
