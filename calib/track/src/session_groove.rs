//! Contact places of a session from its moments and the known way of the groove, and how far they
//! are from the groove.

#[cfg(test)]
mod session_groove_test;

use crate::TrackError;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, Estimator, Findings};
use crate::frame::in_wire_frame;
use crate::groove_comparison::{Compared, groove_sentence, groove_tracking};
use crate::known_motion::contact_path::ContactPath;
use crate::known_motion::{CorrelatedNoise, Episode, MotionRow, bound_mm};
use crate::reading::{Moments, Reading, RowMotion};
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use crate::tracker::ContactTracker;
use crate::whole_contact::WholeContact;
use nalgebra::{Matrix2, Rotation3, Vector3};
use wcal_core::observation::Trajectory;
use wcal_core::verify_document::GrooveTracking;
use wcal_core::{Role, WhiskerData, WhiskerRow, WireFrame};
use wcal_verify::whisker::WhiskerSystem;
use wcal_verify::whisker::groove_motion::{GrooveMotion, ReadingWithMotion};

/// The rows of a session without the groove's place, so that no answer can come from it; their
/// order stays.
///
/// # Errors
/// Where a loaded row has no stage position, or stands on a trajectory that the session does not
/// describe.
pub fn without_groove(data: &WhiskerData) -> Result<WhiskerData, TrackError> {
    let mut blind = data.clone();
    for row in &mut blind.rows {
        let place = |row: &WhiskerRow| format!("{}: line {}", row.source, row.line);
        if row.role != Role::Rest {
            if row.stage_mm.is_none() {
                let what = format!("{}: stage_mm", place(row));
                return Err(TrackError::value(
                    what,
                    "a position (the way of the groove)",
                    "none",
                ));
            }
            if row.trajectory.and_then(|id| data.trajectory(id)).is_none() {
                let what = format!("{}: trajectory", place(row));
                return Err(TrackError::value(
                    what,
                    "one with a direction in session.toml",
                    "none",
                ));
            }
        }
        row.groove_mm = None;
    }
    Ok(blind)
}

/// A session along the known way of its groove.
pub struct SessionGroove {
    /// Frame of its wire.
    pub frame: WireFrame,
    tracker: ContactTracker,
    trajectories: Vec<Trajectory>,
    /// Readings in order of time, with the place of the groove where it is known; it is looked at
    /// after every answer.
    readings: Vec<(ReadingWithMotion, Option<Vector3<f64>>)>,
    /// What the calibration adds to the declared place of the groove, mm.
    offset_mm: Vector3<f64>,
    groove: Option<GrooveTracking>,
}

/// Places that are found on those of a session's readings that are `chosen` of the system's path,
/// beside the groove's, which `known` gives.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn compared(
    system: &WhiskerSystem,
    motion: GrooveMotion,
    chosen: impl Fn(usize) -> bool,
    known: impl Fn(usize) -> Option<Vector3<f64>>,
) -> Result<Vec<Compared>, TrackError> {
    let readings = motion
        .readings
        .into_iter()
        .filter(|r| chosen(r.reading))
        .collect();
    let (readings, mut own) =
        SessionGroove::new(system, GrooveMotion { readings, ..motion }, known)?;
    for reading in &readings {
        own.push(&in_wire_frame(&own.frame.clone(), reading))?;
    }
    own.tracker.finish()?;
    own.compared()
}

impl SessionGroove {
    /// A session's readings through a calibration, in order of time, with what locates their
    /// contacts; `known` gives the groove's place by reading of the system's path.
    ///
    /// # Errors
    /// Where the axes of the moments cannot be used.
    pub fn new(
        system: &WhiskerSystem,
        motion: GrooveMotion,
        known: impl Fn(usize) -> Option<Vector3<f64>>,
    ) -> Result<(Vec<Reading>, Self), TrackError> {
        let GrooveMotion {
            wire,
            changed,
            readings,
            correlated,
        } = motion;
        let (whisker, axes) = (&system.data.whisker, &system.data.moments);
        // The clamp of an accepted wire yields about the base's axes.
        let frame = match changed
            .iter()
            .chain([&wire])
            .any(|w| w.rod.compliance_rad_per_nmm != 0.0)
        {
            true => WireFrame::default(),
            false => WireFrame::new(whisker, axes)
                .map_err(|e| TrackError::value(e.key, e.expected, e.found))?,
        };
        let correlated =
            correlated.map(
                |[variance_share, time_constant_s]| CorrelatedNoise::InTime {
                    variance_share,
                    time_constant_s,
                },
            );
        let offset_mm = wire.offset_mm;
        let wire =
            CalibratedWire::of_session((&wire, &changed), (&frame, axes), whisker.diameter_mm);
        let own = Self {
            tracker: ContactTracker::of_session(wire, correlated),
            trajectories: system.data.trajectories.clone(),
            readings: readings
                .into_iter()
                .map(|r| (known(r.reading), r))
                .map(|(p, r)| (r, p))
                .collect(),
            frame,
            offset_mm,
            groove: None,
        };
        let one = |(r, _): &(ReadingWithMotion, _)| own.reading(r, system.row(r.reading).point);
        Ok((own.readings.iter().map(one).collect(), own))
    }

