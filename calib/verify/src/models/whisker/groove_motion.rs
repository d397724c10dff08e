//! A session as one sees it who knows how the groove moves but not where it is: moments through a
//! calibration, and ways along the trajectories.
//!
//! What a calibration does not know is alike for all its readings. With theta = (coefficients,
//! values of the effects) and `cov(theta) = F F'`, each column f of F is one common unknown of unit
//! variance; where the truth is theta + f instead of theta,
//!
//! `y - m_true = m(theta) - m(theta + f)` (moments), `x(theta + f) - x(theta)` (way of the stage),
//! another wire (rod and friction).
//!
//! F is triangular with the values of the wire's effects first, so that only the first columns need
//! another wire. The remainder is the reading's own noise, `K^-1 s^2 K^-T`.

use super::physical::PhysicalModel;
use super::rod_parameters::RodParameters;
use super::rod_tables::rod_of;
use super::system::{AIR_KG_M3, WhiskerSystem, effective_poses};
use super::whisker_effect::{ActiveEffect, Observers};
use crate::whisker::path::WhiskerPath;
use nalgebra::{DMatrix, Matrix2, Vector3};
use wcal_core::WhiskerSpec;
use wcal_core::stream::MomentSpread;
use wcal_gpr::{MapArtefact, MapPredictor};
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
pub struct ReadingWithMotion {
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
    /// By how much one standard deviation of each common unknown makes the moments too large, N mm.
    pub shared_nmm: Vec<[f64; 2]>,
    /// By how much it makes the stage's way longer, mm.
    pub shared_displacement_mm: Vec<f64>,
    /// Stage position as the accepted effects have it, mm.
    pub stage_mm: f64,
    /// What those effects added to it, mm.
    pub added_mm: f64,
    /// Signed speed, mm/s.
    pub velocity_mm_s: f64,
    /// Without load.
    pub rest: bool,
    /// Counts up where the contact was left: at rest, and where another trajectory stood between.
    pub contact_segment: u32,
}

/// Largest share of the noise that is taken to be correlated: a reading always has some by itself.
const MAX_CORRELATED: f64 = 0.98;

/// A session through a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct GrooveMotion {
    /// Wire.
    pub wire: AcceptedWire,
    /// The wire by one standard deviation of each of the first common unknowns; the others leave it
    /// as it is.
    pub changed: Vec<AcceptedWire>,
    /// Readings on trajectories, in order of time.
    pub readings: Vec<ReadingWithMotion>,
    /// Share of the variance of the readings' noise that is correlated in time, and its time
    /// constant, s; none where none was found.
    pub correlated: Option<[f64; 2]>,
}

/// Moments of a reading through a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedReading {
    /// Base moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Covariance of the reading's own noise, (N mm)^2.
    pub noise_nmm2: Matrix2<f64>,
    /// Inside the region that the calibration was fitted in.
    pub valid: bool,
    /// See [`ReadingWithMotion::shared_nmm`].
    pub shared_nmm: Vec<[f64; 2]>,
    /// See [`ReadingWithMotion::shared_displacement_mm`].
    pub shared_displacement_mm: Vec<f64>,
}

/// Readings without a stage through a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct SensedReadings {
    /// Wire.
    pub wire: AcceptedWire,
    /// See [`GrooveMotion::changed`].
    pub changed: Vec<AcceptedWire>,
    /// In the order of the path.
    pub readings: Vec<CalibratedReading>,
}

/// Stage and wire under one set of values.
struct Mechanics {
    /// Stage positions of the nodes, mm.
    xs_mm: Vec<f64>,
    wire: AcceptedWire,
}

/// The rod with the given deviations.
type RodOf<'a> = &'a dyn Fn(&RodParameters) -> Option<Rod>;

fn mechanics(path: &WhiskerPath, rod_of: RodOf<'_>, model: &PhysicalModel) -> Option<Mechanics> {
    let (xs_mm, rod) = effective_poses(
        path,
        &model.terms(),
        Observers::Cameras,
        model.stage_clock_s,
    );
    let wire = AcceptedWire {
        rod: rod_of(&rod)?,
        friction: rod.friction,
        moving_share: rod.moving_share,
        offset_mm: Vector3::from(rod.offset_mm),
    };
    Some(Mechanics { xs_mm, wire })
}

