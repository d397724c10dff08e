//! A sweep over an object that is known judges the explanations of a calibration session.
//!
//! The moments m of a reading allow a contact anywhere on the curve p(s; m), with a force along
//! n(s; m) (`StaticInverse`). The object allows it where its surface is, with the force along its
//! normal and friction. The gap d of a reading is what remains between both ([`scene`]), a function
//! of what else is not known: eta, the clock between readings and motion, the object's place, turn
//! and size, and friction. All readings from first load to release count:
//!
//! ```text
//! d_k(eta) = g_k' ((h_k - h_0) c + z + e(m_k)) + f_k,   g = dd/dm,   c ~ N(0, 1),   z ~ N(0, Z),   eta ~ N(0, 1)
//! e ~ GP(0, R exp(-|m - m'|^2 / 2 l^2))          misfit of the calibration: alike for like moments, l the spacing of its poses
//! f ~ GP(0, s_f^2 exp(-(w - w')^2 / 2 l_f^2))    friction, mesh and the model of one contact: alike over the way w of the base
//! eta^ = argmin  d' C^-1 d + |eta|^2             C: covariance of d by c, z, e and f;  J = dd/deta at eta^
//! T = sum_j (u_j' (d(eta^) - J eta^))^2 / l_j ~ chi^2(q)        l_j, u_j: eigenvalues and vectors of C + J J'; q of them exceed 2 s_f^2
//! ```
//!
//! The search begins from several clocks, and the largest p counts. T is d' C^-1 d + |eta|^2 at its
//! least, in the directions that the noise of a single reading does not rule: s_f bounds an error
//! and is no measured noise. h_0 is the common error at the sweep's own zero (the readings before
//! the free wire comes near the object), which takes it away. An explanation is held against the
//! declared model, too:
//!
//! ```text
//! P(L_0 / L_e >= 1 / a) <= a  where e is right       (Markov; L. Wasserman, A. Ramdas, S. Balakrishnan, PNAS 117 (2020) 16880)
//! -2 log L = d~' C~^-1 d~ + log |C~| - 2 sum_k log |g_k|     d~ = d(eta^) - J eta^, C~ = C + J J'; likelihood of the moments, the same readings
//! p = 2 min(P(chi^2(q) > T), L_e / L_0);  of the declared model itself P(chi^2(q) > T)
//! ```

use crate::TrackError;
use crate::sweep_record::{SweepRow, SweepZero, sweep_rows};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix2, Vector2, Vector3};
use scene::{BasePath, Gap, REACH_MM, Scene, UNKNOWNS, Unknowns};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::sync::OnceLock;
use wcal_calibration::WhiskerCalibration;
use wcal_core::WireFrame;
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_core::order_statistics::median;
use wcal_core::verify_document::WitnessTest;
use wcal_mesh::Mesh;
use wcal_network::{InverseGrid, InverseSolution, StaticInverse};
use wcal_rod::Shape;
use wcal_session::sweep_session::SweepSession;
use wcal_verify::MeasurementModel;
use wcal_verify::VerifyError;
use wcal_verify::levels::WITNESSES;
use wcal_verify::method::hypothesis::Hypothesis;
use wcal_verify::verify::Witness;
use wcal_verify::whisker::{PhysicalModel, WhiskerSystem};

mod scene;

/// The free wire is clear of the object from this distance on, mm, beside three standard deviations
/// of the object's place.
const CLEAR_MM: f64 = 0.5;
/// Readings that judge at most: denser ones say the same again.
const MAX_SAMPLES: usize = 60;
/// A reading is loaded beyond this many standard deviations of the free ones, or this share of the
/// largest moment.
const LOADED_SD: f64 = 5.0;
const LOADED_SHARE: f64 = 0.02;
/// A reading below this share of the largest moment may be one that a dead zone hides.
const HIDDEN_SHARE: f64 = 0.3;
/// Errors of what is felt are made larger by a dead zone at most so many times.
const MOST_LARGER: f64 = 100.0;
/// The table of the wire reaches this multiple of the largest moment: a trial may take the moments
/// for larger.
const TABLE_REACH: f64 = 1.6;
/// Step of the moments for gradients, N mm.
const STEP_NMM: f64 = 0.02;
/// What friction, the mesh and the model of one contact leave of a gap, mm, and over which way of
/// the base it is alike, mm.
const CONTACT_SD_MM: f64 = 0.3;
const CONTACT_WAY_MM: f64 = 5.0;
/// Share of that variance that is each reading's own.
const CONTACT_OWN: f64 = 0.1;
/// Step of the unknowns for gradients, in their standard deviations; rounds of the search and
/// halvings of its step.
const UNKNOWN_STEP: f64 = 0.05;
const ROUNDS: usize = 30;
/// A gap that changes by less with the moments says nothing of them, mm/(N mm).
const LEAST_SLOPE: f64 = 0.1;
/// Clocks from which it begins, in standard deviations: the gaps bend over the way of the base.
const CLOCKS: [f64; 5] = [0.0, -1.0, 1.0, -2.0, 2.0];
/// So many standard deviations a clock may be off.
const CLOCK_SDS: f64 = 2.0;
const HALVINGS: usize = 5;
/// The search ends where no unknown moves by more, in standard deviations.
const SETTLED: f64 = 1e-2;

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

