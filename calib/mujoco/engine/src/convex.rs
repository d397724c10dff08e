//! CoACD (X. Wei, M. Liu, Z. Ling, H. Su, ACM Trans. Graph. 41, 2022) through its C interface, loaded when it is first needed.
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

/// Mesh, threshold, most parts, preprocessing (0 auto, 2 off) and its resolution, resolution, search (nodes, iterations, depth), PCA,
/// merging, decimation, most corners of a hull, extrusion and its margin, kind of hull (0 convex), seed, real metric.
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

pub fn parts(surface: &Decompose) -> Reply {
    run(surface).map_or_else(|why| Reply::Refused { why }, |parts| Reply::Parts { parts })
}

fn run(surface: &Decompose) -> Result<Vec<Part>, String> {
    let corners = surface.points.len();
    if surface.triangles.iter().flatten().any(|k| *k < 0 || *k as usize >= corners) {
        return Err("expected triangles between known corners".to_owned());
    }
    let path = native::folder().join(native::COACD);
    if !path.is_file() {
        return Err(format!("expected CoACD at {}, found none (`make setup` fetches it)", path.display()));
    }
    let lost = |e: libloading::Error| format!("loading {}: {e}", path.display());
    // SAFETY: the file is CoACD's wheel (SHA-256 checked by fetch.sh); its initialisers have no demands.
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
        let copy = |mesh: &Mesh| -> Part {
            std::slice::from_raw_parts(mesh.points.cast::<[f64; 3]>(), mesh.point_count as usize).to_vec()
        };
        let parts = (0..found.count as usize).map(|k| copy(&*found.meshes.add(k))).collect();
        free(found);
        Ok(parts)
    }
}
