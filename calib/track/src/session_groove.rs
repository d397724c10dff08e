//! Contact places of a session from its moments and the known way of the groove, and how far they
//! are from the groove.

#[cfg(test)]
mod session_groove_test;

use crate::TrackError;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, Estimator, Findings};
use crate::frame::in_wire_frame;
use crate::groove_comparison::{Compared, groove_sentence, groove_tracking};
use crate::known_motion::contact_path::{ContactPath, loaded};
use crate::known_motion::{
    CorrelatedNoise, Episode, EpisodeEstimate, MotionRow, Posterior, Settings, bound_mm,
    estimate_contact,
};
use crate::reading::{Moments, MotionAccuracy, Reading, RowMotion, squares};
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_calibration::WhiskerCalibration;
use wcal_core::observation::Trajectory;
use wcal_core::stream::Flags;
use wcal_core::verify_document::GrooveTracking;
use wcal_core::{Role, WhiskerData, WireFrame};
use wcal_verify::verify::{Decision, FoldCalibrations};
use wcal_verify::whisker::groove_motion::{GrooveMotion, ReadingWithMotion};
use wcal_verify::whisker::{PhysicalModel, WhiskerSystem};

/// The rows of a session without the groove's place, so that no answer can come from it; their
/// order stays.
///
/// # Errors
/// Where a loaded row has no stage position, or stands on a trajectory that the session does not
/// describe.
pub fn without_groove(data: &WhiskerData) -> Result<WhiskerData, TrackError> {
    let mut blind = data.clone();
    for row in &mut blind.rows {
        let known = row.trajectory.and_then(|id| data.trajectory(id)).is_some();
        let missing = match row.role {
            Role::Rest => None,
            _ if row.stage_mm.is_none() => Some(("stage_mm", "a position (the way of the groove)")),
            _ => (!known).then_some(("trajectory", "one with a direction in session.toml")),
        };
        if let Some((column, expected)) = missing {
            let what = format!("{}: line {}: {column}", row.source, row.line);
            return Err(TrackError::value(what, expected, "none"));
        }
        row.groove_mm = None;
    }
    Ok(blind)
}

/// The contact of a trajectory, which passes one point of the groove.
struct TrajectoryContact {
    trajectory: Trajectory,
    /// Its readings, and their numbers.
    numbers: Vec<usize>,
    episode: Episode,
    found: EpisodeEstimate,
}

/// The contacts of a session along the known way of its groove.
pub struct SessionGroove {
    /// Frame of its wire.
    pub frame: WireFrame,
    /// In the order of the trajectories, and how far they are from the groove.
    contacts: Vec<TrajectoryContact>,
    compared: Vec<Compared>,
    groove: Option<GrooveTracking>,
}

/// Places that are found on those of a session's readings that are `chosen` of the system's path,
/// beside the groove's, which `known` gives.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn compared(
    system: &WhiskerSystem,
    mut motion: GrooveMotion,
    chosen: impl Fn(usize) -> bool,
    known: impl Fn(usize) -> Option<Vector3<f64>>,
) -> Result<Vec<Compared>, TrackError> {
    motion.readings.retain(|r| chosen(r.reading));
    Ok(SessionGroove::new(system, motion, known)?.1.compared)
}