/// A loaded reading.
struct Touch<'a> {
    row: &'a SweepRow,
    moment_nmm: Vector2<f64>,
    /// Way of the base until then, mm.
    way_mm: f64,
    /// How much larger the moment's errors across it are than those of what is felt.
    larger: f64,
    /// Contacts that its moments allow, and with a little more of each moment.
    curves: [Vec<InverseSolution>; 3],
}

impl SweepWitness {
    /// Of a sweep with a whisker, its moment axes, and the number of loaded poses of its
    /// calibration session.
    ///
    /// # Errors
    /// Where the sweep has no object or does not say where it lies, or the wire cannot be used.
    pub fn new(
        session: SweepSession,
        (declared, axes): (&WhiskerSpec, &MomentAxes),
        poses: usize,
    ) -> Result<Self, TrackError> {
        let what = |key: &str| format!("{}: {key}", session.id);
        let Some(object) = &session.object else {
            return Err(TrackError::value(
                what("files.object"),
                "a mesh of the object",
                "none",
            ));
        };
        let Some(world_from_object) = session.world_from_object else {
            return Err(TrackError::value(
                what("object.world_from_object"),
                "the pose of the mesh",
                "none",
            ));
        };
        let frame = WireFrame::new(declared, axes)
            .map_err(|e| TrackError::value(e.key, e.expected, e.found))?;
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

    /// Whether the contacts that the moments of a calibration allow lie on the object, and by no
    /// less than those of the `declared` one where it is another; none where its uncertainty rules
    /// in no direction.
    ///
    /// # Errors
    /// Where the sweep's table cannot be read by it, starts in contact, or never touches.
    pub fn consistency_test(
        &self,
        calibration: &dyn WhiskerCalibration,
        whisker: &WhiskerSpec,
        declared: Option<&dyn WhiskerCalibration>,
    ) -> Result<Option<WitnessTest>, TrackError> {
        let (chosen, found) = self.search(calibration, whisker, None)?;
        // What one choice of the unknowns allows is not refuted.
        let tested = found
            .iter()
            .filter_map(|best| Some((best, best.chi_squared()?)));
        let Some((best, (statistic, dof, by_gaps))) = tested.max_by(|a, b| a.1.2.total_cmp(&b.1.2))
        else {
            return Ok(None);
        };
        let least = |found: &[Best]| {
            found
                .iter()
                .filter_map(Best::deviance)
                .fold(f64::INFINITY, f64::min)
        };
        let p = match declared {
            Some(declared) => {
                // L_e / L_0 = exp((D_0 - D_e) / 2), D the least deviance of each.
                let rival = least(&self.search(declared, whisker, Some(&chosen))?.1);
                // Two tests, the less likely outcome of which counts.
                (2.0 * by_gaps.min((0.5 * (rival - least(&found))).exp())).min(1.0)
            }
            None => by_gaps,
        };
        let median_mm = median(best.gaps.iter().map(|g| g.d_mm.abs())).unwrap_or(f64::NAN);
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
                 of {} readings, where clock, place, turn, size and friction fit best (p = {p:.1e}).",
                self.id,
                best.gaps.len()
            ),
        }))
    }

    /// Where the search ends under a calibration, at the readings that are `chosen`, else at those
    /// that it finds loaded.
    fn search(
        &self,
        calibration: &dyn WhiskerCalibration,
        whisker: &WhiskerSpec,
        chosen: Option<&[usize]>,
    ) -> Result<(Vec<usize>, Vec<Best>), TrackError> {
        let rows = sweep_rows(&self.session, calibration, (whisker, &self.frame))?;
        let place = || self.session.points.display().to_string();
        let path = BasePath::new(&rows);
        let (clear, clear_mm) = self.clear(&rows, &path)?;
        // The sweep's own zero, and from when on the wire is loaded.
        let Some(zero) = SweepZero::new(&rows, clear) else {
            let expected =
                format!("readings before the wire comes within {clear_mm:.1} mm of the object");
            let free = clear[0];
            return Err(TrackError::value(
                place(),
                expected,
                format!("{free}: the sweep has no free readings, so no zero"),
            ));
        };
        let largest = zero.largest_nmm;
        let loaded_nmm = (LOADED_SD * zero.variance_nmm2.sqrt()).max(LOADED_SHARE * largest);
        let load = |k: usize| (rows[k].moment_nmm - zero.moment_nmm).norm();
        // A single loaded reading is an outlier.
        let high = |k: usize| k < rows.len() && load(k) > loaded_nmm;
        let loaded = |k: &usize| high(*k) && (high(*k + 1) || high(*k - 1));
        // Near both ends of the contact a load may more than double from one reading to the next:
        // what lies outside of that a dead zone hides.
        let peak = (zero.free..rows.len())
            .max_by(|a, b| load(*a).total_cmp(&load(*b)))
            .unwrap_or(zero.free);
        let leaps = |low: usize, high: usize| {
            load(low) < HIDDEN_SHARE * largest && load(high) > 2.0 * load(low)
        };
        let before = (zero.free..peak).rev().find(|k| leaps(*k, k + 1));
        let after = (peak + 1..rows.len()).find(|k| leaps(*k, k - 1));
        let (first, end) = (
            before.map_or(zero.free, |k| k + 1),
            after.unwrap_or(rows.len()),
        );
        let leap = |low: usize, high: usize| load(high) - load(low);
        // A dead zone hides as much at both ends; a wire that slips off leaps at one.
        let hidden_nmm = before
            .map_or(0.0, |k| leap(k, k + 1))
            .min(after.map_or(0.0, |k| leap(k, k - 1)));
        let touching: Vec<usize> = (first..end).filter(loaded).collect();
        let every = touching.len().div_ceil(MAX_SAMPLES).max(1);
        let touching: Vec<usize> = touching.into_iter().step_by(every).collect();
        let touching = chosen.map_or(touching, <[usize]>::to_vec);
        if touching.is_empty() {
            let found = format!("none beyond {loaded_nmm:.3} N mm: the wire touches nothing");
            return Err(TrackError::value(place(), "loaded readings", found));
        }
        let inverse = self.inverse(largest)?;
        let touches: Vec<Touch> = touching
            .iter()
            .map(|k| Touch::new(&rows, *k, (&zero, hidden_nmm), inverse))
            .collect();
        let scene = Scene {
            mesh: &self.mesh,
            world_from_object: self.world_from_object,
            frame: &self.frame,
            radius_mm: 0.5 * self.whisker.diameter_mm,
            path,
            sd: self.session.unknown_sd,
        };
        // A pose of the calibration stands for its share of the moments' range: within it the
        // misfit is one.
        let spacing_nmm = largest / (self.poses as f64).sqrt();
        // The zero is the mean of the free readings: its variance is a reading's over their number.
        let zero_nmm2 = Matrix2::identity() * (zero.variance_nmm2 / zero.free as f64);
        // What all readings share is off the zero already.
        let off_zero = |t: &Touch| {
            zero.shared_nmm
                .iter()
                .zip(&t.row.shared_nmm)
                .map(|(z, h)| h - z)
                .collect()
        };
        let known: Vec<Vec<Vector2<f64>>> = touches.iter().map(off_zero).collect();
        let covariance =
            |by: &[Vector2<f64>]| covariance(&touches, by, &known, (zero_nmm2, spacing_nmm));
        let found = minima(&scene, &touches, &covariance);
        if found.is_empty() {
            let expected =
                format!("an object within {REACH_MM} mm of the wire at every loaded reading");
            return Err(TrackError::value(
                place(),
                expected,
                "one that is farther away",
            ));
        }
        Ok((touching, found))
    }

    /// The table of the wire, for moments up to the largest of the first verdict with a margin.
    fn inverse(&self, largest_nmm: f64) -> Result<&StaticInverse, TrackError> {
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

    fn beyond(&self, largest_nmm: f64, max_nmm: f64) -> TrackError {
        let what = format!("{}: moments", self.session.points.display());
        TrackError::value(
            what,
            format!("at most {max_nmm:.2} N mm"),
            format!("{largest_nmm:.2} N mm"),
        )
    }

    /// How many readings the free wire is clear of the object at first, as the clock is said to be
    /// and with one that is off, and by how much, mm.
    fn clear(&self, rows: &[SweepRow], path: &BasePath) -> Result<([usize; 2], f64), TrackError> {
        let shape = Shape::new(&self.whisker.rest_shape, 0.5)?;
        // Points are of the wire's axis: its radius counts, too.
        let clear_mm = CLEAR_MM + 3.0 * self.session.unknown_sd[1] + 0.5 * self.whisker.diameter_mm;
        let points: Vec<Vector3<f64>> = shape.nodes_mm.iter().map(|p| self.to_base(p)).collect();
        let first = |clock_s: f64| {
            let clear = |r: &&SweepRow| {
                let to_object = self.world_from_object.inverse() * path.at(r.t_s + clock_s);
                points.iter().all(|p| {
                    let at = to_object.transform_point(&(*p).into()).coords;
                    self.mesh.closest_point(&at, clear_mm).is_none()
                })
            };
            rows.iter().take_while(clear).count()
        };
        // A negative offset takes the base from earlier on its path: the wire is clear longer.
        Ok((
            [first(0.0), first(-CLOCK_SDS * self.session.unknown_sd[0])],
            clear_mm,
        ))
    }

    /// A point of the wire's frame in that of the base.
    fn to_base(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.frame.rotation().inverse() * p
    }
}

