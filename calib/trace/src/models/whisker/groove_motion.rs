//! A session as one sees it who knows how the groove moves but not where it is: moments through a calibration, and ways along the trajectories.
//!
//! A moment is off by `dm = K^-1 [1, m, ...] db` where the coefficients are off by `db`, alike for every reading of a calibration: with
//! `cov(b) = F F'` each column of F gives one common unknown of unit variance. What is left is the reading's own noise, `K^-1 s^2 K^-T`.

use super::physical::PhysicalModel;
use super::rod_tables::RodParameters;
use super::system::WhiskerSystem;
use nalgebra::{DMatrix, Matrix2, Vector2, Vector3};
use wcal_map::{MapArtefact, MapPredictor};
use wcal_rod::Rod;

/// The wire with the mechanics that the calibration carries.
#[derive(Debug, Clone, PartialEq)]
pub struct AcceptedWire {
    /// Rod.
    pub rod: Rod,
    /// Largest tangential over normal force along the wire.
    pub friction: f64,
    /// Friction while the groove moves over friction at rest.
    pub moving_share: f64,
    /// What the calibration adds to the declared place of the groove, mm.
    pub offset_mm: Vector3<f64>,
}

/// A reading with the groove's way; none of its numbers comes from the groove's place.
#[derive(Debug, Clone, PartialEq)]
pub struct MovedReading {
    /// Index in the system's path.
    pub reading: usize,
    /// Index of the trajectory in the path's lines.
    pub line: usize,
    /// Time, s.
    pub t_s: f64,
    /// Base moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Inside the region that the calibration was fitted in.
    pub valid: bool,
    /// Covariance of the reading's own noise, (N mm)^2.
    pub noise_nmm2: Matrix2<f64>,
    /// Moments (N mm) by one standard deviation of each common unknown.
    pub shared_nmm: Vec<[f64; 2]>,
    /// Stage position as the accepted effects have it, mm.
    pub stage_mm: f64,
    /// What those effects added to it, mm.
    pub added_mm: f64,
    /// Signed speed, mm/s.
    pub velocity_mm_s: f64,
    /// Without load.
    pub rest: bool,
    /// Counts up where the contact was left: at rest, and where another trajectory stood between.
    pub visit: u32,
}

/// A session through a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct GrooveMotion {
    /// Wire.
    pub wire: AcceptedWire,
    /// Readings on trajectories, in order of time.
    pub readings: Vec<MovedReading>,
}

/// Moments of a reading: mean, own noise, common unknowns, whether the calibration vouches for them.
type Sensed = ([f64; 2], Matrix2<f64>, Vec<[f64; 2]>, bool);

/// Through sensitivity and accepted effects; none where the sensitivity cannot be inverted or the wire cannot be bent. Rows without a stage
/// position would take theirs from the groove's place: the system must have none.
#[must_use]
pub fn of_model(system: &WhiskerSystem, model: &PhysicalModel) -> Option<GrooveMotion> {
    let path = &system.path;
    let inverse = model.sensitivity().try_inverse()?;
    let terms = model.terms();
    let mut mechanics = RodParameters::default();
    let mut xs: Vec<f64> = path.nodes.iter().map(|n| n.x_mm).collect();
    for active in &terms {
        active.effect.rod(&active.values(), &mut mechanics);
        active.effect.pose(&active.values(), path, &mut xs);
    }
    let inferred = model.infer(path, None);
    let sensed = model.sensed(&terms, path, &inverse);
    let noise_pm = vec![model.noise_sd_pm; sensed.len()];
    let (gradients, _) = model.gradients(&terms, path, &sensed, &inverse, &noise_pm);
    let factor = factor(model);
    let noise_nmm2 = inverse * inverse.transpose() * model.noise_sd_pm.powi(2);
    let sensed_at = |i: usize| -> Sensed {
        let common = &gradients[i] * &factor;
        let m = &inferred[i];
        (m.moment_nmm, noise_nmm2, common.column_iter().map(|u| [u[0], u[1]]).collect(), m.valid)
    };
    let wire = AcceptedWire {
        rod: system.rod_tables.rod(&mechanics)?,
        friction: mechanics.friction,
        moving_share: mechanics.moving_share,
        offset_mm: Vector3::from(mechanics.offset_mm),
    };
    Some(GrooveMotion { wire, readings: readings(system, &xs, sensed_at) })
}

