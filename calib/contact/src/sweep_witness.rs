//! A sweep over an object that is known judges the explanations of a calibration session.
//!
//! The moments m of a reading allow a contact anywhere on the curve p(s; m), with a force along n(s; m) (`StaticInverse`). The object allows it
//! where its surface is, d(p) = 0, along the outward normal nu within the cone of friction. The gap of a reading is the distance where the curve
//! comes nearest to both:
//!
//! ```text
//! d_k = d(p(s*; m_k)),    s* = argmin_s  d(p)^2 + (L max(0, angle(n, nu) - atan mu))^2
//! ```
//!
//! What is not known of calibration, zero and the object's place moves all gaps together:
//!
//! ```text
//! d_k = g_k' ((h_k - h_0) c + z + e(m_k)) + nu_k' x + f_k,   g = dd/dm,   c ~ N(0, 1),   z ~ N(0, Z),   x ~ N(0, s_o^2 1),   f ~ N(0, s_f^2)
//! e ~ GP(0, R exp(-|m - m'|^2 / 2 l^2))        misfit of the calibration: alike for like moments, l the spacing of its poses
//! T = sum_j (u_j' d)^2 / l_j ~ chi^2(q)        l_j, u_j: eigenvalues and vectors of the covariance of d; q of them exceed 2 s_f^2
//! ```
//!
//! s_f bounds what friction and the mesh do and is no measured noise: directions in which it rules say nothing. h_0 is the common error at the
//! sweep's own zero (the readings before the free wire comes near the object), which takes it away. Readings count from first load to the
//! largest one: the contact is that of first touch there. A wire that slips while the load falls may lie on elsewhere, or at two places.

use crate::ContactError;
use crate::sweep_record::{SweepRow, SweepZero, sweep_rows};
use crate::sweep_session::SweepSession;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix2, Vector2, Vector3};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::sync::OnceLock;
use wcal_calibration::WhiskerCalibration;
use wcal_core::WireFrame;
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_core::order_statistics::median;
use wcal_core::verify_document::WitnessTest;
use wcal_rod::Shape;
use wcal_sim::Mesh;
use wcal_trace::MeasurementModel;
use wcal_trace::TraceError;
use wcal_trace::levels::WITNESSES;
use wcal_trace::method::hypothesis::Hypothesis;
use wcal_trace::verify::Witness;
use wcal_trace::whisker::{PhysicalModel, WhiskerSystem};
use wcal_track::{InverseGrid, InverseSolution, StaticInverse};

/// Largest friction of a wire on an object.
const FRICTION: f64 = 0.3;
/// What an angle outside the cone of friction counts, mm/rad: the wire's lever of some centimetres, with a margin.
const LEVER_MM_PER_RAD: f64 = 12.0;
/// The free wire is clear of the object from this distance on, mm, beside three standard deviations of the object's place.
const CLEAR_MM: f64 = 0.5;
/// Readings that judge at most: denser ones say the same again.
const MAX_SAMPLES: usize = 60;
/// A reading is loaded beyond this many standard deviations of the free ones, or this share of the largest moment.
const LOADED_SD: f64 = 5.0;
const LOADED_SHARE: f64 = 0.02;
/// Surfaces farther away than this are not looked for, mm.
const REACH_MM: f64 = 50.0;
/// The table of the wire reaches this multiple of the largest moment: a trial may take the moments for larger.
const TABLE_REACH: f64 = 1.6;
/// Step of the moments for gradients, N mm.
const STEP_NMM: f64 = 0.02;
/// What friction, the mesh and the model of one contact leave of a gap, mm.
const CONTACT_SD_MM: f64 = 0.3;

/// A sweep over a known object, ready to judge.
pub struct SweepWitness {
    /// Identifier of the sweep.
    pub id: String,
    session: SweepSession,
    mesh: Mesh,
    world_from_object: Isometry3<f64>,
    frame: WireFrame,
    whisker: WhiskerSpec,
    /// Loaded poses of the calibration session: what spaces its moments.
    poses: usize,
    /// What the wire shows; made at the first verdict.
    inverse: OnceLock<(f64, StaticInverse)>,
}

/// A reading in contact: gap, its derivative by the moments, and the outward normal of the surface in the world.
struct Gap {
    d_mm: f64,
    by_moment: Vector2<f64>,
    normal: Vector3<f64>,
}

