//! Triangle meshes with exact signed distance.
//!
//! d(p) = +-|p - q|, q the nearest point of the surface, negative where (p - q) . N(q) <= 0 with N
//! the pseudo-normal of the face, edge or corner that q is on (J. Baerentzen & H. Aanaes, IEEE TVCG
//! 11, 2005). grad d = n = (p - q) / d. Second derivative: 0 over a face, b b^T / d over an edge (b
//! across edge and n), (I - n n^T) / d at a corner. Volume: sum of a . (b x c) / 6 over the
//! triangles (Gauss).

use crate::MeshError;
use crate::grid::Grid;
use crate::mesh_file;
use crate::stl::{MAX_BYTES, MAX_TRIANGLES, Stl};
use nalgebra::{Matrix3, Vector3};
use parry3d_f64::math::Vector as Place;
use parry3d_f64::query::{PointProjection, PointQueryWithLocation, Ray, RayCast};
use parry3d_f64::shape::{TriMesh, TriMeshFlags, TrianglePointLocation};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use wcal_core::files::{FileError, read_within};
use wcal_core::provenance::sha256_hex;

/// Sizes (longest side of the box) that an object for a 60 mm whisker may have, mm.
const SIZE_MM: [f64; 2] = [3.0, 2000.0];
/// Longest side of several bodies together, mm.
const APART_MM: f64 = 10_000.0;
/// Way from a known place below which the grid would tell no more, mm.
const CLOSE_MM: f64 = 0.7;
/// Depth up to which a point inside is found, mm.
const DEEP_MM: f64 = 30.0;
/// Below this distance (mm) the direction to the surface is rounding: the face's own normal is
/// taken.
const ON_SURFACE_MM: f64 = 1e-9;

/// What a surface tells of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestPoint {
    /// Signed distance, mm: negative inside.
    pub distance_mm: f64,
    /// Its gradient: away from the surface.
    pub normal: Vector3<f64>,
    /// Nearest point of the surface, mm.
    pub point_mm: Vector3<f64>,
    /// Second derivative of the distance, 1/mm.
    pub second_per_mm: Matrix3<f64>,
}

/// An object's surface.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Name of the object.
    pub name: String,
    /// Corners of its box, mm.
    pub low_mm: Vector3<f64>,
    /// See `low_mm`.
    pub high_mm: Vector3<f64>,
    /// What is remarkable, in words: open edges, another unit.
    pub notes: Vec<String>,
    surface: TriMesh,
    /// Its closed bodies one by one, where there are several: where they overlap, the nearest face
    /// may be one that lies within another.
    bodies: Vec<TriMesh>,
    grid: Grid,
}

