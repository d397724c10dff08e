//! Mesh files as CAD programs and scanners write them: STL (`stl`), Wavefront OBJ, PLY, any of them
//! in gzip; recognised by their content.

use crate::stl::{MAX_BYTES, Stl, check_count};
use flate2::read::GzDecoder;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};
use std::io::Read;
use wcal_core::text::brief;

/// Corners and triangles of a file's bytes; faces of more corners are fans of triangles.
///
/// # Errors
/// What was expected and found: no mesh, cut off, too many triangles, or an element that has no
/// place.
pub fn parse(bytes: &[u8]) -> Result<Stl, String> {
    if bytes.starts_with(b"\x1f\x8b") {
        // A gzip of a megabyte may hold a gigabyte.
        let mut inside = Vec::new();
        let read = GzDecoder::new(bytes)
            .take(MAX_BYTES + 1)
            .read_to_end(&mut inside);
        read.map_err(|e| format!("expected a whole gzip file, found one that breaks off: {e}"))?;
        return match inside.len() as u64 > MAX_BYTES || inside.starts_with(b"\x1f\x8b") {
            true => Err(format!(
                "expected one mesh of at most {MAX_BYTES} bytes in the gzip file, found more"
            )),
            false => parse(&inside),
        };
    }
    match bytes {
        _ if bytes.starts_with(b"ply") => ply(bytes),
        _ if is_obj(bytes) => obj(bytes),
        _ => Stl::parse(bytes),
    }
}

/// The same surface as an STL file: the bytes themselves where they are one.
///
/// # Errors
/// As [`parse`].
pub fn as_stl(bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    let other = bytes.starts_with(b"\x1f\x8b") || bytes.starts_with(b"ply") || is_obj(&bytes);
    if other {
        Ok(parse(&bytes)?.to_binary())
    } else {
        Ok(bytes)
    }
}

/// Of Wavefront's OBJ each line begins with a keyword, and comments with #.
fn is_obj(bytes: &[u8]) -> bool {
    const WORDS: [&str; 9] = ["v", "vn", "vt", "f", "o", "g", "s", "mtllib", "usemtl"];
    let start = String::from_utf8_lossy(&bytes[..bytes.len().min(4096)]);
    let first = start
        .lines()
        .map(str::trim)
        .find(|line| !line.is_empty() && !line.starts_with('#'));
    first
        .and_then(|line| line.split_ascii_whitespace().next())
        .is_some_and(|word| WORDS.contains(&word))
}

fn obj(mut bytes: &[u8]) -> Result<Stl, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ..tobj::LoadOptions::default()
    };
    // Colours and pictures on the surface are no part of its shape.
    let no_materials = |_: &std::path::Path| Ok(Default::default());
    let (models, _) = tobj::load_obj_buf(&mut bytes, &options, no_materials).map_err(|e| {
        format!(
            "expected an OBJ file of corners (v) and faces (f), found: {}",
            brief(&e.to_string())
        )
    })?;
    let meshes = models.iter().map(|model| &model.mesh);
    faces(meshes.flat_map(|mesh| {
        let corner = |k: &u32| {
            mesh.positions
                .get(3 * *k as usize..)?
                .first_chunk()
                .copied()
        };
        mesh.indices
            .chunks_exact(3)
            .map(move |face| face.iter().map(corner).collect())
    }))
}

/// An element of a PLY file: a corner's place, or the corners of a face.
#[derive(Default)]
struct Element {
    place: [f32; 3],
    corners: Vec<u32>,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, value: Property) -> PropertyAccessResult {
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == name);
        match (axis, name, value) {
            (Some(k), _, Property::Float(v)) => self.place[k] = v,
            (Some(k), _, Property::Double(v)) => self.place[k] = v as f32,
            (_, "vertex_indices" | "vertex_index", Property::ListInt(all)) => {
                // A corner before the first is none.
                self.corners = all
                    .into_iter()
                    .map(|k| u32::try_from(k).unwrap_or(u32::MAX))
                    .collect();
            }
            (_, "vertex_indices" | "vertex_index", Property::ListUInt(all)) => self.corners = all,
            (Some(_), ..) | (_, "vertex_indices" | "vertex_index", _) => {
                return PropertyAccessResult::UnsupportedType;
            }
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }
}