impl SweepWitness {
    /// Of a sweep with a whisker, its moment axes, and the number of loaded poses of its calibration session.
    ///
    /// # Errors
    /// Where the sweep has no object or does not say where it lies, or the wire cannot be used.
    pub fn new(
        session: SweepSession,
        (declared, axes): (&WhiskerSpec, &MomentAxes),
        poses: usize,
    ) -> Result<Self, ContactError> {
        let what = |key: &str| format!("{}: {key}", session.id);
        let Some(object) = &session.object else {
            return Err(ContactError::value(
                what("files.object"),
                "a mesh of the object",
                "none",
            ));
        };
        let Some(world_from_object) = session.world_from_object else {
            return Err(ContactError::value(
                what("object.world_from_object"),
                "the pose of the mesh",
                "none",
            ));
        };
        let frame = WireFrame::new(declared, axes)
            .map_err(|e| ContactError::value(e.key, e.expected, e.found))?;
        let whisker = frame.whisker(declared);
        let (id, mesh) = (session.id.clone(), Mesh::read(object)?.outside()?);
        let (poses, inverse) = (poses.max(1), OnceLock::new());
        Ok(Self {
            id,
            mesh,
            world_from_object,
            frame,
            whisker,
            poses,
            session,
            inverse,
        })
    }

    /// Whether the contacts that the moments of a calibration allow lie on the object; none where its uncertainty rules in no direction.
    ///
    /// # Errors
    /// Where the sweep's table cannot be read by it, starts in contact, or never touches.
    pub fn consistency_test(
        &self,
        calibration: &dyn WhiskerCalibration,
        declared: &WhiskerSpec,
    ) -> Result<Option<WitnessTest>, ContactError> {
        let rows = sweep_rows(&self.session, calibration, (declared, &self.frame))?;
        let place = || self.session.points.display().to_string();
        let (clear, clear_mm) = self.clear(&rows)?;
        // The sweep's own zero, and from when on the wire is loaded.
        let Some(zero) = SweepZero::new(&rows, &clear) else {
            let expected =
                format!("readings before the wire comes within {clear_mm:.1} mm of the object");
            let free = clear.iter().take_while(|c| **c).count();
            return Err(ContactError::value(
                place(),
                expected,
                format!("{free}: the sweep has no zero of its own"),
            ));
        };
        let largest = zero.largest_nmm;
        let loaded_nmm = (LOADED_SD * zero.variance_nmm2.sqrt()).max(LOADED_SHARE * largest);
        let load = |k: usize| (rows[k].moment_nmm - zero.moment_nmm).norm();
        // Up to the largest load; no reading is left where all are free.
        let after = (zero.free..rows.len()).max_by(|a, b| load(*a).total_cmp(&load(*b)));
        let (peak, end) = after.map_or((zero.free, zero.free), |peak| (peak, peak + 1));
        // A single loaded reading is an outlier.
        let loaded = |k: &usize| load(*k) > loaded_nmm && (*k == peak || load(*k + 1) > loaded_nmm);
        let touching: Vec<&SweepRow> = (zero.free..end).filter(loaded).map(|k| &rows[k]).collect();
        let every = touching.len().div_ceil(MAX_SAMPLES).max(1);
        let touching: Vec<&SweepRow> = touching.into_iter().step_by(every).collect();
        if touching.is_empty() {
            let found = format!("none beyond {loaded_nmm:.3} N mm: the wire touches nothing");
            return Err(ContactError::value(place(), "loaded readings", found));
        }
        // Where the object allows a contact with these moments, and how that moves with them.
        let inverse = self.inverse(largest)?;
        let moments: Vec<Vector2<f64>> = touching
            .iter()
            .map(|r| r.moment_nmm - zero.moment_nmm)
            .collect();
        let gaps: Vec<Gap> = touching
            .iter()
            .zip(&moments)
            .filter_map(|(r, m)| self.gap(inverse, m, &r.world_from_base))
            .collect();
        if gaps.len() < touching.len() {
            let found = format!("{} of {}", gaps.len(), touching.len());
            let expected =
                format!("an object within {REACH_MM} mm of the wire at every loaded reading");
            return Err(ContactError::value(place(), expected, found));
        }
        // A pose of the calibration stands for its share of the moments' range: within it the misfit is one.
        let spacing_nmm = largest / (self.poses as f64).sqrt();
        let zero_nmm2 = Matrix2::identity() * (zero.variance_nmm2 / zero.free as f64);
        // What all readings share is off the zero already.
        let off_zero = |r: &SweepRow| {
            zero.shared_nmm
                .iter()
                .zip(&r.shared_nmm)
                .map(|(z, h)| h - z)
                .collect()
        };
        let known: Vec<Vec<Vector2<f64>>> = touching.iter().map(|r| off_zero(r)).collect();
        let covariance =
            self.covariance(&touching, &moments, &gaps, &known, (zero_nmm2, spacing_nmm));
        let Some((statistic, dof, p)) = chi_squared(&gaps, covariance) else {
            return Ok(None);
        };
        let median_mm = median(gaps.iter().map(|g| g.d_mm.abs())).unwrap_or(f64::NAN);
        Ok(Some(WitnessTest {
            witness: "sweep".to_owned(),
            effects: Vec::new(),
            statistic,
            dof,
            p,
            refuted: p < WITNESSES,
            magnitude: median_mm,
            unit: "mm".to_owned(),
            sentence: format!(
                "The sweep {} refutes the accepted model: the contacts that its moments allow lie {median_mm:.2} mm from the object in the median \
                 of {} readings (p = {p:.1e}).",
                self.id,
                gaps.len()
            ),
        }))
    }