impl Mesh {
    /// From corners (mm) and triangles; normals of a closed surface that point inward are turned
    /// round.
    ///
    /// # Errors
    /// Where there is nothing, too much, a value that is not finite, or an object of impossible
    /// size.
    pub fn new(
        name: &str,
        points_mm: &[Vector3<f64>],
        triangles: &[[u32; 3]],
    ) -> Result<Self, MeshError> {
        let refuse = |expected, found: String| MeshError::Mesh {
            object: name.to_owned(),
            expected,
            found,
        };
        if triangles.is_empty() || triangles.len() > MAX_TRIANGLES {
            return Err(refuse(
                "1 to 1,000,000 triangles",
                format!("{}", triangles.len()),
            ));
        }
        if triangles
            .iter()
            .flatten()
            .any(|&k| k as usize >= points_mm.len())
        {
            return Err(refuse(
                "triangles between known corners",
                "a corner that is not there".to_owned(),
            ));
        }
        if points_mm.iter().any(|p| p.iter().any(|x| !x.is_finite())) {
            return Err(refuse("finite corners", "NaN or infinity".to_owned()));
        }
        let (points, mut triangles) = merged(points_mm, triangles);
        if triangles.is_empty() {
            return Err(refuse("triangles with an area", "none".to_owned()));
        }
        let [low_mm, high_mm] = bounds(points.iter().copied());
        let size_mm = (high_mm - low_mm).max();
        if !(SIZE_MM[0]..=SIZE_MM[1]).contains(&size_mm) {
            // Bodies far apart, as the solids of one file may lie, are of the right unit where the
            // largest is.
            let size_of = |piece: &Vec<[u32; 3]>| {
                let [low, high] = bounds(piece.iter().flatten().map(|k| points[*k as usize]));
                (high - low).max()
            };
            let largest_mm = pieces(points.len(), &triangles)
                .iter()
                .map(size_of)
                .fold(0.0, f64::max);
            if !(size_mm <= APART_MM && (SIZE_MM[0]..=SIZE_MM[1]).contains(&largest_mm)) {
                return Err(refuse(
                    "a longest side of 3 to 2000 mm",
                    format!("{size_mm:.4} mm"),
                ));
            }
        }
        // Only a closed and oriented surface has a volume, whose sign tells outside from inside.
        let mut notes = topology(&triangles);
        if notes.is_empty() && volume_mm3(&points, &triangles) < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
            notes.push("normals pointed inward: turned round".to_owned());
        }
        let places: Vec<Place> = points.iter().map(|p| Place::new(p.x, p.y, p.z)).collect();
        // Oriented meshes have the pseudo-normals that show whether a point is inside.
        let searchable = |triangles: Vec<[u32; 3]>| {
            TriMesh::with_flags(places.clone(), triangles, TriMeshFlags::ORIENTED)
                .map_err(|e| refuse("a mesh that can be searched", e.to_string()))
        };
        let pieces = if notes.is_empty() {
            pieces(points.len(), &triangles)
        } else {
            Vec::new()
        };
        let mut bodies = Vec::new();
        if pieces.len() > 1 {
            // A piece turned inside out is a cavity.
            let solid = pieces
                .iter()
                .filter(|piece| volume_mm3(&points, piece) > 0.0)
                .count();
            if solid == pieces.len() {
                bodies = pieces
                    .into_iter()
                    .map(searchable)
                    .collect::<Result<_, _>>()?;
            } else if solid > 1 {
                notes.push(format!(
                    "{solid} closed bodies and {} cavities: where they overlap, inside and outside may be mistaken",
                    pieces.len() - solid
                ));
            }
        }
        let surface = searchable(triangles)?;
        let grid = Grid::new(&low_mm, &high_mm);
        Ok(Self {
            name: name.to_owned(),
            low_mm,
            high_mm,
            notes,
            surface,
            bodies,
            grid,
        })
    }

    /// From a file of STL, OBJ or PLY. Metres taken for millimetres are recognised by the size and
    /// said in `notes`.
    ///
    /// # Errors
    /// As [`Self::new`], or where the file cannot be read.
    pub fn read(path: &Path) -> Result<Self, MeshError> {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        let bytes = read_within(path, MAX_BYTES)?;
        let Stl {
            points,
            triangles,
            notes,
            ..
        } = mesh_file::parse(&bytes).map_err(|found| FileError::invalid(path, found))?;
        let mut points: Vec<Vector3<f64>> = points
            .iter()
            .map(|v| Vector3::from(v.map(f64::from)))
            .collect();
        let [low, high] = bounds(points.iter().copied());
        let size = (high - low).max();
        // Nothing that a whisker of 60 mm sweeps over is smaller than 3 mm; in metres everything
        // is.
        let metres =
            size.is_finite() && size > 0.0 && size < SIZE_MM[0] && size * 1e3 >= SIZE_MM[0];
        if metres {
            points.iter_mut().for_each(|p| *p *= 1e3);
        }
        let mut mesh = Self::new(&name, &points, &triangles).map_err(|mut e| {
            if let MeshError::Mesh { object, .. } = &mut e {
                *object = path.display().to_string();
            }
            e
        })?;
        mesh.notes.extend(notes);
        if metres {
            let note = format!(
                "expected millimetres, found an object of {size:.4} mm: taken as metres, {:.1} mm",
                1e3 * size
            );
            mesh.notes.push(note);
        }
        Ok(mesh)
    }

    /// Corners, mm.
    pub fn points(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        self.surface.vertices().iter().map(|v| vector(*v))
    }

    /// Triangles.
    pub fn triangles(&self) -> &[[u32; 3]] {
        self.surface.indices()
    }

    /// SHA-256 of corners and triangles.
    pub fn sha256(&self) -> String {
        let mut bytes = Vec::new();
        self.points()
            .for_each(|p| p.iter().for_each(|x| bytes.extend(x.to_le_bytes())));
        self.triangles()
            .iter()
            .flatten()
            .for_each(|k| bytes.extend(k.to_le_bytes()));
        sha256_hex(&bytes)
    }

    /// Whether a ray meets the surface.
    pub(crate) fn meets(&self, from: &Vector3<f64>, direction: &Vector3<f64>) -> bool {
        self.surface
            .intersects_local_ray(&Ray::new(place(from), place(direction)), f64::MAX)
    }

    /// Distance wherever the point is.
    fn signed_distance_mm(&self, p: &Vector3<f64>) -> Option<f64> {
        let (found, _, _) = self.nearest(p, f64::MAX)?;
        let size = (p - vector(found.point)).norm();
        Some(if found.is_inside { -size } else { size })
    }

    /// Nearest place of the surface, or of the body in which the point is deepest, with the mesh
    /// that it is on.
    fn nearest(
        &self,
        p: &Vector3<f64>,
        search_mm: f64,
    ) -> Option<(PointProjection, (u32, TrianglePointLocation), &TriMesh)> {
        let nearest = |mesh: &TriMesh, search_mm| {
            mesh.project_local_point_and_get_location_with_max_dist(place(p), false, search_mm)
        };
        let (found, at) = nearest(&self.surface, search_mm)?;
        if found.is_inside || self.bodies.is_empty() {
            return Some((found, at, &self.surface));
        }
        // Bodies that overlap are one: the greatest of their depths is the nearest bound of the
        // union's.
        let deep = |(found, ..): &(PointProjection, _, _)| (p - vector(found.point)).norm();
        let around = self
            .bodies
            .iter()
            .filter(|body| body.local_aabb().contains_local_point(place(p)));
        let inside = around
            .filter_map(|body| nearest(body, f64::MAX).map(|(found, at)| (found, at, body)))
            .filter(|(found, ..)| found.is_inside);
        inside
            .max_by(|a, b| deep(a).total_cmp(&deep(b)))
            .or(Some((found, at, &self.surface)))
    }

    /// The surface near a point: exact distance, negative inside (of a closed mesh).
    pub fn closest_point(&self, p: &Vector3<f64>, within_mm: f64) -> Option<ClosestPoint> {
        self.closest_point_from(p, within_mm, None)
    }

    /// The same where a signed distance is known, and how far away from there `p` lies, mm.
    pub fn closest_point_from(
        &self,
        p: &Vector3<f64>,
        within_mm: f64,
        known: Option<[f64; 2]>,
    ) -> Option<ClosestPoint> {
        let [known_mm, way_mm] = known.unwrap_or([0.0, f64::INFINITY]);
        // A distance changes by no more than the way from the known place (1-Lipschitz).
        if known_mm - way_mm > within_mm {
            return None;
        }
        // Most questions are asked far away.
        // Distance from the box: a lower bound of that from the surface.
        let outside = (self.low_mm - p)
            .sup(&(p - self.high_mm))
            .sup(&Vector3::zeros());
        if outside.norm() > within_mm {
            return None;
        }
        // Deep inside, the surface is farther than asked for and still matters.
        let mut search_mm = within_mm.max(DEEP_MM).min(known_mm.abs() + way_mm);
        // From close by no cell knows more.
        if way_mm > CLOSE_MM
            && let Some([least, most]) = self
                .grid
                .bounds_mm(p, |middle| self.signed_distance_mm(middle))
        {
            if least > within_mm {
                return None;
            }
            search_mm = search_mm.min(most);
        }
        let (found, (triangle, feature), surface) = self.nearest(p, search_mm)?;
        let point_mm = vector(found.point);
        let off = p - point_mm;
        let size = off.norm();
        let distance_mm = if found.is_inside { -size } else { size };
        if distance_mm > within_mm {
            return None;
        }
        if size < ON_SURFACE_MM {
            let normal = surface
                .triangle(triangle)
                .normal()
                .map_or_else(Vector3::x, vector);
            return Some(ClosestPoint {
                distance_mm,
                normal,
                point_mm,
                second_per_mm: Matrix3::zeros(),
            });
        }
        // The gradient of a distance has length one.
        let normal = off / distance_mm;
        // Distance from a plane is linear; from an edge or a corner it bends with the inverse of
        // itself.
        let across = match feature {
            TrianglePointLocation::OnFace(..) | TrianglePointLocation::OnSolid => Matrix3::zeros(),
            TrianglePointLocation::OnVertex(_) => Matrix3::identity() - normal * normal.transpose(),
            TrianglePointLocation::OnEdge(k, _) => {
                let corners = surface.triangle(triangle).vertices().map(vector);
                let edge = (corners[(k as usize + 1) % 3] - corners[k as usize]).normalize();
                let side = edge.cross(&normal);
                side * side.transpose()
            }
        };
        Some(ClosestPoint {
            distance_mm,
            normal,
            point_mm,
            second_per_mm: across / distance_mm,
        })
    }
}

