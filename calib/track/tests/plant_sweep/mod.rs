//! Sweeps of the independent plant as readings under its true map, with a zero, its drift and
//! errors of the map.

use nalgebra::{Matrix2, Rotation3, Vector2};
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_plant::sweep::SweepCase;
use wcal_rod::Rod;
use wcal_track::calibrated_wire::CalibratedWire;
use wcal_track::reading::{Moments, Reading, RowMotion};

/// Free readings that the zero is the mean of, standard deviation of its drift (N mm), and error of
/// the map, relative.
const ZERO_READINGS: usize = 5;
const DRIFT_NMM: f64 = 0.003;
const MAP_SHARE: f64 = 0.003;

/// The rod of a whisker with this mesh, mm.
pub(crate) fn calibrated(whisker: &WhiskerSpec, mesh_mm: f64) -> CalibratedWire {
    CalibratedWire::of_rod(Rod::new(whisker, mesh_mm).unwrap(), whisker.diameter_mm)
}

/// The wire of a sweep.
pub(crate) fn whisker(case: &SweepCase) -> WhiskerSpec {
    let b = &case.scene.bench;
    let rest_shape = RestShape::StraightArc {
        straight_mm: b.straight_mm,
        arc_radius_mm: b.arc_radius_mm,
        length_mm: b.length_mm,
    };
    WhiskerSpec {
        diameter_mm: b.diameter_mm,
        youngs_gpa: b.youngs_gpa,
        shear_gpa: b.shear_gpa,
        density_kg_m3: None,
        rest_shape,
        gravity_direction: None,
    }
}

/// Moments with white noise, and errors of the map that all share.
pub(crate) fn moments(
    moment_nmm: [f64; 2],
    noise_nmm2: Matrix2<f64>,
    shared_nmm: Vec<[f64; 2]>,
) -> Moments {
    Moments {
        moment_nmm,
        sd_nmm: [noise_nmm2[(0, 0)].sqrt(), noise_nmm2[(1, 1)].sqrt()],
        valid: true,
        pose_nmm2: noise_nmm2,
        own_nmm2: Some(noise_nmm2),
        shared_nmm,
        ..Moments::default()
    }
}

/// The readings of a sweep; the motion times a factor.
pub(crate) fn readings(case: &SweepCase, way: f64) -> Vec<Reading> {
    let bench = &case.scene.bench;
    let [[a, b], [c, d]] = bench.k;
    let nmm_per_pm = Matrix2::new(a, b, c, d).try_inverse().unwrap();
    let moment = |k: usize| {
        let pm = [0, 1].map(|c| 1e3 * (case.readings[k].fbg_nm[c] - bench.nominal_nm[c]));
        nmm_per_pm * Vector2::from(pm)
    };
    let zero = (0..ZERO_READINGS).map(moment).sum::<Vector2<f64>>() / ZERO_READINGS as f64;
    let noise_nmm2 = nmm_per_pm * nmm_per_pm.transpose() * case.scene.noise_pm.powi(2);
    let one = |k: usize| {
        let (m, at) = (moment(k) - zero, &case.readings[k]);
        let share = m * MAP_SHARE;
        let shared = vec![
            [share.x, 0.0],
            [0.0, share.x],
            [share.y, 0.0],
            [0.0, share.y],
        ];
        let moments = Moments {
            zero_nmm2: noise_nmm2 / ZERO_READINGS as f64
                + Matrix2::identity() * DRIFT_NMM * DRIFT_NMM,
            ..moments(m.into(), noise_nmm2, shared)
        };
        let motion = RowMotion {
            moved_mm: -at.base_mm * way,
            turn: Rotation3::identity(),
            velocity_mm_s: -case.scene.direction * case.scene.speed_mm_s * way,
            piece: 0,
            push: None,
        };
        Reading {
            motion: Ok(motion),
            ..Reading::alone(k as i64, at.t_s, Some(moments))
        }
    };
    (0..case.readings.len()).map(one).collect()
}