    /// The table of the wire, for moments up to the largest of the first verdict with a margin.
    fn inverse(&self, largest_nmm: f64) -> Result<&StaticInverse, ContactError> {
        if self
            .inverse
            .get()
            .is_none_or(|(max, _)| *max < largest_nmm + STEP_NMM)
        {
            let grid = InverseGrid::coarse();
            let max_nmm = grid.max_nmm.max(TABLE_REACH * largest_nmm + STEP_NMM);
            let made = StaticInverse::new(&self.whisker, InverseGrid { max_nmm, ..grid })?;
            let _ = self.inverse.set((max_nmm, made));
        }
        let (max, inverse) = self
            .inverse
            .get()
            .ok_or_else(|| self.beyond(largest_nmm, 0.0))?;
        if *max < largest_nmm {
            Err(self.beyond(largest_nmm, *max))
        } else {
            Ok(inverse)
        }
    }

    fn beyond(&self, largest_nmm: f64, max_nmm: f64) -> ContactError {
        let what = format!("{}: moments", self.session.points.display());
        ContactError::value(
            what,
            format!("at most {max_nmm:.2} N mm"),
            format!("{largest_nmm:.2} N mm"),
        )
    }

    /// At which readings the free wire is clear of the object, and by how much, mm.
    fn clear(&self, rows: &[SweepRow]) -> Result<(Vec<bool>, f64), ContactError> {
        let shape = Shape::new(&self.whisker.rest_shape, 0.5)?;
        let clear_mm = CLEAR_MM + 3.0 * self.session.object_sd_mm + 0.5 * self.whisker.diameter_mm;
        let points: Vec<Vector3<f64>> = shape.nodes_mm.iter().map(|p| self.to_base(p)).collect();
        let clear = |r: &SweepRow| {
            let to_object = self.world_from_object.inverse() * r.world_from_base;
            points.iter().all(|p| {
                let at = to_object.transform_point(&(*p).into()).coords;
                self.mesh.closest_point(&at, clear_mm).is_none()
            })
        };
        Ok((rows.iter().map(clear).collect(), clear_mm))
    }

    /// A point of the wire's frame in that of the base.
    fn to_base(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.frame.rotation().inverse() * p
    }

    /// Gap of a reading with its derivatives; none where the object is out of reach.
    fn gap(
        &self,
        inverse: &StaticInverse,
        m: &Vector2<f64>,
        world_from_base: &Isometry3<f64>,
    ) -> Option<Gap> {
        let to_object = self.world_from_object.inverse() * world_from_base;
        let mut solutions = Vec::new();
        let mut nearest = |m: Vector2<f64>| {
            inverse.solutions([m.x, m.y], &mut solutions);
            self.nearest(&solutions, &to_object)
        };
        let (d_mm, normal) = nearest(*m)?;
        let by = |v: Option<(f64, Vector3<f64>)>| v.map_or(0.0, |(d, _)| (d - d_mm) / STEP_NMM);
        // Forward difference: the nearest contact moves with the moments by the wire's compliance.
        let by_moment = Vector2::new(
            by(nearest(m + Vector2::new(STEP_NMM, 0.0))),
            by(nearest(m + Vector2::new(0.0, STEP_NMM))),
        );
        Some(Gap {
            d_mm,
            by_moment,
            normal: self.world_from_object.rotation * normal,
        })
    }