fn place(p: &Vector3<f64>) -> Place {
    Place::new(p.x, p.y, p.z)
}

fn vector(p: Place) -> Vector3<f64> {
    Vector3::new(p.x, p.y, p.z)
}

/// Equal corners made one; triangles without area left out.
fn merged(points: &[Vector3<f64>], triangles: &[[u32; 3]]) -> (Vec<Vector3<f64>>, Vec<[u32; 3]>) {
    let mut known: HashMap<[u64; 3], u32> = HashMap::new();
    let mut kept = Vec::new();
    let place: Vec<u32> = points
        .iter()
        .map(|p| {
            // Adding zero makes -0 the same as 0.
            *known
                .entry([0, 1, 2].map(|k| (p[k] + 0.0).to_bits()))
                .or_insert_with(|| {
                    kept.push(*p);
                    (kept.len() - 1) as u32
                })
        })
        .collect();
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|k| kept[k as usize]);
        (b - a).cross(&(c - a)).norm()
    };
    let triangles: Vec<[u32; 3]> = triangles
        .iter()
        .map(|t| t.map(|k| place[k as usize]))
        .filter(|t| area(t) > 0.0)
        .collect();
    (kept, triangles)
}

/// Corners of the box around some points.
fn bounds(points: impl Iterator<Item = Vector3<f64>>) -> [Vector3<f64>; 2] {
    let none = [f64::INFINITY, f64::NEG_INFINITY].map(Vector3::repeat);
    points.fold(none, |[low, high], p| [low.inf(&p), high.sup(&p)])
}