    /// A reading along the way of its trajectory, base frame.
    fn reading(&self, r: &ReadingWithMotion, point: i64) -> Reading {
        let sd = |c: usize| {
            let shared: f64 = r.shared_nmm.iter().map(|h| h[c] * h[c]).sum();
            (r.noise_nmm2[(c, c)] + shared).sqrt()
        };
        let moments = Moments {
            moment_nmm: r.moment_nmm,
            sd_nmm: [sd(0), sd(1)],
            valid: r.valid,
            pose_nmm2: r.noise_nmm2,
            shared_nmm: r.shared_nmm.clone(),
            ..Moments::default()
        };
        let direction = self.trajectories[r.line].direction;
        let motion = RowMotion {
            moved_mm: direction * r.stage_mm,
            turn: Rotation3::identity(),
            velocity_mm_s: direction * r.velocity_mm_s,
            piece: r.line as u32,
            push: Some(direction),
        };
        Reading {
            motion: Ok(motion),
            shared_displacement_mm: r
                .shared_displacement_mm
                .iter()
                .map(|w| direction * *w)
                .collect(),
            visit: r.contact_segment,
            in_prefix: r.rest,
            ..Reading::alone(point, r.t_s, Some(moments))
        }
    }

    /// Index of the trajectory of a contact.
    fn line(&self, contact: &WholeContact) -> usize {
        self.readings[contact.numbers[0]].0.line
    }

    /// The places that were found beside the groove's; in the order of the trajectories.
    fn compared(&self) -> Result<Vec<Compared>, TrackError> {
        let (of, contacts) = self.tracker.whole_contacts();
        let (field, settings) = (&of.wire.field, of.settings);
        let mut all = Vec::new();
        for contact in contacts {
            let (found, episode) = (contact.point(), &contact.episode);
            let Some(posterior) = &found.posterior else {
                continue;
            };
            let Some(path) = ContactPath::new(field, episode) else {
                continue;
            };
            let trajectory = &self.trajectories[self.line(contact)];
            let mut bound = None;
            for (k, (number, place)) in contact.numbers.iter().zip(&found.places).enumerate() {
                let (reading, groove) = &self.readings[*number];
                let Some((groove, at)) = groove.zip(place.place_mm).filter(|_| !reading.rest)
                else {
                    continue;
                };
                let moved = trajectory.direction * reading.added_mm + self.offset_mm;
                let truth = self.frame.rotation() * (groove + moved);
                let Some(state) = path.state_of(&truth, k, trajectory.nominal_arclength_mm) else {
                    continue;
                };
                if bound.is_none() {
                    let of = |episode| bound_mm(field, episode, &settings, &state);
                    bound = of(episode)?.zip(of(&noiseless(episode))?);
                }
                let Some((bound_mm, bound_by_map_mm)) = bound else {
                    continue;
                };
                all.push(Compared {
                    reading: reading.reading,
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
        Ok(all)
    }
}

/// An episode as readings without noise of their own would have it.
fn noiseless(episode: &Episode) -> Episode {
    const SHARE: f64 = 1e-6;
    let quiet = |row: &MotionRow| MotionRow {
        noise_nmm2: row.noise_nmm2 * SHARE,
        ..row.clone()
    };
    Episode {
        rows: episode.rows.iter().map(quiet).collect(),
        push: episode.push,
    }
}

/// Size of the largest moment, and its standard deviation by the calibration's common unknowns, N
/// mm.
fn largest_moment(episode: &Episode) -> [f64; 2] {
    let size = |r: &MotionRow| r.moment_nmm[0].hypot(r.moment_nmm[1]);
    let largest = episode
        .rows
        .iter()
        .max_by(|a, b| size(a).total_cmp(&size(b)));
    largest.map_or([0.0; 2], |r| {
        let along =
            |h: &[f64; 2]| (h[0] * r.moment_nmm[0] + h[1] * r.moment_nmm[1]) / size(r).max(1e-12);
        [
            size(r),
            r.shared_nmm
                .iter()
                .map(|h| along(h).powi(2))
                .sum::<f64>()
                .sqrt(),
        ]
    })
}

impl Estimator for SessionGroove {
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, TrackError> {
        // Each mounting has the zero of its rest readings, whose error is one of the calibration's
        // unknowns.
        let zero_nmm2 = Matrix2::zeros();
        let moments = reading.moments.clone().map(|m| Moments { zero_nmm2, ..m });
        self.tracker.push(&Reading {
            moments,
            ..reading.clone()
        })
    }

    fn finish(&mut self) -> Result<Vec<Contact>, TrackError> {
        let contacts = self.tracker.finish()?;
        self.groove = groove_tracking(&self.compared()?, "fit");
        // A trajectory is no separate contact.
        Ok(contacts
            .into_iter()
            .map(|c| Contact { number: None, ..c })
            .collect())
    }

    fn findings(&self) -> Findings {
        let contacts = self.tracker.whole_contacts().1;
        let id = |c: &WholeContact| self.trajectories[self.line(c)].id;
        let of =
            |c: &WholeContact| ContactDocument::of_trajectory(id(c), c.point(), c.numbers.len());
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            trajectories: Some(contacts.iter().map(of).collect()),
            ..EstimatorDocument::default()
        };
        let disagreement = |c: &WholeContact| {
            let said = c.point().innovations.sentence()?;
            Some(format!(
                "trajectory {}: {said}; marked motion-disagrees in status",
                id(c)
            ))
        };
        let mut messages: Vec<String> = contacts.iter().filter_map(disagreement).collect();
        let doubt = !messages.is_empty();
        messages.extend(self.groove.as_ref().map(groove_sentence));
        let groove = Some(self.groove.clone());
        Findings {
            document,
            messages,
            doubt,
            groove,
            ..Findings::default()
        }
    }
}