/// The readings of a path, and the stage positions of its nodes.
fn calibrate_readings(
    path: &WhiskerPath,
    rod_of: RodOf<'_>,
    model: &PhysicalModel,
) -> Option<(SensedReadings, Vec<f64>)> {
    let inverse = model.sensitivity().try_inverse()?;
    let Mechanics { xs_mm, wire } = mechanics(path, rod_of, model)?;
    let inferred = model.infer(path, None);
    let terms = model.terms();
    let sensed = model.sensed(&terms, path, &inverse);
    let noise_pm = vec![model.noise_sd_pm; sensed.len()];
    let (gradients, _) = model.gradients(&terms, path, &sensed, &inverse, &noise_pm);
    let (factor, mechanical) = covariance_root(model);
    let others = factor
        .column_iter()
        .map(|f| mechanics(path, rod_of, &with_values(model, f.as_slice())));
    let others = others.collect::<Option<Vec<Mechanics>>>()?;
    // Of a typical reading; one that averages fewer samples has more.
    let noise_nmm2 = inverse * inverse.transpose() * model.noise_sd_pm.powi(2);
    let variances = model.relative_variances(&path.readings);
    let mut node_of = vec![0; path.readings.len()];
    for (n, node) in path.nodes.iter().enumerate() {
        if let Some(i) = node.reading {
            node_of[i] = n;
        }
    }
    let sensed = |i: usize| {
        let (m, n) = (&inferred[i], node_of[i]);
        let common = &gradients[i] * &factor;
        CalibratedReading {
            moment_nmm: m.moment_nmm,
            noise_nmm2: noise_nmm2 * variances[i],
            valid: m.valid,
            shared_nmm: common.column_iter().map(|u| [-u[0], -u[1]]).collect(),
            shared_displacement_mm: others.iter().map(|o| o.xs_mm[n] - xs_mm[n]).collect(),
        }
    };
    let readings = (0..path.readings.len()).map(sensed).collect();
    let changed = others
        .into_iter()
        .take(mechanical)
        .map(|o| o.wire)
        .collect();
    Some((
        SensedReadings {
            wire,
            changed,
            readings,
        },
        xs_mm,
    ))
}

/// Through sensitivity and accepted effects; none where the sensitivity cannot be inverted or the
/// wire cannot be bent. Rows without a stage position would take theirs from the groove's place:
/// the system must have none.
pub fn of_model(system: &WhiskerSystem, model: &PhysicalModel) -> Option<GrooveMotion> {
    let (
        SensedReadings {
            wire,
            changed,
            readings: sensed,
        },
        xs_mm,
    ) = calibrate_readings(&system.path, &|rod| system.rod_tables.rod(rod), model)?;
    let mut readings = readings(system, &xs_mm, &sensed);
    let correlated = model.correlated_noise.map(|c| {
        // Both parts as they were found together: their sum need not be the floor's.
        let variance_pm2 = c.sd_pm.powi(2) + c.own_sd_pm.powi(2);
        let scale = variance_pm2 / model.noise_sd_pm.powi(2).max(f64::MIN_POSITIVE);
        readings.iter_mut().for_each(|r| r.noise_nmm2 *= scale);
        [
            (c.sd_pm.powi(2) / variance_pm2).min(MAX_CORRELATED),
            c.time_constant_s,
        ]
    });
    Some(GrooveMotion {
        wire,
        changed,
        readings,
        correlated,
    })
}

/// Readings of a path without a stage, of a wire in air; as [`of_model`].
pub fn of_readings(
    path: &WhiskerPath,
    whisker: &WhiskerSpec,
    model: &PhysicalModel,
) -> Option<SensedReadings> {
    calibrate_readings(path, &|rod| rod_of(whisker, AIR_KG_M3, rod), model).map(|found| found.0)
}

