//! CoACD (X. Wei, M. Liu, Z. Ling, H. Su, ACM Trans. Graph. 41, 2022) through its C interface,
//! loaded when it is first needed.
#![allow(unsafe_code)]

use crate::native;
use libloading::Library;
use std::ffi::{c_char, c_int, c_uint};
use wcal_mujoco::engine::protocol::{Decompose, Part, Reply};

/// `CoACD_Mesh` of CoACD 1.0.14, public/coacd.h.
#[repr(C)]
struct Mesh {
    points: *const f64,
    point_count: u64,
    triangles: *const c_int,
    triangle_count: u64,
}

/// `CoACD_MeshArray`.
#[repr(C)]
#[derive(Clone, Copy)]
struct MeshArray {
    meshes: *const Mesh,
    count: u64,
}

/// Mesh, threshold, most parts, preprocessing (0 auto, 2 off) and its resolution, resolution,
/// search (nodes, iterations, depth), PCA, merging, decimation, most corners of a hull, extrusion
/// and its margin, kind of hull (0 convex), seed, real metric.
type Run = unsafe extern "C" fn(
    *const Mesh,
    f64,
    c_int,
    c_int,
    c_int,
    c_int,
    c_int,
    c_int,
    c_int,
    bool,
    bool,
    bool,
    c_int,
    bool,
    f64,
    c_int,
    c_uint,
    bool,
) -> MeshArray;
type Free = unsafe extern "C" fn(MeshArray);
type Level = unsafe extern "C" fn(*const c_char);

/// More parts, and more corners of one, are no answer.
const MAX_PARTS: u64 = 100_000;
const MAX_CORNERS: u64 = 10_000_000;

pub fn parts(surface: &Decompose) -> Reply {
    run(surface).map_or_else(|why| Reply::Refused { why }, |parts| Reply::Parts { parts })
}

fn run(surface: &Decompose) -> Result<Vec<Part>, String> {
    let corners = surface.points.len();
    if surface
        .triangles
        .iter()
        .flatten()
        .any(|k| *k < 0 || *k as usize >= corners)
    {
        return Err("expected triangles between known corners".to_owned());
    }
    let of_coacd = |why| format!("CoACD: {why}");
    let path = native::checked(native::COACD).map_err(of_coacd)?;
    // Its own path leads the system to this one.
    native::checked(native::COACD_OPENMP).map_err(of_coacd)?;
    let lost = |e: libloading::Error| format!("loading {}: {e}", path.display());
    // SAFETY: the file is CoACD's wheel by its SHA-256; its initialisers have no demands.
    let library = unsafe { Library::new(&path) }.map_err(lost)?;
    let mesh = Mesh {
        points: surface.points.as_ptr().cast(),
        point_count: corners as u64,
        triangles: surface.triangles.as_ptr().cast(),
        triangle_count: surface.triangles.len() as u64,
    };
    // SAFETY: the signatures are those of coacd.h 1.0.14; corners and triangles outlive the call and have the stated numbers; what
    // comes back is copied before it is freed by the library that made it.
    unsafe {
        let level = library.get::<Level>(b"CoACD_setLogLevel").map_err(lost)?;
        level(c"off".as_ptr());
        let decompose = library.get::<Run>(b"CoACD_run").map_err(lost)?;
        let free = library.get::<Free>(b"CoACD_freeMeshArray").map_err(lost)?;
        let found = decompose(
            &mesh,
            surface.threshold,
            surface.most_parts,
            0,
            50,
            2000,
            20,
            150,
            3,
            false,
            true,
            false,
            256,
            false,
            0.01,
            0,
            surface.seed,
            false,
        );
        let parts = copied(found);
        if !found.meshes.is_null() {
            free(found);
        }
        parts
    }
}

/// The parts that CoACD hands over.
///
/// # Safety
/// `found` is as CoACD made it: where pointers are not null and counts are believable, they belong
/// together.
unsafe fn copied(found: MeshArray) -> Result<Vec<Part>, String> {
    let wrong = |what: &str, count: u64| {
        format!("CoACD: expected {what}, found {count} at a null pointer or too many")
    };
    if found.count > MAX_PARTS || (found.meshes.is_null() && found.count > 0) {
        return Err(wrong(&format!("at most {MAX_PARTS} parts"), found.count));
    }
    let part = |k: usize| -> Result<Part, String> {
        // SAFETY: `k` is below the count of an array that is there.
        let mesh = unsafe { &*found.meshes.add(k) };
        if mesh.point_count > MAX_CORNERS || (mesh.points.is_null() && mesh.point_count > 0) {
            return Err(wrong(
                &format!("a part of at most {MAX_CORNERS} corners"),
                mesh.point_count,
            ));
        }
        if mesh.points.is_null() {
            return Ok(Vec::new());
        }
        // SAFETY: three numbers a corner, as many corners as the part says.
        let corners = unsafe {
            std::slice::from_raw_parts(mesh.points.cast::<[f64; 3]>(), mesh.point_count as usize)
        };
        if corners.iter().flatten().any(|x| !x.is_finite()) {
            return Err("CoACD: expected finite corners, found others".to_owned());
        }
        Ok(corners.to_vec())
    };
    (0..found.count as usize).map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn null_pointers_and_counts_that_cannot_be_are_refused() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, f64::NAN]];
        let mesh = |points: *const f64, point_count: u64| Mesh {
            points,
            point_count,
            triangles: std::ptr::null(),
            triangle_count: 0,
        };
        let take = |mesh: &Mesh, count: u64| unsafe {
            copied(MeshArray {
                meshes: mesh,
                count,
            })
        };
        let at = corners.as_ptr().cast();
        assert_eq!(
            take(&mesh(at, 2), 1).unwrap(),
            [corners[..2].to_vec()],
            "negative control"
        );
        assert_eq!(
            take(&mesh(std::ptr::null(), 0), 1).unwrap(),
            [Vec::<[f64; 3]>::new()]
        );
        assert!(take(&mesh(at, 3), 1).is_err(), "a corner that is no number");
        assert!(
            take(&mesh(std::ptr::null(), 2), 1).is_err(),
            "corners at a null pointer"
        );
        assert!(
            take(&mesh(at, u64::MAX), 1).is_err(),
            "more corners than there is memory"
        );
        assert!(
            take(&mesh(at, 2), u64::MAX).is_err(),
            "more parts than there is memory"
        );
        let none = |count| unsafe {
            copied(MeshArray {
                meshes: std::ptr::null(),
                count,
            })
        };
        assert!(none(1).is_err() && none(0).unwrap().is_empty());
    }
}
