//! The touched surface out of tracks: a cloud of contacts with covariance, and a Gaussian process implicit surface through it.
//!
//! The process is the signed distance d(x) to the surface, prior mean `s0` (outside) and Matern 5/2 covariance:
//!
//! ```text
//! k(r) = s0^2 (1 + u + u^2 / 3) exp(-u),  u = sqrt(5) r / l
//! observations at p_i + h n_i, h in {0, +o, -o}:  d = h,  variance n_i^T C_i n_i + s_min^2 (+ s_o^2 for h != 0)
//! d(x) = s0 + k(x)^T K^-1 (y - s0),   sd(x)^2 = s0^2 - |L^-1 k(x)|^2,   K = L L^T
//! ```
//!
//! Each contact counts with its variance along its normal. The mesh of d = 0 is cut where nothing was touched nearby. Sources: O. Williams,
//! A. Fitzgibbon, "Gaussian Process Implicit Surfaces", 2006; C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning",
//! 2006, algorithm 2.1.

mod mesh;

pub use mesh::SurfaceMesh;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use wcal_map::{ConditionedProcess, Kernel};

/// A contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudPoint {
    /// Place, mm, in any one frame.
    pub point_mm: Vector3<f64>,
    /// Covariance, mm^2.
    pub covariance_mm2: Matrix3<f64>,
    /// Outward normal of the object: the direction of the force on the wire.
    pub normal: Vector3<f64>,
}

/// How the surface is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceSettings {
    /// Contacts whose largest standard deviation is above this are left out, mm.
    pub max_sd_mm: f64,
    /// One contact is kept in each cube of this size, mm: the one known best.
    pub thinning_mm: f64,
    /// Largest number of contacts.
    pub max_contacts: usize,
    /// Correlation length of the surface, mm.
    pub length_mm: f64,
    /// Distance in front of a contact and behind it at which the process is given its value, mm.
    pub offset_mm: f64,
    /// Size of the mesh's cells, mm, and its extent around a contact, mm.
    pub cell_mm: f64,
    /// See `cell_mm`.
    pub reach_mm: f64,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self {
            max_sd_mm: 2.0,
            thinning_mm: 1.0,
            max_contacts: 300,
            length_mm: 20.0,
            offset_mm: 2.0,
            cell_mm: 1.0,
            reach_mm: 3.0,
        }
    }
}

/// Standard deviation that every contact has at least, mm.
const MIN_SD_MM: f64 = 0.05;
/// Standard deviation of the value at an offset point, mm: the normal is uncertain and the surface curved.
const OFFSET_SD_MM: f64 = 0.3;
/// Standard deviation of the signed distance where nothing is known, mm.
const PRIOR_SD_MM: f64 = 20.0;

/// The signed distance to a surface, mm, positive outside.
#[derive(Debug, Clone)]
pub struct ImplicitSurface {
    settings: SurfaceSettings,
    contacts: Vec<CloudPoint>,
    places: Vec<Vector3<f64>>,
    process: ConditionedProcess,
}

impl ImplicitSurface {
    /// Through contacts; none without a usable one.
    #[must_use]
    pub fn new(cloud: &[CloudPoint], settings: SurfaceSettings) -> Option<Self> {
        let contacts = thin_out(cloud, &settings);
        let constraints =
            [(0.0, 0.0), (settings.offset_mm, OFFSET_SD_MM), (-settings.offset_mm, OFFSET_SD_MM)];
        let mut places = Vec::new();
        let (mut values, mut variances) = (Vec::new(), Vec::new());
        // Three constraints a contact: d = 0 on the surface and d = h on both sides, as zeros alone do not determine inside and outside.
        for c in &contacts {
            for (off_mm, sd_mm) in constraints {
                places.push(c.point_mm + c.normal * off_mm);
                values.push(off_mm - PRIOR_SD_MM);
                let along = c.normal.dot(&(c.covariance_mm2 * c.normal));
                variances.push(along + MIN_SD_MM.powi(2) + f64::powi(sd_mm, 2));
            }
        }
        let n = places.len();
        if n == 0 {
            return None;
        }
        let gram = DMatrix::from_fn(n, n, |i, j| {
            let noise = if i == j { variances[i] } else { 0.0 };
            kernel(&settings, (places[i] - places[j]).norm()) + noise
        });
        let process = ConditionedProcess::new(gram, DVector::from_vec(values)).ok()?;
        Some(Self { settings, contacts, places, process })
    }

    /// Contacts that constrain it.
    #[must_use]
    pub fn contacts(&self) -> &[CloudPoint] {
        &self.contacts
    }

    /// Signed distance at a place, mm. Far from all contacts it is outside.
    #[must_use]
    pub fn at(&self, place_mm: &Vector3<f64>) -> f64 {
        PRIOR_SD_MM + self.process.mean(self.covariances(place_mm))
    }

    /// Standard deviation of the signed distance at a place, mm.
    #[must_use]
    pub fn sd_mm(&self, place_mm: &Vector3<f64>) -> f64 {
        let k = DVector::from_iterator(self.places.len(), self.covariances(place_mm));
        (PRIOR_SD_MM.powi(2) - self.process.explained(k)).max(0.0).sqrt()
    }

    /// Covariances of the signed distance at a place with those at the constraints, mm^2.
    fn covariances(&self, place_mm: &Vector3<f64>) -> impl Iterator<Item = f64> {
        self.places.iter().map(move |p| kernel(&self.settings, (place_mm - p).norm()))
    }

    /// Its mesh near the contacts, with a standard deviation at every corner.
    #[must_use]
    pub fn mesh(&self) -> SurfaceMesh {
        mesh::mesh(self, &self.settings)
    }
}