fn sensed_by_map(predictor: &MapPredictor, shift_pm: [f64; 2]) -> CalibratedReading {
    let p = predictor.predict(shift_pm);
    let MomentSpread {
        noise_nmm2,
        shared_nmm,
    } = p.spread();
    let shared_displacement_mm = vec![0.0; shared_nmm.len()];
    CalibratedReading {
        moment_nmm: p.moment_nmm,
        noise_nmm2,
        valid: p.is_valid(),
        shared_nmm,
        shared_displacement_mm,
    }
}

/// A wire without accepted deviations.
fn nominal(rod: Rod) -> AcceptedWire {
    AcceptedWire {
        rod,
        friction: 0.0,
        moving_share: 1.0,
        offset_mm: Vector3::zeros(),
    }
}

/// Through a map of moments; its uncertainty is taken as common to all readings, one unknown for
/// each moment.
pub fn of_map(system: &WhiskerSystem, map: &MapArtefact) -> Option<GrooveMotion> {
    let predictor = MapPredictor::new(map).ok()?;
    let xs: Vec<f64> = system.path.nodes.iter().map(|n| n.x_mm).collect();
    let sensed = system
        .path
        .readings
        .iter()
        .map(|r| sensed_by_map(&predictor, r.shift_pm));
    let sensed: Vec<CalibratedReading> = sensed.collect();
    let wire = nominal(system.rod_tables.rod(&RodParameters::default())?);
    let readings = readings(system, &xs, &sensed);
    Some(GrooveMotion {
        wire,
        changed: Vec::new(),
        readings,
        correlated: None,
    })
}

/// Readings without a stage by their compensated shifts (pm); as [`of_map`].
pub fn of_shifts(
    shifts_pm: impl Iterator<Item = [f64; 2]>,
    whisker: &WhiskerSpec,
    map: &MapArtefact,
) -> Option<SensedReadings> {
    let predictor = MapPredictor::new(map).ok()?;
    Some(SensedReadings {
        wire: nominal(rod_of(whisker, AIR_KG_M3, &RodParameters::default())?),
        changed: Vec::new(),
        readings: shifts_pm.map(|s| sensed_by_map(&predictor, s)).collect(),
    })
}

/// Readings on trajectories; `xs_mm` are the nodes' stage positions.
fn readings(
    system: &WhiskerSystem,
    xs_mm: &[f64],
    sensed: &[CalibratedReading],
) -> Vec<ReadingWithMotion> {
    let path = &system.path;
    let mut stage_mm = vec![0.0; path.readings.len()];
    for (node, x) in path.nodes.iter().zip(xs_mm) {
        if let Some(i) = node.reading {
            stage_mm[i] = *x;
        }
    }
    let mut out: Vec<ReadingWithMotion> = Vec::with_capacity(path.readings.len());
    let (mut contact_segment, mut last) = (0, None);
    for (i, r) in path.readings.iter().enumerate() {
        let here = (r.line, r.seating);
        contact_segment += u32::from(r.rest || last.is_some_and(|before| before != here));
        last = Some(here);
        let Some(line) = r.line else { continue };
        let CalibratedReading {
            moment_nmm,
            noise_nmm2,
            valid,
            shared_nmm,
            shared_displacement_mm,
        } = sensed[i].clone();
        out.push(ReadingWithMotion {
            reading: i,
            line,
            t_s: r.t_s,
            moment_nmm,
            valid,
            noise_nmm2,
            shared_nmm,
            shared_displacement_mm,
            stage_mm: stage_mm[i],
            added_mm: stage_mm[i] - r.x_mm,
            velocity_mm_s: r.velocity_mm_s,
            rest: r.rest,
            contact_segment,
        });
    }
    out
}

/// The model whose values are off by what stands behind the coefficients in `by`; they stay in
/// their ranges.
fn with_values(model: &PhysicalModel, by: &[f64]) -> PhysicalModel {
    let mut moved = model.clone();
    let laws = model.terms();
    let ranges = laws
        .iter()
        .flat_map(|a| a.law().parameters.iter().map(|p| p.range));
    let values = moved.effects.iter_mut().flat_map(|e| &mut e.values);
    for ((value, [low, high]), by) in values.zip(ranges).zip(&by[2 * model.coefficients.len()..]) {
        *value = (*value + by).clamp(low, high);
    }
    moved
}

