//! A sweep over an object in the layout of the WhiskerFBG release becomes a folder that `wcal track` takes.

use super::{ImportArgs, RESULT, description};
use crate::output::OutputFolder;
use crate::simulated::{is_simulated, word};
use anyhow::{Context, bail};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use toml::{Table, Value};
use wcal_session::{SESSION_FORMAT, TextTableLayout, read_text_table, released_sweep};
use wcal_sim::Mesh;

/// Name of the object's mesh in the folder, and the kind of its description.
pub const OBJECT: &str = "object.stl";
const KIND: &str = "sweep";

/// Files of an imported sweep.
pub struct SweepFolder {
    /// Readings with the poses of the base.
    pub points: PathBuf,
    /// Mesh of the object.
    pub object: PathBuf,
    /// Where the mesh lies in the frame of those poses, where it is known.
    pub world_from_object: Option<Isometry3<f64>>,
}

impl SweepFolder {
    /// Of a folder; none where it is something else.
    pub fn of(folder: &Path) -> Option<Self> {
        let session: Table = wcal_core::files::read_text(folder.join("session.toml")).ok()?.parse().ok()?;
        let file = |key: &str| Some(folder.join(session.get("files")?.get(key)?.as_str()?));
        let pose = session.get("object").and_then(|o| o.get("world_from_object")).and_then(Value::as_array);
        let numbers = pose.map(|p| p.iter().filter_map(Value::as_float).collect::<Vec<_>>());
        let world_from_object = numbers.as_deref().and_then(pose_of);
        let is_sweep = session.get("kind")?.as_str()? == KIND;
        is_sweep.then_some(Self { points: file("points")?, object: file("object")?, world_from_object })
    }
}

/// A place and a unit quaternion as a pose; none where they are none.
fn pose_of(numbers: &[f64]) -> Option<Isometry3<f64>> {
    let [x, y, z, w, i, j, k] = *numbers else { return None };
    let turn = Quaternion::new(w, i, j, k);
    let sound = (turn.norm() - 1.0).abs() < 1e-3 && numbers.iter().all(|v| v.is_finite());
    sound.then(|| Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_normalize(turn)))
}

/// Writes the folder.
///
/// # Errors
/// Where a file cannot be used, by line and column; nothing is written then.
pub fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    let [action, mesh] = &args.more[..] else {
        bail!(
            "--kind whiskerfbg-sweep: expected OPTIC.csv ACTION.csv MESH.stl, found {} files",
            1 + args.more.len()
        );
    };
    let layout = TextTableLayout::default();
    let (optic, action) = (read_text_table(&args.file, &layout)?, read_text_table(action, &layout)?);
    let readings = released_sweep(&optic, &action)?;
    let object = Mesh::read(mesh)?;
    if let Some(pose) = args.object_pose.as_ref().filter(|p| pose_of(p).is_none()) {
        bail!("--object-pose: expected x,y,z (mm) and a unit quaternion qw,qx,qy,qz, found {pose:?}");
    }
    let mut points = "point,t_s,fbg_1_shift_nm,fbg_2_shift_nm,base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz\n".to_owned();
    for (k, r) in readings.iter().enumerate() {
        let [a, b] = r.shift_nm;
        // In the frame of the release the arm goes along +x.
        writeln!(points, "{k},{:.6},{a:.9},{b:.9},{:.6},0,0,1,0,0,0", r.t_s, r.way_mm)?;
    }

    let folder = args.out.file_name().map(|n| n.to_string_lossy().into_owned());
    let id = args.id.clone().or(folder).context("--out: expected the name of a new folder")?;
    let text = |text: &str| Value::from(text);
    let mut top: Table = [
        ("format", text(SESSION_FORMAT)),
        ("id", text(&id)),
        ("kind", text(KIND)),
        ("medium", text(&args.medium)),
    ]
    .into_iter()
    .chain([("created", text(&description::created()?))])
    .map(|(key, value)| (key.to_owned(), value))
    .collect();
    let files = [("points", text("points.csv")), ("object", text(OBJECT))].map(|(k, v)| (k.to_owned(), v));
    top.insert("files".to_owned(), Value::Table(files.into_iter().collect()));
    if let Some(pose) = &args.object_pose {
        let object = [("world_from_object".to_owned(), Value::from(pose.clone()))];
        top.insert("object".to_owned(), Value::Table(object.into_iter().collect()));
    }
    let mut provenance = description::provenance(&[&optic, &action]);
    let simulated = args.simulated || is_simulated(&args.file);
    if simulated {
        provenance.insert("simulated".to_owned(), Value::Boolean(true));
    }
    top.insert("provenance".to_owned(), Value::Table(provenance));

    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    out.put("points.csv", points);
    out.put(OBJECT, wcal_core::files::read(mesh).with_context(|| format!("reading {}", mesh.display()))?);
    out.put("session.toml", toml::to_string(&top)?);
    out.finish()?;
    for note in &object.notes {
        eprintln!("{}: {note}", mesh.display());
    }
    if args.json {
        let document = serde_json::json!({ "format": "wcal-import/1", "session": id, "kind": KIND, "folder": args.out,
            "simulated": simulated, "rows": readings.len(), "holdout_rows": 0, "warnings": [], "inputs": [] });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        println!("{}: {} rows, sweep {id:?}{}", args.out.display(), readings.len(), word(simulated));
    }
    Ok(ExitCode::SUCCESS)
}