impl SessionGroove {
    /// A session's readings through a calibration, in order of time, with their contacts; `known`
    /// gives the groove's place by reading of the system's path, and is asked of it after every
    /// answer.
    ///
    /// # Errors
    /// Where the axes of the moments, moments or motion cannot be used.
    pub fn new(
        system: &WhiskerSystem,
        motion: GrooveMotion,
        known: impl Fn(usize) -> Option<Vector3<f64>>,
    ) -> Result<(Vec<Reading>, Self), TrackError> {
        let (whisker, axes) = (&system.data.whisker, &system.data.moments);
        let mut wires = motion.changed.iter().chain([&motion.wire]);
        // The clamp of an accepted wire yields about the base's axes.
        let frame = if wires.any(|w| w.rod.compliance_rad_per_nmm != 0.0) {
            WireFrame::default()
        } else {
            WireFrame::new(whisker, axes)?
        };
        let (wires, seen) = ((&motion.wire, &motion.changed[..]), (&frame, axes));
        let wire = CalibratedWire::of_session(wires, seen, whisker.diameter_mm);
        let correlated = |[variance_share, time_constant_s]: [f64; 2]| CorrelatedNoise::InTime {
            variance_share,
            time_constant_s,
        };
        let settings = Settings {
            correlated: motion.correlated.map(correlated),
            ..Settings::default()
        };
        let trajectory = |r: &ReadingWithMotion| &system.data.trajectories[r.line];
        let one = |r| reading(r, trajectory(r).direction, system.row(r.reading).point);
        let readings: Vec<Reading> = motion.readings.iter().map(one).collect();
        let mut lines: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (k, r) in motion.readings.iter().enumerate() {
            lines.entry(r.line).or_default().push(k);
        }
        let located = |numbers: Vec<usize>| {
            let trajectory = trajectory(&motion.readings[numbers[0]]).clone();
            // The stage is where it says that it is, by the readings' clock.
            let exact = MotionAccuracy::default();
            let row = |k: &usize| wire.row(&in_wire_frame(&frame, &readings[*k]), &exact);
            let episode = Episode {
                rows: numbers.iter().filter_map(row).collect(),
                push: Some(frame.rotation() * trajectory.direction),
            };
            Ok(TrajectoryContact {
                found: estimate_contact(&wire.field, &episode, &settings)?,
                trajectory,
                numbers,
                episode,
            })
        };
        let contacts: Vec<TrajectoryContact> = lines
            .into_par_iter()
            .map(|(_, numbers)| located(numbers))
            .collect::<Result<_, TrackError>>()?;
        let mut compared = Vec::new();
        for contact in &contacts {
            let TrajectoryContact {
                trajectory,
                numbers,
                episode,
                found,
            } = contact;
            let path = ContactPath::new(&wire.field, episode);
            let Some((posterior, path)) = found.posterior.as_ref().zip(path) else {
                continue;
            };
            let mut bound = None;
            for (k, (number, place)) in numbers.iter().zip(&found.places).enumerate() {
                let r = &motion.readings[*number];
                let groove = known(r.reading).filter(|_| !r.rest);
                let Some((groove, at)) = groove.zip(place.place_mm) else {
                    continue;
                };
                // The effects of stage and place move the groove from where it is stated.
                let moved = trajectory.direction * r.added_mm + motion.wire.offset_mm;
                let truth = frame.rotation() * (groove + moved);
                // The push may pass the curved wire more than once: the nominal arc length decides.
                let Some(state) = path.state_of(&truth, k, trajectory.nominal_arclength_mm) else {
                    continue;
                };
                // The state is the same at every reading of a trajectory: one bound stands for all.
                if bound.is_none() {
                    let of = |episode| bound_mm(&wire.field, episode, &settings, &state);
                    bound = of(episode)?.zip(of(&noiseless(episode))?);
                }
                let Some((bound_mm, bound_by_map_mm)) = bound else {
                    continue;
                };
                compared.push(Compared {
                    reading: r.reading,
                    moved_mm: moved.norm(),
                    trajectory: trajectory.id,
                    arclength_mm: state.s_mm,
                    error_mm: (at - truth).norm(),
                    bound_mm,
                    bound_by_map_mm,
                    moment_nmm: largest_moment(episode),
                    held: posterior.holds(&state),
                    doubted: found.disagrees(),
                });
            }
        }
        let own = Self {
            groove: groove_tracking(&compared, "fit"),
            frame,
            contacts,
            compared,
        };
        Ok((readings, own))
    }
}

/// Places that the tracker finds through a calibration beside the groove's, on the `chosen`
/// readings of a system; none where the stage's way is not recorded, or the wire cannot be bent.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn groove_places(
    system: &WhiskerSystem,
    model: &PhysicalModel,
    chosen: impl Fn(usize) -> bool,
) -> Result<Vec<Compared>, TrackError> {
    let mut readings = 0..system.path.readings.len();
    let recorded =
        readings.all(|i| system.path.readings[i].rest || system.row(i).stage_mm.is_some());
    let Some(motion) = model.groove_motion(system).filter(|_| recorded) else {
        return Ok(Vec::new());
    };
    compared(system, motion, chosen, |i| system.row(i).groove_mm)
}

/// Loaded readings among the `chosen`, whose groove is stated.
pub fn count_loaded(system: &WhiskerSystem, chosen: impl Fn(usize) -> bool) -> usize {
    let stated = |i: &usize| !system.path.readings[*i].rest && system.row(*i).groove_mm.is_some();
    (0..system.path.readings.len())
        .filter(|i| chosen(*i))
        .filter(stated)
        .count()
}

/// Contacts of all open trajectories by the declared and the accepted model, each left out in turn.
///
/// # Errors
/// As [`groove_places`].
pub fn left_out_places(
    decision: &Decision<WhiskerSystem>,
) -> Result<[Vec<Compared>; 2], TrackError> {
    let of_fold = |fold: &FoldCalibrations<'_, WhiskerSystem>| {
        let readings = &fold.model.path.readings;
        let group = readings
            .iter()
            .zip(&fold.left_out)
            .find(|(_, out)| **out)
            .map(|(r, _)| r.group);
        // Its readings at rest stand in every fit, and say where its contact begins.
        let own = |i: usize| Some(readings[i].group) == group;
        let places = |model: &PhysicalModel| groove_places(fold.model, model, own);
        Ok([places(&fold.declared)?, places(&fold.chosen)?])
    };
    let folds = decision.fold_calibrations();
    let each = folds
        .par_iter()
        .map(of_fold)
        .collect::<Result<Vec<_>, TrackError>>()?;
    let of = |k: usize| {
        each.iter()
            .flat_map(|places: &[Vec<Compared>; 2]| places[k].clone())
            .collect()
    };
    Ok([of(0), of(1)])
}