/// Whether an effect changes the wire: rod or friction.
fn is_mechanical(effect: &ActiveEffect) -> bool {
    let mut mechanics = RodParameters::default();
    (effect.effect.rod)(&effect.values(), &mut mechanics);
    RodParameters {
        offset_mm: [0.0; 3],
        ..mechanics
    } != RodParameters::default()
}

/// F with cov(theta) = F F', and how many of its first columns change the wire.
pub(super) fn covariance_root(model: &PhysicalModel) -> (DMatrix<f64>, usize) {
    const LEAST: f64 = 1e-12;
    let size = model.covariance.len();
    // Values of the wire's effects first.
    let mut order: Vec<usize> = Vec::with_capacity(size);
    let mut slot = 2 * model.coefficients.len();
    for (effect, term) in model.effects.iter().zip(model.terms()) {
        let slots = slot..slot + effect.values.len();
        slot = slots.end;
        if is_mechanical(&term) {
            order.extend(slots);
        }
    }
    let mechanical = order.len();
    order.extend(
        (0..size)
            .filter(|k| !order[..mechanical].contains(k))
            .collect::<Vec<_>>(),
    );
    // In units of the standard deviations: what is exact or not identified has none.
    let sd = |k: usize| model.covariance[k][k].max(0.0).sqrt();
    let unit = |i: usize, j: usize| model.covariance[i][j] / (sd(i) * sd(j)).max(f64::MIN_POSITIVE);
    let eigen = DMatrix::from_fn(size, size, |i, j| unit(order[i], order[j])).symmetric_eigen();
    let root = DMatrix::from_fn(size, size, |i, j| {
        let value = eigen.eigenvalues[j];
        eigen.eigenvectors[(i, j)] * if value > LEAST { value.sqrt() } else { 0.0 }
    });
    let triangle = root.transpose().qr().r().transpose();
    let mut factor = DMatrix::zeros(size, size);
    for (i, &at) in order.iter().enumerate() {
        (0..size).for_each(|j| factor[(at, j)] = triangle[(i, j)] * sd(at));
    }
    (factor, mechanical)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::path::{ReadoutOrigin, bare_row};
    use crate::whisker::physical::AcceptedEffect;
    use wcal_core::observation::{MomentAxes, Trajectory};
    use wcal_core::{FbgSpec, WhiskerRow};

    fn model(effects: Vec<AcceptedEffect>) -> PhysicalModel {
        let size = 6 + effects.iter().map(|e| e.values.len()).sum::<usize>();
        let covariance = |i: usize, j: usize| if i == j { 2e-4 } else { 3e-5 };
        PhysicalModel {
            coefficients: vec![[0.0, 0.0], [70.0, 5.0], [-5.0, 70.0]],
            covariance: (0..size)
                .map(|i| (0..size).map(|j| covariance(i, j)).collect())
                .collect(),
            noise_sd_pm: 0.5,
            correlated_noise: None,
            averaging: None,
            stage_clock_s: 0.0,
            readout_origin: ReadoutOrigin::default(),
            effects,
            seatings: 1,
            fbg: FbgSpec::default(),
            largest_moment_nmm: 1.0,
        }
    }

    fn effect(id: &str, law: &str, values: Vec<f64>) -> AcceptedEffect {
        AcceptedEffect {
            id: id.into(),
            law: law.into(),
            values,
            parameters: Vec::new(),
        }
    }

    #[test]
    fn the_common_unknowns_are_the_covariance_and_the_first_are_the_wires() {
        let lag = effect("time-lag", "delay", vec![0.1]);
        let friction = effect("groove-friction", "coulomb", vec![0.2]);
        for (effects, wires) in [
            (vec![], 0),
            (vec![lag.clone()], 0),
            (vec![lag, friction], 1),
        ] {
            let model = model(effects);
            let (f, mechanical) = covariance_root(&model);
            assert_eq!(mechanical, wires);
            let again = &f * f.transpose();
            for (i, row) in model.covariance.iter().enumerate() {
                for (j, v) in row.iter().enumerate() {
                    assert!((again[(i, j)] - v).abs() < 1e-12, "{i} {j}");
                }
            }
            // The friction is the last value: unknowns after the first leave it.
            let last = f.nrows() - 1;
            let left = (1..f.ncols())
                .map(|j| f[(last, j)].abs())
                .fold(0.0, f64::max);
            assert_eq!(left < 1e-15, wires == 1, "{left}");
            // Through the readout they are what `sd_nmm` states beside the noise.
            let row = [1.0, 0.4, -0.2];
            let inverse = model.sensitivity().try_inverse().unwrap();
            let mut sum = inverse * inverse.transpose() * 0.25;
            let gradient = model.of_coefficients(&inverse, &row);
            for u in (&gradient * &f).column_iter() {
                sum += Matrix2::from_fn(|a, b| u[a] * u[b]);
            }
            let sd = model.sd_nmm(&inverse, &gradient, 0.5);
            assert!(
                (sum[(0, 0)].sqrt() - sd[0]).abs() < 1e-12
                    && (sum[(1, 1)].sqrt() - sd[1]).abs() < 1e-12
            );
        }
    }

    /// Ten readings of one stroke at 2 mm/s, up and down.
    fn strokes() -> WhiskerPath {
        let row = |k: usize| WhiskerRow {
            trajectory: Some(1),
            stage_mm: Some(if k < 5 { k as f64 } else { 9.0 - k as f64 }),
            direction: Some(if k < 5 { 1.0 } else { -1.0 }),
            speed_mm_s: Some(2.0),
            ..bare_row(k, 0.5 * k as f64, [10.0, 5.0])
        };
        let rows: Vec<WhiskerRow> = (0..10).map(row).collect();
        let line = Trajectory {
            id: 1,
            nominal_arclength_mm: Some(30.0),
            origin_mm: Vector3::new(30.0, 0.0, 0.0),
            direction: Vector3::z(),
        };
        let rows: Vec<&WhiskerRow> = rows.iter().collect();
        WhiskerPath::new(
            &rows,
            &[line],
            &MomentAxes::default(),
            &FbgSpec::default(),
            None,
            None,
        )
    }

    #[test]
    fn the_stage_moves_as_in_the_fit() {
        let rod = |rod: &RodParameters| rod_of(&WhiskerSpec::nominal(), AIR_KG_M3, rod);
        let path = strokes();
        let of = |effects: Vec<AcceptedEffect>, stage_clock_s: f64| {
            mechanics(
                &path,
                &rod,
                &PhysicalModel {
                    stage_clock_s,
                    ..model(effects)
                },
            )
            .unwrap()
            .xs_mm
        };
        let screw = || effect("stage-backlash", "play-centred", vec![0.04]);
        let lag = || effect("time-lag", "delay", vec![0.1]);
        // The order of the file is not that of the signal.
        assert_eq!(of(vec![screw(), lag()], 0.0), of(vec![lag(), screw()], 0.0));
        // What the cameras alone see moves no groove.
        let alone = of(vec![lag()], 0.0);
        assert_eq!(
            of(
                vec![lag(), effect("picture-clock", "offset", vec![0.3])],
                0.0
            ),
            alone
        );
        // Control: a lag moves it, and so does the clock to which the fit set the stage.
        assert_ne!(alone, of(vec![], 0.0));
        let [later, plain] = [0.01, 0.0].map(|clock_s| of(vec![], clock_s));
        let moved: Vec<f64> = later.iter().zip(&plain).map(|(a, b)| a - b).collect();
        assert!(
            (moved[1] - 0.02).abs() < 1e-12 && (moved[8] + 0.02).abs() < 1e-12,
            "{moved:?}"
        );
    }

    #[test]
    fn values_stay_in_their_ranges() {
        let model = model(vec![effect("groove-friction", "coulomb", vec![0.01])]);
        let by =
            |v: f64| with_values(&model, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, v]).effects[0].values[0];
        assert_eq!(by(-5.0), 0.0);
        assert!((by(0.1) - 0.11).abs() < 1e-12);
    }
}
