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

use super::path::{Reading, WhiskerPath};
use super::physical::{CalibratedReading, PhysicalModel, covariance_root};
use super::rod_parameters::RodParameters;
use super::rod_tables::{AIR_KG_M3, rod_of};
use super::system::{WhiskerSystem, effective_poses};
use super::whisker_effect::Observers;
use nalgebra::{Matrix2, Vector3};
use wcal_core::WhiskerSpec;
use wcal_core::stream::MomentStream;
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

/// The rod with the given deviations.
type RodOf<'a> = &'a dyn Fn(&RodParameters) -> Option<Rod>;

impl AcceptedWire {
    fn new(rod_of: RodOf<'_>, deviations: &RodParameters) -> Option<Self> {
        Some(Self {
            rod: rod_of(deviations)?,
            friction: deviations.friction,
            moving_share: deviations.moving_share,
            offset_mm: Vector3::from(deviations.offset_mm),
        })
    }

    /// The wire that `whisker` describes, in air, without accepted deviations; none where it cannot
    /// be bent.
    pub fn nominal(whisker: &WhiskerSpec) -> Option<Self> {
        Self::new(
            &|rod| rod_of(whisker, AIR_KG_M3, rod),
            &RodParameters::default(),
        )
    }

    /// The same with those of `model`, and by one standard deviation of each of the first common
    /// unknowns.
    pub fn accepted(whisker: &WhiskerSpec, model: &PhysicalModel) -> Option<(Self, Vec<Self>)> {
        let rod_of: RodOf<'_> = &|rod| rod_of(whisker, AIR_KG_M3, rod);
        let (path, (unknowns, mechanical)) = (WhiskerPath::default(), covariance_root(model));
        let of = |model: &PhysicalModel| Some(mechanics(&path, rod_of, model)?.1);
        let changed = unknowns.column_iter().take(mechanical);
        let changed = changed.map(|by| of(&with_values(model, by.as_slice())));
        Some((of(model)?, changed.collect::<Option<_>>()?))
    }
}

/// Stage positions of the nodes, mm, and the wire, as the accepted effects have them.
fn mechanics(
    path: &WhiskerPath,
    rod_of: RodOf<'_>,
    model: &PhysicalModel,
) -> Option<(Vec<f64>, AcceptedWire)> {
    let (xs_mm, rod) = effective_poses(
        path,
        &model.terms(),
        Observers::Cameras,
        model.stage_clock_s,
    );
    Some((xs_mm, AcceptedWire::new(rod_of, &rod)?))
}

/// Through sensitivity and accepted effects; none where the sensitivity cannot be inverted or the
/// wire cannot be bent. Rows without a stage position would take theirs from the groove's place:
/// the system must have none.
pub fn of_model(system: &WhiskerSystem, model: &PhysicalModel) -> Option<GrooveMotion> {
    let (path, rod_of) = (&system.path, |rod: &RodParameters| {
        system.rod_tables.rod(rod)
    });
    let (xs_mm, wire) = mechanics(path, &rod_of, model)?;
    let (unknowns, mechanical) = covariance_root(model);
    let others = unknowns
        .column_iter()
        .map(|by| mechanics(path, &rod_of, &with_values(model, by.as_slice())));
    let (others_mm, mut changed): (Vec<Vec<f64>>, Vec<AcceptedWire>) =
        others.collect::<Option<Vec<_>>>()?.into_iter().unzip();
    // F is triangular with the wire's values first: later unknowns leave the wire alone.
    changed.truncate(mechanical);
    let mut readings = readings(system, &xs_mm, &others_mm, model.calibrated(path)?);
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

/// Through a map of moments; its uncertainty is taken as common to all readings, one unknown for
/// each moment.
pub fn of_map(system: &WhiskerSystem, map: &MapArtefact) -> Option<GrooveMotion> {
    let mut predictor = MapPredictor::new(map).ok()?;
    let xs: Vec<f64> = system.path.nodes.iter().map(|n| n.x_mm).collect();
    let sensed = system.path.readings.iter().map(|r| {
        let moments = predictor.moments(r.t_s, r.shift_pm, r.rise_degc);
        (moments, predictor.spread())
    });
    let sensed = sensed.collect();
    let rod_of = |rod: &RodParameters| system.rod_tables.rod(rod);
    Some(GrooveMotion {
        wire: AcceptedWire::new(&rod_of, &RodParameters::default())?,
        changed: Vec::new(),
        // A map corrects no pose: its two unknowns leave the stage's way as it is.
        readings: readings(system, &xs, &[xs.clone(), xs.clone()], sensed),
        correlated: None,
    })
}

/// Readings on trajectories; `xs_mm` are the nodes' stage positions, `others_mm` those by one
/// standard deviation of each common unknown.
fn readings(
    system: &WhiskerSystem,
    xs_mm: &[f64],
    others_mm: &[Vec<f64>],
    sensed: Vec<CalibratedReading>,
) -> Vec<ReadingWithMotion> {
    let path = &system.path;
    let (mut contact_segment, mut last) = (0, None);
    let of = |(reading, ((r, (moments, spread)), n)): (
        usize,
        ((&Reading, CalibratedReading), usize),
    )| {
        let here = (r.line, r.seating);
        contact_segment += u32::from(r.rest || last.is_some_and(|before| before != here));
        last = Some(here);
        Some(ReadingWithMotion {
            reading,
            line: r.line?,
            t_s: r.t_s,
            moment_nmm: moments.moment_nmm,
            valid: moments.valid,
            noise_nmm2: spread.noise_nmm2,
            shared_nmm: spread.shared_nmm,
            shared_displacement_mm: others_mm.iter().map(|o| o[n] - xs_mm[n]).collect(),
            stage_mm: xs_mm[n],
            added_mm: xs_mm[n] - r.x_mm,
            velocity_mm_s: r.velocity_mm_s,
            rest: r.rest,
            contact_segment,
        })
    };
    let all = path.readings.iter().zip(sensed).zip(path.reading_nodes());
    all.enumerate().filter_map(of).collect()
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
    // Coefficients stand first and move no groove; outside its range a law has no meaning.
    for ((value, [low, high]), by) in values.zip(ranges).zip(&by[2 * model.coefficients.len()..]) {
        *value = (*value + by).clamp(low, high);
    }
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::path::{ReadoutOrigin, bare_row};
    use crate::whisker::physical::AcceptedEffect;
    use wcal_core::observation::Trajectory;
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
        WhiskerPath::new(&rows, &[line], &FbgSpec::default(), None)
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
            .0
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
