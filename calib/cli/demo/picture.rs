//! The measured sweep of the demonstration in space.

use anyhow::{Context, Result};
use nalgebra::{Isometry3, Vector3};
use std::path::Path;
use wcal_contact::mesh_score::{KnownObject, MeshScore};
use wcal_contact::sweep_session::{SweepSession, pose_of};
use wcal_report::SweepPicture;
use wcal_session::{TextTable, TextTableLayout, read_text_table};
use wcal_sim::Mesh;

/// Slices of the object on either side of the wire's plane, and their distance, mm.
const SLICES: i32 = 1;
const SLICE_MM: f64 = 10.0;
const POSE: [&str; 7] = ["base_x_mm", "base_y_mm", "base_z_mm", "base_qw", "base_qx", "base_qy", "base_qz"];

/// From the files of a demonstration: contacts beside those of the released network, the wire at first touch, the bottle.
///
/// # Errors
/// Where one of the files is not what it should be.
pub fn sweep_picture(place: &Path) -> Result<SweepPicture> {
    let (sweep, whisker) = (place.join("bottle/session"), place.join("whiskerfbg/session"));
    let session = SweepSession::of(&sweep)?.context("bottle/session: expected a sweep")?;
    let pose = session.world_from_object.context("bottle/session: expected the place of the object")?;
    let mesh = Mesh::read(&session.object.context("bottle/session: expected an object")?)?;
    let track = table(&place.join("bottle/track.csv"))?;
    let own = rows(&track, &["world_x_mm", "world_y_mm", "world_z_mm"])?;
    let released = table(&sweep.join("released_contacts.csv"))?;
    let released = rows(&released, &["world_x_mm", "world_y_mm", "world_z_mm"])?;
    // The wire at rest, where the first contact was found.
    let first = own.first().map_or(0, |r| r.0);
    let poses = rows(&table(&session.points)?, &POSE)?;
    let base =
        poses.iter().find(|r| r.0 == first).and_then(|r| pose_of(&r.1)).unwrap_or_else(Isometry3::identity);
    let shape = rows(&table(&whisker.join("rest_shape.csv"))?, &["x_mm", "y_mm", "z_mm"])?;
    let wire_mm = shape.iter().map(|r| base.transform_point(&point(&r.1).into()).coords.into()).collect();
    let slice = |z_mm: f64| slice(&mesh, &pose, z_mm);
    let object = KnownObject::new(mesh.clone(), pose, 0.0)?;
    let score = MeshScore::new(released.iter().map(|r| object.distance_mm(&point(&r.1))).collect());
    let outside_mm = score.context("released_contacts.csv: expected contacts")?.distances.mean_mm;
    let points = |of: &[(usize, Vec<f64>)]| of.iter().map(|r| point(&r.1).into()).collect();
    Ok(SweepPicture {
        slice_mm: slice(0.0),
        slices_mm: (-SLICES..=SLICES).flat_map(|k| slice(SLICE_MM * f64::from(k))).collect(),
        wire_mm,
        wire: "the wire at rest, at first touch (line)".into(),
        contacts_mm: vec![
            (
                format!("{} contacts by the map of the 27 poses, along the known motion", own.len()),
                points(&own),
            ),
            (
                format!(
                    "{} contacts of the released network ({outside_mm:.2} mm from the outside in the mean)",
                    released.len()
                ),
                points(&released),
            ),
        ],
        caption: format!(
            "The measured sweep over the bottle (grey: slices of its mesh every {SLICE_MM:.0} mm) from above and obliquely. {}",
            stated(place)?
        ),
        simulated: false,
    })
}

/// What track.json says of the distances.
fn stated(place: &Path) -> Result<String> {
    let file = place.join("bottle/track.json");
    let text = wcal_core::files::read_text(&file).with_context(|| file.display().to_string())?;
    let document = wcal_core::document::json(&text).with_context(|| file.display().to_string())?;
    let of = |v: &serde_json::Value| {
        let number = |key: &str| v[key].as_f64().unwrap_or(f64::NAN);
        format!(
            "{:.2} mm in the mean ({:.2} rms, 95 % below {:.2})",
            number("mean_mm"),
            number("rmse_mm"),
            number("p95_mm")
        )
    };
    Ok(format!(
        "The contacts lie {} from the outside of the bottle where the release put it.",
        of(&document["object"])
    ))
}

fn table(path: &Path) -> Result<TextTable> {
    Ok(read_text_table(path, &TextTableLayout::default())?)
}

/// Rows with a number in every one of these columns, each with its place in the table.
fn rows(table: &TextTable, columns: &[&str]) -> Result<Vec<(usize, Vec<f64>)>> {
    let columns = columns.iter().map(|c| table.column(c)).collect::<Result<Vec<_>, _>>()?;
    let mut all = Vec::new();
    for k in 0..table.rows.len() {
        let cells = columns.iter().map(|c| table.number(k, *c)).collect::<Result<Option<Vec<f64>>, _>>()?;
        all.extend(cells.map(|cells| (k, cells)));
    }
    Ok(all)
}

fn point(cells: &[f64]) -> Vector3<f64> {
    Vector3::new(cells[0], cells[1], cells[2])
}

/// Where a plane of constant z cuts the triangles of a mesh.
fn slice(mesh: &Mesh, pose: &Isometry3<f64>, z_mm: f64) -> Vec<[[f64; 3]; 2]> {
    let corners: Vec<Vector3<f64>> = mesh.points().map(|p| pose.transform_point(&p.into()).coords).collect();
    let cut = |t: &[u32; 3]| -> Option<[[f64; 3]; 2]> {
        let p = t.map(|k| corners[k as usize]);
        let edges = [(0, 1), (1, 2), (2, 0)];
        let crossed = edges.iter().filter(|(a, b)| (p[*a].z < z_mm) != (p[*b].z < z_mm));
        let ends: Vec<[f64; 3]> =
            crossed.map(|(a, b)| p[*a].lerp(&p[*b], (z_mm - p[*a].z) / (p[*b].z - p[*a].z)).into()).collect();
        ends.try_into().ok()
    };
    mesh.triangles().iter().filter_map(cut).collect()
}