    /// Distance from the surface where the curve comes nearest to a contact, and the outward normal there, frame of the object.
    fn nearest(
        &self,
        solutions: &[InverseSolution],
        to_object: &Isometry3<f64>,
    ) -> Option<(f64, Vector3<f64>)> {
        let mut best: Option<(f64, f64, Vector3<f64>)> = None;
        for s in solutions.iter().filter(|s| s.reachable) {
            let at = to_object
                .transform_point(&self.to_base(&s.point_mm).into())
                .coords;
            let Some(near) = self.mesh.closest_point(&at, REACH_MM) else {
                continue;
            };
            let off = (at - near.point_mm) * near.distance_mm.signum();
            let Some(outward) = off.try_normalize(1e-9) else {
                continue;
            };
            let force = to_object.rotation * self.to_base(&s.normal);
            let angle = force.dot(&outward).clamp(-1.0, 1.0).acos();
            // Without slip the force lies within the friction cone about the outward normal; beyond it a radian costs a lever.
            let excess_mm = LEVER_MM_PER_RAD * (angle - FRICTION.atan()).max(0.0);
            let cost = near.distance_mm.hypot(excess_mm);
            if best.is_none_or(|(c, ..)| cost < c) {
                best = Some((cost, near.distance_mm, outward));
            }
        }
        best.map(|(_, d, normal)| (d, normal))
    }

    /// Covariance of the gaps where the calibration is right within its uncertainty, mm^2.
    fn covariance(
        &self,
        rows: &[&SweepRow],
        moments: &[Vector2<f64>],
        gaps: &[Gap],
        shared_nmm: &[Vec<Vector2<f64>>],
        (zero_nmm2, spacing_nmm): (Matrix2<f64>, f64),
    ) -> DMatrix<f64> {
        let n = rows.len();
        let root = |i: usize| root2(&rows[i].noise_nmm2).transpose() * gaps[i].by_moment;
        let misfit: Vec<Vector2<f64>> = (0..n).map(root).collect();
        let shared: Vec<Vec<f64>> = (0..n)
            .map(|i| {
                shared_nmm[i]
                    .iter()
                    .map(|h| gaps[i].by_moment.dot(h))
                    .collect()
            })
            .collect();
        let placed = self.session.object_sd_mm.powi(2);
        // Errors add: misfit alike for like moments, common unknowns, the zero, the object's place along both normals, and each contact's own.
        DMatrix::from_fn(n, n, |i, j| {
            let off = (moments[i] - moments[j]).norm() / spacing_nmm.max(1e-9);
            let alike = (-0.5 * off * off).exp();
            let common: f64 = shared[i].iter().zip(&shared[j]).map(|(a, b)| a * b).sum();
            let zero = gaps[i].by_moment.dot(&(zero_nmm2 * gaps[j].by_moment));
            let own = if i == j { CONTACT_SD_MM.powi(2) } else { 0.0 };
            alike * misfit[i].dot(&misfit[j])
                + common
                + zero
                + placed * gaps[i].normal.dot(&gaps[j].normal)
                + own
        })
    }
}

impl Witness<WhiskerSystem> for SweepWitness {
    fn test(
        &self,
        model: &WhiskerSystem,
        h: &Hypothesis,
    ) -> Result<Option<WitnessTest>, TraceError> {
        let sd_pm = h.fit.readings_variance().sqrt() * model.noise_factor();
        let calibration = PhysicalModel::new(model, h, sd_pm);
        let test = self.consistency_test(&calibration, &model.data.whisker);
        test.map_err(|e| TraceError::Witness(e.to_string()))
    }
}

/// Sum of squares of the gaps under their covariance in the directions in which the calibration rules, their number, and the chance of as much; none
/// without any.
fn chi_squared(gaps: &[Gap], covariance: DMatrix<f64>) -> Option<(f64, f64, f64)> {
    let d = DVector::from_iterator(gaps.len(), gaps.iter().map(|g| g.d_mm));
    // Along eigenvectors of the covariance the gaps are independent: each square over its eigenvalue is chi-squared.
    let eigen = covariance.symmetric_eigen();
    let ruled = (0..d.len()).filter(|j| eigen.eigenvalues[*j] > 2.0 * CONTACT_SD_MM.powi(2));
    let squares: Vec<f64> = ruled
        .map(|j| eigen.eigenvectors.column(j).dot(&d).powi(2) / eigen.eigenvalues[j])
        .collect();
    let (statistic, dof) = (squares.iter().sum(), squares.len() as f64);
    ChiSquared::new(dof)
        .ok()
        .map(|chi2| (statistic, dof, chi2.sf(statistic)))
}

/// Root of a covariance; zero where it is none.
fn root2(nmm2: &Matrix2<f64>) -> Matrix2<f64> {
    nmm2.cholesky().map_or_else(Matrix2::zeros, |c| c.l())
}