/// Triangles that hang together by their corners.
fn pieces(points: usize, triangles: &[[u32; 3]]) -> Vec<Vec<[u32; 3]>> {
    // Each corner's way to the one that stands for its piece.
    let mut parent: Vec<u32> = (0..points as u32).collect();
    // Union-find with path halving (R. Tarjan, J. van Leeuwen, J. ACM 31 (1984) 245).
    fn root(parent: &mut [u32], mut k: u32) -> u32 {
        while parent[k as usize] != k {
            parent[k as usize] = parent[parent[k as usize] as usize];
            k = parent[k as usize];
        }
        k
    }
    for t in triangles {
        let a = root(&mut parent, t[0]);
        for k in &t[1..] {
            let b = root(&mut parent, *k);
            parent[b as usize] = a;
        }
    }
    let mut pieces: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for t in triangles {
        pieces.entry(root(&mut parent, t[0])).or_default().push(*t);
    }
    pieces.into_values().collect()
}

/// Volume that a closed surface encloses, mm^3; negative where its normals point inward.
fn volume_mm3(points: &[Vector3<f64>], triangles: &[[u32; 3]]) -> f64 {
    let of = |t: &[u32; 3]| {
        // Signed tetrahedra with the origin: what lies outside of the surface cancels.
        let [a, b, c] = t.map(|k| points[k as usize]);
        a.dot(&b.cross(&c)) / 6.0
    };
    triangles.iter().map(of).sum()
}

/// Open and crowded edges and triangles that disagree on the outside, in words.
fn topology(triangles: &[[u32; 3]]) -> Vec<String> {
    // Triangles that run along an edge, and how many more of them up than down.
    let mut edges: HashMap<[u32; 2], (usize, i32)> = HashMap::new();
    for t in triangles {
        // Two triangles that agree on the outside run along their edge in opposite directions.
        for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            let (count, up) = edges.entry([a.min(b), a.max(b)]).or_default();
            *count += 1;
            *up += if a < b { 1 } else { -1 };
        }
    }
    let open = edges.values().filter(|(n, _)| *n == 1).count();
    let crowded = edges.values().filter(|(n, _)| *n > 2).count();
    let turned = edges.values().filter(|(n, up)| *n == 2 && *up != 0).count();
    let mut notes = Vec::new();
    if open > 0 {
        notes.push(format!("not watertight: {open} open edges"));
    }
    if crowded > 0 {
        notes.push(format!(
            "not a manifold: {crowded} edges of more than two triangles"
        ));
    }
    if turned > 0 {
        notes.push(format!(
            "not oriented: {turned} edges whose triangles disagree on the outside"
        ));
    }
    notes
}