/// Through a map of moments; its uncertainty is taken as common to all readings, one unknown for each moment.
#[must_use]
pub fn of_map(system: &WhiskerSystem, map: &MapArtefact) -> Option<GrooveMotion> {
    let mut predictor = MapPredictor::new(map).ok()?;
    let xs: Vec<f64> = system.path.nodes.iter().map(|n| n.x_mm).collect();
    let sensed_at = |i: usize| -> Sensed {
        let p = predictor.predict(system.path.readings[i].shift_pm);
        let noise = [0, 1].map(|c| (p.sd_nmm[c].powi(2) - p.sd_map_nmm[c].powi(2)).max(1e-12));
        let shared = vec![[p.sd_map_nmm[0], 0.0], [0.0, p.sd_map_nmm[1]]];
        (p.moment_nmm, Matrix2::from_diagonal(&Vector2::from(noise)), shared, p.is_valid())
    };
    let rod = system.rod_tables.rod(&RodParameters::default())?;
    let wire = AcceptedWire { rod, friction: 0.0, moving_share: 1.0, offset_mm: Vector3::zeros() };
    Some(GrooveMotion { wire, readings: readings(system, &xs, sensed_at) })
}

/// Readings on trajectories; `xs_mm` are the nodes' stage positions.
fn readings(
    system: &WhiskerSystem,
    xs_mm: &[f64],
    mut sensed_at: impl FnMut(usize) -> Sensed,
) -> Vec<MovedReading> {
    let path = &system.path;
    let mut stage_mm = vec![0.0; path.readings.len()];
    for (node, x) in path.nodes.iter().zip(xs_mm) {
        if let Some(i) = node.reading {
            stage_mm[i] = *x;
        }
    }
    let mut out: Vec<MovedReading> = Vec::with_capacity(path.readings.len());
    let (mut visit, mut last) = (0, None);
    for (i, r) in path.readings.iter().enumerate() {
        let here = (r.line, r.seating);
        visit += u32::from(r.rest || last.is_some_and(|before| before != here));
        last = Some(here);
        let Some(line) = r.line else { continue };
        let (moment_nmm, noise_nmm2, shared_nmm, valid) = sensed_at(i);
        out.push(MovedReading {
            reading: i,
            line,
            t_s: r.t_s,
            moment_nmm,
            valid,
            noise_nmm2,
            shared_nmm,
            stage_mm: stage_mm[i],
            added_mm: stage_mm[i] - r.x_mm,
            velocity_mm_s: r.velocity_mm_s,
            rest: r.rest,
            visit,
        });
    }
    out
}

/// F with F F' the covariance of all that was fitted: the eigenvectors that matter, scaled. The unknowns have different units: the
/// eigenvectors are those of the correlations.
fn factor(model: &PhysicalModel) -> DMatrix<f64> {
    const LEAST: f64 = 1e-12;
    let size = model.covariance.len();
    let sd: Vec<f64> =
        (0..size).map(|i| model.covariance[i][i].max(0.0).sqrt().max(f64::MIN_POSITIVE)).collect();
    let correlation = DMatrix::from_fn(size, size, |i, j| model.covariance[i][j] / sd[i] / sd[j]);
    let eigen = correlation.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let kept: Vec<usize> = (0..size).filter(|k| eigen.eigenvalues[*k] > LEAST * largest).collect();
    DMatrix::from_fn(size, kept.len(), |i, j| {
        sd[i] * eigen.eigenvectors[(i, kept[j])] * eigen.eigenvalues[kept[j]].sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::FbgSpec;

    #[test]
    fn the_common_unknowns_are_the_coefficients_covariance() {
        let covariance: Vec<Vec<f64>> =
            (0..6).map(|i| (0..6).map(|j| if i == j { 2.0 } else { 0.3 }).collect()).collect();
        let model = PhysicalModel {
            coefficients: vec![[0.0, 0.0], [70.0, 5.0], [-5.0, 70.0]],
            covariance: covariance.clone(),
            noise_sd_pm: 0.5,
            effects: Vec::new(),
            seatings: 1,
            fbg: FbgSpec::default(),
            largest_moment_nmm: 1.0,
        };
        let f = factor(&model);
        let again = &f * f.transpose();
        for (i, row) in covariance.iter().enumerate() {
            for (j, v) in row.iter().enumerate() {
                assert!((again[(i, j)] - v).abs() < 1e-9);
            }
        }
        // Through the readout they are what `sd_nmm` states beside the noise.
        let row = [1.0, 0.4, -0.2];
        let inverse = model.sensitivity().try_inverse().unwrap();
        let mut sum = inverse * inverse.transpose() * 0.25;
        let gradient = model.of_coefficients(&inverse, &row);
        for u in (&gradient * &f).column_iter() {
            sum += Matrix2::from_fn(|a, b| u[a] * u[b]);
        }
        let sd = model.sd_nmm(&inverse, &gradient, 0.5);
        assert!((sum[(0, 0)].sqrt() - sd[0]).abs() < 1e-12 && (sum[(1, 1)].sqrt() - sd[1]).abs() < 1e-12);
    }
}
