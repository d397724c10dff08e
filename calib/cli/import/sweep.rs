//! A sweep over an object becomes a session of kind "sweep": readings with the poses of the base,
//! and the object where it is known.

use super::arguments::{ImportArgs, layout};
use super::description;
use super::imported::{ImportDocument, OBJECT, RESULT, refuse_other_tables, say};
use super::noticed::Noticed;
use crate::output::OutputFolder;
use crate::simulated::is_simulated;
use anyhow::{Context, bail, ensure};
use std::fmt::Write as _;
use std::process::ExitCode;
use wcal_mesh::Mesh;
use wcal_mesh::mesh_file::as_stl;
use wcal_session::motion_table;
use wcal_session::sweep_session::{KIND, PLACED_SD_MM, pose_of};
use wcal_session::{TextTable, read_text_table};

const POSES: &str = "base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz";

/// What a sweep is made of.
struct Sweep {
    /// points.csv.
    points: String,
    source: TextTable,
    /// Columns that are not taken over.
    left_out: Vec<String>,
    /// Readings at whose time the log tells nothing.
    without_pose: usize,
}

/// A table of readings with the poses of the base from a log.
fn of_tables(args: &ImportArgs) -> anyhow::Result<Sweep> {
    let motion = args
        .motion
        .as_deref()
        .context("--kind sweep: expected --motion LOG.csv, found none")?;
    let table = read_text_table(&args.file, &layout(args))?;
    let logged = motion_table::read(motion)?;
    let taken = |name: &str| {
        name.starts_with("fbg_") && name.ends_with("_nm") || name == "temperature_degc"
    };
    let time = table.column("t_s")?;
    let (columns, others): (Vec<usize>, Vec<usize>) =
        (0..table.columns.len()).partition(|c| taken(&table.columns[*c]));
    let known = |c: &usize| *c == time || matches!(table.columns[*c].as_str(), "point" | "k");
    let left_out = others
        .iter()
        .filter(|c| !known(c))
        .map(|c| table.columns[*c].clone())
        .collect();
    ensure!(
        !columns.is_empty(),
        "{}: expected columns fbg_..._nm, found {}",
        table.file,
        table.columns.join(", ")
    );
    let names: Vec<&str> = columns.iter().map(|c| table.columns[*c].as_str()).collect();
    let mut points = format!("point,t_s,{},{POSES}\n", names.join(","));
    let mut without_pose = 0;
    for (k, (line, cells)) in table.rows.iter().enumerate() {
        let t_s = table.number(k, time)?.with_context(|| {
            format!(
                "{}: line {line}: t_s: expected a time, found none",
                table.file
            )
        })?;
        // What reads as a number stays as it is written.
        let value = |column: &usize| match cells[*column].parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(cells[*column].to_owned()),
            _ => table
                .number(k, *column)
                .map(|number| number.map_or_else(String::new, |n| n.to_string())),
        };
        let values = columns.iter().map(value).collect::<Result<Vec<_>, _>>()?;
        write!(points, "{k},{t_s},{},", values.join(","))?;
        match logged.log.at(t_s, &nalgebra::Vector3::zeros()) {
            Ok(motion) => {
                let pose = motion.world_from_base();
                let (t, q) = (pose.translation.vector, pose.rotation);
                writeln!(
                    points,
                    "{:.6},{:.6},{:.6},{},{},{},{}",
                    t.x, t.y, t.z, q.w, q.i, q.j, q.k
                )?;
            }
            Err(_) => {
                // The wavelengths were measured all the same: the reading stays, without a pose.
                without_pose += 1;
                points += ",,,,,,\n";
            }
        }
    }
    ensure!(
        without_pose < table.rows.len(),
        "{}: expected the times of {} (clocks that agree), found none of its readings in the log",
        motion.display(),
        table.file
    );
    Ok(Sweep {
        points,
        source: table,
        left_out,
        without_pose,
    })
}

/// Writes the folder.
///
/// # Errors
/// Where a file cannot be used, by line and column; nothing is written then.
pub(crate) fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let sweep = of_tables(args)?;
    let object = args
        .object
        .as_deref()
        .map(|mesh| Ok::<_, anyhow::Error>((mesh, Mesh::read(mesh)?)));
    let object = object.transpose()?;
    if let Some(pose) = args.object_pose.as_ref().filter(|p| pose_of(p).is_none()) {
        bail!(
            "--object-pose: expected x,y,z (mm) and a unit quaternion qw,qx,qy,qz, found {pose:?}"
        );
    }
    ensure!(
        object.is_some() || args.object_pose.is_none(),
        "--object-pose: expected --object MESH with it, found none"
    );
    let files = [("points", "points.csv"), ("object", OBJECT)];
    let files = if object.is_some() {
        &files[..]
    } else {
        &files[..1]
    };
    let mut top = description::header(args, KIND, files)?;
    if let Some(pose) = &args.object_pose {
        let place = description::table([
            ("world_from_object", pose.clone().into()),
            ("sd_mm", PLACED_SD_MM.into()),
        ]);
        top.insert("object".to_owned(), place.into());
    }
    let (sources, simulated) = ([sweep.source], is_simulated(&args.file));
    let mut noticed = Noticed::of(&sources);
    let provenance = description::provenance(&sources, simulated, &noticed);
    top.insert("provenance".to_owned(), provenance.into());

    refuse_other_tables(&out, &sources, &sweep.points)?;
    out.put("points.csv", sweep.points);
    if let Some((mesh, _)) = &object {
        out.put(
            OBJECT,
            as_stl(wcal_core::files::read(mesh)?)
                .map_err(|e| anyhow::anyhow!("{}: {e}", mesh.display()))?,
        );
    }
    out.put("session.toml", toml::to_string(&top)?);
    out.finish()?;
    for (mesh, note) in object
        .iter()
        .flat_map(|(mesh, read)| read.notes.iter().map(move |n| (mesh, n)))
    {
        eprintln!("{}: {note}", mesh.display());
    }
    let (rows, missing) = (sources[0].rows.len(), sweep.without_pose);
    if missing > 0 {
        noticed.warnings.push(format!(
            "the motion of {missing} of {rows} readings is not known: the log does not cover their times"
        ));
    }
    let document = ImportDocument {
        format: "wcal-import/1",
        session: description::identifier(args)?,
        kind: KIND.to_owned(),
        folder: &args.out,
        simulated,
        rows,
        holdout_rows: 0,
        columns_left_out: sweep.left_out,
        remarks: noticed.remarks,
        warnings: noticed.warnings,
        inputs: Vec::new(),
    };
    say(args, &document, &sources)
}