fn ply(mut bytes: &[u8]) -> Result<Stl, String> {
    let read = Parser::<Element>::new().read_ply(&mut bytes);
    let file = read.map_err(|e| {
        format!(
            "expected a PLY file of float corners and int faces, found: {}",
            brief(&e.to_string())
        )
    })?;
    let of = |name: &str| file.payload.get(name).map_or(&[][..], Vec::as_slice);
    let places = of("vertex");
    let corner = |k: &u32| places.get(*k as usize).map(|v| v.place);
    faces(
        of("face")
            .iter()
            .map(|face| face.corners.iter().map(corner).collect()),
    )
}

/// Faces as triangles; none of a corner that is not there.
fn faces(all: impl Iterator<Item = Option<Vec<[f32; 3]>>>) -> Result<Stl, String> {
    let mut mesh = Stl::default();
    for corners in all {
        let corners = corners
            .ok_or("expected faces between the corners of the file, found one beyond them")?;
        check_count((mesh.triangles.len() + corners.len()) as u64)?;
        for k in 2..corners.len() {
            mesh.push([corners[0], corners[k - 1], corners[k]]);
        }
    }
    match mesh.triangles.is_empty() {
        true => Err("expected faces, found a cloud of points or nothing".to_owned()),
        false => Ok(mesh),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    const OBJ: &str =
        "# made by hand\no square\nv 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n";
    const PLY: &str = "ply\nformat ascii 1.0\ncomment x\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 9\n4 0 0 9\n4 4 0 9\n0 4 0 9\n4 0 1 2 3\n";

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        out.write_all(bytes).unwrap();
        out.finish().unwrap()
    }

    #[test]
    fn forms_are_told_by_their_content_and_mean_the_same() {
        let corners = [
            [0.0, 0.0, 0.0],
            [4.0, 0.0, 0.0],
            [4.0, 4.0, 0.0],
            [0.0, 4.0, 0.0],
        ];
        let double = PLY
            .replace("float", "double")
            .replace("vertex_indices", "vertex_index");
        for bytes in [
            OBJ.as_bytes(),
            PLY.as_bytes(),
            double.as_bytes(),
            &gzip(OBJ.as_bytes()),
            &gzip(PLY.as_bytes()),
        ] {
            let found = parse(bytes).unwrap();
            assert_eq!(
                (&found.points[..], &found.triangles[..]),
                (&corners[..], &[[0, 1, 2], [0, 2, 3]][..])
            );
        }
    }

    #[test]
    fn damaged_files_are_named() {
        let whole = gzip(OBJ.as_bytes());
        for (bytes, says) in [
            (OBJ.replace("f 1/1", "f 9/1").into_bytes(), "OBJ"),
            (
                OBJ.replace("f 1/1 2/1 3/1 4/1", "").into_bytes(),
                "cloud of points",
            ),
            (
                PLY.replace("4 0 1 2 3", "4 0 1 2 7").into_bytes(),
                "beyond them",
            ),
            (
                PLY.replace("4 0 1 2 3", "4 0 1 -2 3").into_bytes(),
                "beyond them",
            ),
            (
                PLY.replace("element face 1", "element face 4000000000")
                    .into_bytes(),
                "PLY",
            ),
            (
                PLY.replace("element vertex 4", "element vertex 3")
                    .into_bytes(),
                "expected faces",
            ),
            (whole[..whole.len() / 2].to_vec(), "breaks off"),
            (gzip(&whole), "one mesh"),
            (b"OFF\n4 1 0\n".to_vec(), "save it as STL"),
        ] {
            let error = parse(&bytes).unwrap_err();
            assert!(error.contains(says), "{says}: {error}");
        }
    }
}