/// A reading along the way of its trajectory, base frame.
fn reading(r: &ReadingWithMotion, direction: Vector3<f64>, point: i64) -> Reading {
    let sd = |c: usize| {
        let shared: f64 = r.shared_nmm.iter().map(|h| h[c] * h[c]).sum();
        (r.noise_nmm2[(c, c)] + shared).sqrt()
    };
    // Each mounting has the zero of its rest readings, whose error is one of the calibration's
    // unknowns.
    let moments = Moments {
        moment_nmm: r.moment_nmm,
        sd_nmm: [sd(0), sd(1)],
        valid: r.valid,
        pose_nmm2: r.noise_nmm2,
        shared_nmm: r.shared_nmm.clone(),
        ..Moments::default()
    };
    let motion = RowMotion {
        moved_mm: direction * r.stage_mm,
        turn: Rotation3::identity(),
        velocity_mm_s: direction * r.velocity_mm_s,
        piece: r.line as u32,
        push: Some(direction),
    };
    let by_unknowns = r.shared_displacement_mm.iter();
    Reading {
        motion: Ok(motion),
        shared_displacement_mm: by_unknowns.map(|w| direction * *w).collect(),
        visit: r.contact_segment,
        in_prefix: r.rest,
        ..Reading::alone(point, r.t_s, Some(moments))
    }
}

/// An episode as readings without noise of their own would have it.
fn noiseless(episode: &Episode) -> Episode {
    const SHARE: f64 = 1e-6;
    let mut quiet = episode.clone();
    quiet
        .rows
        .iter_mut()
        .for_each(|row| row.noise_nmm2 *= SHARE);
    quiet
}

/// Size of the largest moment, and its standard deviation by the calibration's common unknowns, N
/// mm.
fn largest_moment(episode: &Episode) -> [f64; 2] {
    let size = |r: &MotionRow| squares(&[r.moment_nmm]).sqrt();
    let rows = episode.rows.iter();
    let largest = rows.max_by(|a, b| size(a).total_cmp(&size(b)));
    largest.map_or([0.0; 2], |r| {
        let [y, z] = r.moment_nmm;
        // Of a common error the part along the moment changes its size, to first order.
        let along = |h: &[f64; 2]| (h[0] * y + h[1] * z) / size(r).max(1e-12);
        let squares = r.shared_nmm.iter().map(|h| along(h).powi(2));
        [size(r), squares.sum::<f64>().sqrt()]
    })
}

impl Estimator for SessionGroove {
    /// All readings are known, and so are their contacts.
    fn push(&mut self, _: &Reading) -> Result<Vec<Contact>, TrackError> {
        Ok(Vec::new())
    }

    fn finish(&mut self) -> Result<Vec<Contact>, TrackError> {
        let mut all = BTreeMap::new();
        for contact in &self.contacts {
            let disagrees = contact.found.disagrees();
            let each = contact.episode.rows.iter().zip(&contact.found.places);
            for (number, (row, place)) in contact.numbers.iter().zip(each) {
                // Outside of a contact nothing is in doubt.
                let flags = if disagrees && (loaded(row) || place.contact > 0.5) {
                    Flags::MOTION_DISAGREES
                } else {
                    Flags::default()
                };
                let way = [(1.0, place.clone())];
                all.insert(*number, Contact::averaged(&way, flags, |_| !disagrees));
            }
        }
        Ok(all.into_values().collect())
    }

    fn findings(&self) -> Findings {
        let of = |c: &TrajectoryContact| ContactDocument {
            trajectory: Some(c.trajectory.id),
            regions: c.found.posterior.as_ref().map(Posterior::regions),
            ..ContactDocument::new(&c.found.innovations, c.numbers.len())
        };
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            trajectories: Some(self.contacts.iter().map(of).collect()),
            ..EstimatorDocument::default()
        };
        let disagreement = |c: &TrajectoryContact| {
            let (id, said) = (c.trajectory.id, c.found.innovations.sentence()?);
            Some(format!(
                "trajectory {id}: {said}; marked motion-disagrees in status"
            ))
        };
        let mut messages: Vec<String> = self.contacts.iter().filter_map(disagreement).collect();
        let doubt = !messages.is_empty();
        messages.extend(self.groove.as_ref().map(groove_sentence));
        Findings {
            document,
            messages,
            doubt,
            groove: Some(self.groove.clone()),
            ..Findings::default()
        }
    }
}