impl<'a> Touch<'a> {
    fn new(
        rows: &'a [SweepRow],
        k: usize,
        (zero, hidden_nmm): (&SweepZero, f64),
        inverse: &StaticInverse,
    ) -> Self {
        let moment_nmm = rows[k].moment_nmm - zero.moment_nmm;
        let curve = |more: Vector2<f64>| {
            let mut solutions = Vec::new();
            inverse.solutions((moment_nmm + more * STEP_NMM).into(), &mut solutions);
            solutions
        };
        let curves = [Vector2::zeros(), Vector2::x(), Vector2::y()].map(curve);
        let place = |r: &SweepRow| r.world_from_base.translation.vector;
        let way_mm = rows[..=k]
            .windows(2)
            .map(|w| (place(&w[1]) - place(&w[0])).norm())
            .sum();
        // Of a moment m only m - h is felt, in the same direction: an error across is longer by m /
        // (m - h).
        let felt = 1.0 - hidden_nmm / moment_nmm.norm();
        let larger = 1.0 / felt.max(1.0 / MOST_LARGER);
        Self {
            row: &rows[k],
            moment_nmm,
            way_mm,
            larger,
            curves,
        }
    }

    fn gap(&self, scene: &Scene<'_>, eta: &Unknowns, near: Option<usize>) -> Option<Gap> {
        scene.gap(&self.curves[0], self.row.t_s, eta, near)
    }

