//! An object as convex parts for MuJoCo: decomposed by CoACD, kept by the mesh's hash, with how far
//! the parts are from the mesh.
//!
//! Hausdorff distance max(sup_(p in parts) d(p, mesh), sup_(p in mesh) min_k d(p, part_k)), taken
//! at points u a + v b + w c of every triangle; inside counts as 0 or less. Source: X. Wei et al.,
//! "Approximate convex decomposition for 3D meshes with collision-aware concavity and tree search",
//! ACM TOG 41 (2022).

use nalgebra::Vector3;
use parry3d_f64::math::Vector as Place;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wcal_core::files::{FileError, write_atomic};
use wcal_core::provenance::sha256_hex;
use wcal_mesh::{Mesh, MeshError};
use wcal_mujoco::engine::protocol::Decompose;
use wcal_mujoco::{MujocoEngine, TwinError};

/// CoACD's largest concavity (share of the size), most parts and seed.
const THRESHOLD: f64 = 0.03;
const MAX_PARTS: i32 = 64;
const SEED: u32 = 1;
/// Points on an edge of a triangle at which the distance is taken.
const PER_EDGE: usize = 5;

/// An object's convex parts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Convex {
    /// SHA-256 of mesh and settings.
    pub made_from: String,
    /// Corners of each part, mm, object frame.
    pub parts: Vec<Vec<[f64; 3]>>,
    /// Largest distance from the parts' surface to the mesh, mm: what the parts add.
    pub beyond_mm: f64,
    /// Largest distance from the mesh to the nearest part, mm: what they leave out.
    pub short_mm: f64,
}

impl Convex {
    /// Both ways, mm.
    pub fn hausdorff_mm(&self) -> f64 {
        self.beyond_mm.max(self.short_mm)
    }

    /// From the folder, or made and put there.
    ///
    /// # Errors
    /// Where the engine or CoACD is missing, or the folder cannot be written.
    pub fn of(mesh: &Mesh, folder: &Path) -> Result<Self, TwinError> {
        let (request, made_from) = request(mesh)?;
        if let Some(there) = Self::kept(mesh, folder)? {
            return Ok(there);
        }
        let parts = MujocoEngine::start()?.convex_parts(&request)?;
        let (beyond_mm, short_mm) = distances(mesh, &parts)?;
        let path = file(mesh, folder, &made_from);
        let made = Self {
            made_from,
            parts,
            beyond_mm,
            short_mm,
        };
        std::fs::create_dir_all(folder)
            .map_err(FileError::of("creating", folder))
            .map_err(MeshError::from)?;
        let text = serde_json::to_string(&made).map_err(|e| TwinError::Engine(e.to_string()))?;
        write_atomic(&path, text.as_bytes()).map_err(MeshError::from)?;
        Ok(made)
    }

    /// From the folder; none where they are not there, or of another making.
    ///
    /// # Errors
    /// Where the mesh cannot be written as a request.
    pub fn kept(mesh: &Mesh, folder: &Path) -> Result<Option<Self>, TwinError> {
        let (_, made_from) = request(mesh)?;
        let text = wcal_core::files::read_text(file(mesh, folder, &made_from)).ok();
        let there = text.and_then(|t| serde_json::from_str::<Self>(&t).ok());
        Ok(there.filter(|c| c.made_from == made_from))
    }

    /// Corners as vectors, mm.
    pub fn corners(&self) -> Vec<Vec<Vector3<f64>>> {
        self.parts
            .iter()
            .map(|part| part.iter().map(|p| Vector3::from(*p)).collect())
            .collect()
    }
}

/// What CoACD is asked for, and its hash.
fn request(mesh: &Mesh) -> Result<(Decompose, String), TwinError> {
    let points: Vec<[f64; 3]> = mesh.points().map(Into::into).collect();
    let triangles: Vec<[i32; 3]> = mesh
        .triangles()
        .iter()
        .map(|t| t.map(|k| k as i32))
        .collect();
    let request = Decompose {
        points,
        triangles,
        threshold: THRESHOLD,
        most_parts: MAX_PARTS,
        seed: SEED,
    };
    let text = serde_json::to_string(&request).map_err(|e| TwinError::Engine(e.to_string()))?;
    let made_from = sha256_hex(text.as_bytes());
    Ok((request, made_from))
}

fn file(mesh: &Mesh, folder: &Path, made_from: &str) -> PathBuf {
    folder.join(format!("{}-{}.json", mesh.name, &made_from[..16]))
}

/// Largest distances parts to mesh and mesh to parts, mm, at points on every triangle.
fn distances(mesh: &Mesh, parts: &[Vec<[f64; 3]>]) -> Result<(f64, f64), TwinError> {
    let hulls: Vec<TriMesh> = parts
        .iter()
        .map(|part| hull(&mesh.name, part))
        .collect::<Result<_, _>>()?;
    // Distance from a part, negative inside.
    let from = |hull: &TriMesh, p: &Vector3<f64>| {
        let place = Place::new(p.x, p.y, p.z);
        let found = hull.project_local_point(place, false);
        let away = (found.point - place).length();
        if found.is_inside { -away } else { away }
    };
    let mut beyond_mm: f64 = 0.0;
    for hull in &hulls {
        for p in on_triangles(
            hull.vertices()
                .iter()
                .map(|v| Vector3::new(v.x, v.y, v.z))
                .collect(),
            hull.indices(),
        ) {
            // Only what sticks out: faces between parts lie inside.
            beyond_mm = mesh
                .closest_point(&p, f64::MAX)
                .map_or(beyond_mm, |near| beyond_mm.max(near.distance_mm));
        }
    }
    let mut short_mm: f64 = 0.0;
    for p in on_triangles(mesh.points().collect(), mesh.triangles()) {
        let nearest = hulls
            .iter()
            .map(|h| from(h, &p))
            .fold(f64::INFINITY, f64::min);
        short_mm = short_mm.max(nearest);
    }
    Ok((beyond_mm, short_mm))
}

fn hull(name: &str, part: &[[f64; 3]]) -> Result<TriMesh, TwinError> {
    let refuse = |found: String| {
        let (object, expected) = (name.to_owned(), "convex parts with a volume");
        TwinError::Sim(MeshError::Mesh {
            object,
            expected,
            found,
        })
    };
    let places: Vec<Place> = part.iter().map(|p| Place::new(p[0], p[1], p[2])).collect();
    let (points, triangles) =
        parry3d_f64::transformation::try_convex_hull(&places).map_err(|e| refuse(e.to_string()))?;
    TriMesh::with_flags(points, triangles, TriMeshFlags::ORIENTED)
        .map_err(|e| refuse(e.to_string()))
}

/// Points spread over every triangle, corners included.
fn on_triangles(
    points: Vec<Vector3<f64>>,
    triangles: &[[u32; 3]],
) -> impl Iterator<Item = Vector3<f64>> + '_ {
    triangles.iter().flat_map(move |t| {
        let [a, b, c] = t.map(|k| points[k as usize]);
        (0..PER_EDGE).flat_map(move |i| {
            (0..PER_EDGE - i).map(move |j| {
                let [u, v] = [i, j].map(|n| n as f64 / (PER_EDGE - 1) as f64);
                a + (b - a) * u + (c - a) * v
            })
        })
    })
}