fn kernel(settings: &SurfaceSettings, distance_mm: f64) -> f64 {
    PRIOR_SD_MM.powi(2) * Kernel::Matern52 { length: settings.length_mm }.at(distance_mm)
}

fn sd_mm(c: &CloudPoint) -> f64 {
    c.covariance_mm2.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// The best known contact of every small cube, the best of them where there are too many.
fn thin_out(cloud: &[CloudPoint], settings: &SurfaceSettings) -> Vec<CloudPoint> {
    let mut best: BTreeMap<[i64; 3], (f64, CloudPoint)> = BTreeMap::new();
    for c in cloud {
        let finite =
            [c.point_mm, c.normal].iter().flatten().chain(&c.covariance_mm2).all(|x: &f64| x.is_finite());
        let Some(normal) = c.normal.try_normalize(0.1).filter(|_| finite) else { continue };
        let sd = sd_mm(c);
        if sd > settings.max_sd_mm {
            continue;
        }
        let cube = [0, 1, 2].map(|k| (c.point_mm[k] / settings.thinning_mm).floor() as i64);
        let kept = best.entry(cube).or_insert((f64::INFINITY, *c));
        if sd < kept.0 {
            *kept = (sd, CloudPoint { normal, ..*c });
        }
    }
    let mut all: Vec<(f64, CloudPoint)> = best.into_values().collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.truncate(settings.max_contacts);
    all.into_iter().map(|(_, c)| c).collect()
}

/// The cloud as a PLY file: places, normals and covariances, in mm.
#[must_use]
pub fn cloud_ply(cloud: &[CloudPoint], frame: &str) -> String {
    let names = ["x", "y", "z", "nx", "ny", "nz", "cov_xx", "cov_yy", "cov_zz", "cov_xy", "cov_xz", "cov_yz"];
    let mut out = format!(
        "ply\nformat ascii 1.0\ncomment contacts, mm, frame: {frame}; covariance in mm^2\nelement vertex {}\n",
        cloud.len()
    );
    names.iter().for_each(|n| out += &format!("property double {n}\n"));
    out += "end_header\n";
    for c in cloud {
        let v = &c.covariance_mm2;
        let spread = [v[(0, 0)], v[(1, 1)], v[(2, 2)], v[(0, 1)], v[(0, 2)], v[(1, 2)]];
        let all = c.point_mm.iter().chain(c.normal.iter()).chain(&spread);
        let line: Vec<String> = all.map(|x| format!("{x:.5}")).collect();
        let _ = writeln!(out, "{}", line.join(" "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    const RADIUS_MM: f64 = 25.0;

    /// Contacts on a cap of a ball, off along the normal by `off_mm`.
    fn cap(sd_mm: f64, off_mm: f64) -> Vec<CloudPoint> {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        (0..120)
            .map(|_| {
                let way = Vector3::new(normal() * 0.2, normal() * 0.2, 1.0).normalize();
                let scatter = Vector3::new(normal(), normal(), normal()) * sd_mm;
                CloudPoint {
                    point_mm: way * (RADIUS_MM + off_mm) + scatter,
                    covariance_mm2: Matrix3::identity() * sd_mm * sd_mm,
                    normal: way,
                }
            })
            .collect()
    }

    fn rmse_mm(mesh: &SurfaceMesh) -> f64 {
        let n = mesh.corners_mm.len().max(1) as f64;
        (mesh.corners_mm.iter().map(|p| (p.norm() - RADIUS_MM).powi(2)).sum::<f64>() / n).sqrt()
    }

    #[test]
    fn a_ball_comes_back_from_noisy_contacts_and_a_shifted_one_does_not() {
        let surface = ImplicitSurface::new(&cap(0.2, 0.0), SurfaceSettings::default()).unwrap();
        let mesh = surface.mesh();
        assert!(mesh.triangles.len() > 500, "{}", mesh.triangles.len());
        assert!(rmse_mm(&mesh) < 0.25, "{}", rmse_mm(&mesh));
        // Triangles face outward.
        let outward = mesh.triangles.iter().filter(|t| {
            let [a, b, c] = t.map(|k| mesh.corners_mm[k]);
            (b - a).cross(&(c - a)).dot(&a) >= 0.0
        });
        assert!(outward.count() as f64 > 0.99 * mesh.triangles.len() as f64);
        // What it states is what it does, about; far away it knows nothing.
        let stated = (mesh.sd_mm.iter().map(|s| s * s).sum::<f64>() / mesh.sd_mm.len() as f64).sqrt();
        assert!((0.2..3.0).contains(&(rmse_mm(&mesh) / stated)), "{} {stated}", rmse_mm(&mesh));
        assert!(surface.sd_mm(&Vector3::new(0.0, 0.0, -60.0)) > 0.9 * PRIOR_SD_MM);
        // Negative control: contacts a millimetre off make a surface a millimetre off.
        let shifted = ImplicitSurface::new(&cap(0.2, 1.0), SurfaceSettings::default()).unwrap().mesh();
        assert!(rmse_mm(&shifted) > 0.8, "{}", rmse_mm(&shifted));
    }

    #[test]
    fn what_is_not_known_makes_no_surface() {
        let settings = SurfaceSettings::default();
        assert!(ImplicitSurface::new(&[], settings).is_none());
        assert!(ImplicitSurface::new(&cap(5.0, 0.0), settings).is_none(), "too uncertain");
        let ply = cloud_ply(&cap(0.1, 0.0)[..2], "world");
        assert!(ply.contains("element vertex 2\n") && ply.lines().count() == 19, "{ply}");
    }
}