    /// Derivative of the gap by the moments. Forward difference: the contact moves with the moments
    /// by the wire's compliance.
    fn by_moment(&self, scene: &Scene<'_>, eta: &Unknowns, gap: &Gap) -> Vector2<f64> {
        let by = |k: usize| {
            let more = scene.gap(&self.curves[k], self.row.t_s, eta, Some(gap.node));
            // Where the shifted moments allow no contact in reach, the gap says nothing of them.
            more.map_or(0.0, |m| (m.d_mm - gap.d_mm) / STEP_NMM)
        };
        Vector2::new(by(1), by(2))
    }
}

/// The unknowns at which the gaps are smallest for what causes them, with what is known there.
struct Best {
    gaps: Vec<Gap>,
    eta: Unknowns,
    by_moment: Vec<Vector2<f64>>,
    by_unknown: DMatrix<f64>,
    covariance: DMatrix<f64>,
}

/// Where the search ends from each clock; empty where the object is out of reach.
fn minima(
    scene: &Scene<'_>,
    touches: &[Touch<'_>],
    covariance: &dyn Fn(&[Vector2<f64>]) -> DMatrix<f64>,
) -> Vec<Best> {
    let from = |clock: f64| {
        let mut eta = Unknowns::zeros();
        eta[0] = clock;
        descend(scene, touches, covariance, eta)
    };
    CLOCKS.into_iter().filter_map(from).collect()
}

/// Gauss-Newton; none where the object is out of reach.
fn descend(
    scene: &Scene<'_>,
    touches: &[Touch<'_>],
    covariance: &dyn Fn(&[Vector2<f64>]) -> DMatrix<f64>,
    mut eta: Unknowns,
) -> Option<Best> {
    let gaps_at = |eta: &Unknowns, near: Option<&[Gap]>| -> Option<Vec<Gap>> {
        let one = |(k, t): (usize, &Touch<'_>)| t.gap(scene, eta, near.map(|g| g[k].node));
        touches.iter().enumerate().map(one).collect()
    };
    let mut gaps = gaps_at(&eta, None)?;
    for round in 0.. {
        let by_moment: Vec<Vector2<f64>> = touches
            .iter()
            .zip(&gaps)
            .map(|(t, g)| t.by_moment(scene, &eta, g))
            .collect();
        // C goes with the slopes g, which the unknowns change: it is held for one round.
        let covariance = covariance(&by_moment);
        let mut by_unknown = DMatrix::zeros(gaps.len(), UNKNOWNS);
        for k in 0..UNKNOWNS {
            let mut ahead = eta;
            ahead[k] += UNKNOWN_STEP;
            // On the same part of the curve: a leap to another contact is no derivative.
            let more = gaps_at(&ahead, Some(&gaps))?;
            let by = |(m, g): (&Gap, &Gap)| (m.d_mm - g.d_mm) / UNKNOWN_STEP;
            by_unknown.set_column(
                k,
                &DVector::from_iterator(gaps.len(), more.iter().zip(&gaps).map(by)),
            );
        }
        let factor = covariance.clone().cholesky()?;
        let cost = |gaps: &[Gap], eta: &Unknowns| {
            let d = offsets(gaps);
            d.dot(&factor.solve(&d)) + eta.norm_squared()
        };
        // (J' C^-1 J + 1) eta = J' C^-1 (J eta_0 - d): the unknowns of the linearised gaps, with
        // their spread before the sweep.
        let weighed = factor.solve(&by_unknown);
        let normal = by_unknown.transpose() * &weighed + DMatrix::identity(UNKNOWNS, UNKNOWNS);
        let right = weighed.transpose() * (&by_unknown * eta - offsets(&gaps));
        let target = normal.cholesky()?.solve(&right);
        let step = Unknowns::from_iterator(target.iter().copied()) - eta;
        let here = cost(&gaps, &eta);
        let shorter = (0..HALVINGS).map(|h| eta + step * 0.5_f64.powi(h as i32));
        let better = shorter
            .filter_map(|eta| Some((gaps_at(&eta, None)?, eta)))
            .find(|(gaps, eta)| cost(gaps, eta) < here);
        match better {
            Some(next) if round < ROUNDS && (next.1 - eta).amax() > SETTLED => (gaps, eta) = next,
            _ => {
                return Some(Best {
                    gaps,
                    eta,
                    by_moment,
                    by_unknown,
                    covariance,
                });
            }
        }
    }
    None
}

fn offsets(gaps: &[Gap]) -> DVector<f64> {
    DVector::from_iterator(gaps.len(), gaps.iter().map(|g| g.d_mm))
}

impl Best {
    /// -2 log likelihood of the moments along which the gaps change, up to a constant; none where
    /// it is not defined.
    fn deviance(&self) -> Option<f64> {
        // Taken back to eta = 0, where the gaps have the covariance C + J J'.
        let d = offsets(&self.gaps) - &self.by_unknown * self.eta;
        let factor =
            (&self.covariance + &self.by_unknown * self.by_unknown.transpose()).cholesky()?;
        let log_determinant = 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        // A gap d is a moment d / |g|.
        let slopes: f64 = self
            .by_moment
            .iter()
            .map(|g| g.norm().max(LEAST_SLOPE).ln())
            .sum();
        Some(d.dot(&factor.solve(&d)) + log_determinant - 2.0 * slopes)
    }

    /// Sum of squares of the gaps under their covariance in the directions in which something known
    /// rules, their number, and the chance of as much; none without any.
    fn chi_squared(&self) -> Option<(f64, f64, f64)> {
        let d = offsets(&self.gaps) - &self.by_unknown * self.eta;
        // Along eigenvectors of the covariance the gaps are independent: each square over its
        // eigenvalue is chi-squared.
        let eigen =
            (&self.covariance + &self.by_unknown * self.by_unknown.transpose()).symmetric_eigen();
        // The other directions hold s_f alone, which bounds an error and is no measured noise.
        let ruled = (0..d.len()).filter(|j| eigen.eigenvalues[*j] > 2.0 * CONTACT_SD_MM.powi(2));
        let squares: Vec<f64> = ruled
            .map(|j| eigen.eigenvectors.column(j).dot(&d).powi(2) / eigen.eigenvalues[j])
            .collect();
        let (statistic, dof) = (squares.iter().sum(), squares.len() as f64);
        ChiSquared::new(dof)
            .ok()
            .map(|chi2| (statistic, dof, chi2.sf(statistic)))
    }
}

/// Covariance of the gaps where the calibration is right within its uncertainty, mm^2, by their
/// derivatives by the moments.
fn covariance(
    touches: &[Touch<'_>],
    by_moment: &[Vector2<f64>],
    shared_nmm: &[Vec<Vector2<f64>>],
    (zero_nmm2, spacing_nmm): (Matrix2<f64>, f64),
) -> DMatrix<f64> {
    let n = touches.len();
    // An error along the moment counts as it is; one across it is larger.
    let across = |t: &Touch<'_>, by: &Vector2<f64>| {
        let along = t.moment_nmm.normalize();
        along * along.dot(by) * (1.0 - t.larger) + by * t.larger
    };
    let felt: Vec<Vector2<f64>> = touches
        .iter()
        .zip(by_moment)
        .map(|(t, by)| across(t, by))
        .collect();
    // g' R g = |L' g|^2, R = L L': products of such columns are the noise between two readings.
    let root = |i: usize| root2(&touches[i].row.noise_nmm2).transpose() * felt[i];
    let misfit: Vec<Vector2<f64>> = (0..n).map(root).collect();
    let shared: Vec<Vec<f64>> = (0..n)
        .map(|i| shared_nmm[i].iter().map(|h| by_moment[i].dot(h)).collect())
        .collect();
    let alike = |off: f64| (-0.5 * off * off).exp();
    // Errors add: misfit alike for like moments, common unknowns, the zero, and each contact's own,
    // alike nearby.
    DMatrix::from_fn(n, n, |i, j| {
        let off = (touches[i].moment_nmm - touches[j].moment_nmm).norm() / spacing_nmm.max(1e-9);
        let common: f64 = shared[i].iter().zip(&shared[j]).map(|(a, b)| a * b).sum();
        let zero = felt[i].dot(&(zero_nmm2 * felt[j]));
        let nearby = alike((touches[i].way_mm - touches[j].way_mm) / CONTACT_WAY_MM);
        let own = if i == j { CONTACT_OWN } else { 0.0 };
        alike(off) * misfit[i].dot(&misfit[j])
            + common
            + zero
            + CONTACT_SD_MM.powi(2) * ((1.0 - CONTACT_OWN) * nearby + own)
    })
}

impl Witness<WhiskerSystem> for SweepWitness {
    fn test(
        &self,
        model: &WhiskerSystem,
        h: &Hypothesis,
    ) -> Result<Option<WitnessTest>, VerifyError> {
        let calibration = PhysicalModel::new(model, h, sd_pm_of(model, h));
        // An explanation without effects is the declared model itself, held against nothing.
        let declared = (!h.fit.terms.is_empty())
            .then(|| Hypothesis::fitted(model, &[], &h.weights, 0))
            .flatten();
        let declared = declared.map(|h| PhysicalModel::new(model, &h, sd_pm_of(model, &h)));
        let declared = declared
            .as_ref()
            .map(|model| model as &dyn WhiskerCalibration);
        let test = self.consistency_test(&calibration, &model.data.whisker, declared);
        test.map_err(|e| VerifyError::Witness(e.to_string()))
    }
}

/// Standard deviation of a reading about a fit, pm.
fn sd_pm_of(model: &WhiskerSystem, h: &Hypothesis) -> f64 {
    h.fit.readings_variance().sqrt() * model.noise_factor()
}

/// Root of a covariance; zero where it is none.
fn root2(nmm2: &Matrix2<f64>) -> Matrix2<f64> {
    nmm2.cholesky().map_or_else(Matrix2::zeros, |c| c.l())
}
