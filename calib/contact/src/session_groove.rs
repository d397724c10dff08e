//! Contact places of a session from its moments and the known way of the groove, and how far they are from the groove.

#[cfg(test)]
mod session_groove_test;

use crate::ContactError;
use crate::calibrated_wire::moment_field;
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings};
use crate::frame::in_base_frame;
use crate::groove_comparison::{Compared, coverage_rejected, groove_sentence, groove_tracking};
use crate::known_motion::contact_path::ContactPath;
use crate::known_motion::{
    CorrelatedNoise, Episode, EpisodeContact, EpisodeEstimate, MomentField, MotionRow, Posterior, Settings,
    bound_mm, estimate_contact,
};
use crate::reading::{Moments, Reading};
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::{Matrix2, Rotation3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_core::observation::MomentAxes;
use wcal_core::stream::Flags;
use wcal_core::verify_document::GrooveTracking;
use wcal_core::{Role, WhiskerData, WhiskerRow, WireFrame};
use wcal_trace::whisker::WhiskerSystem;
use wcal_trace::whisker::groove_motion::{AcceptedWire, GrooveMotion, ReadingWithMotion};

/// The rows of a session without the groove's place, so that no answer can come from it; their order stays.
///
/// # Errors
/// Where a loaded row has no stage position, or stands on a trajectory that the session does not describe.
pub fn without_groove(data: &WhiskerData) -> Result<WhiskerData, ContactError> {
    let mut blind = data.clone();
    for row in &mut blind.rows {
        let place = |row: &WhiskerRow| format!("{}: line {}", row.source, row.line);
        if row.role != Role::Rest {
            if row.stage_mm.is_none() {
                let what = format!("{}: stage_mm", place(row));
                return Err(ContactError::value(what, "a position (the way of the groove)", "none"));
            }
            if row.trajectory.and_then(|id| data.trajectory(id)).is_none() {
                let what = format!("{}: trajectory", place(row));
                return Err(ContactError::value(what, "one with a direction in session.toml", "none"));
            }
        }
        row.groove_mm = None;
    }
    Ok(blind)
}

/// A trajectory's readings with what was found.
pub struct TrackedTrajectory {
    /// Identifier of the session.
    pub id: u32,
    /// Readings in order of time.
    pub readings: Vec<ReadingWithMotion>,
    /// What they tell.
    pub found: EpisodeEstimate,
    episode: Episode,
}

impl TrackedTrajectory {
    /// The episode as readings without noise of their own would have it.
    fn noiseless(&self) -> Episode {
        const SHARE: f64 = 1e-6;
        let mut episode = self.episode.clone();
        for row in &mut episode.rows {
            row.noise_nmm2 *= SHARE;
        }
        episode
    }

    /// Size of the largest moment, and its standard deviation by the calibration's common unknowns, N mm.
    fn largest_moment(&self) -> [f64; 2] {
        let size = |r: &MotionRow| r.moment_nmm[0].hypot(r.moment_nmm[1]);
        let largest = self.episode.rows.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
        largest.map_or([0.0; 2], |r| {
            let along = |h: &[f64; 2]| (h[0] * r.moment_nmm[0] + h[1] * r.moment_nmm[1]) / size(r).max(1e-12);
            [size(r), r.shared_nmm.iter().map(|h| along(h).powi(2)).sum::<f64>().sqrt()]
        })
    }
}

/// A session whose contact was located.
pub struct TrackedSession {
    field: MomentField,
    frame: WireFrame,
    wire: AcceptedWire,
    settings: Settings,
    /// Trajectories in the session's order.
    pub trajectories: Vec<TrackedTrajectory>,
}

/// The frame of a session's wire; the base's own where the clamp of an accepted wire yields, which is given about the base's axes.
fn session_frame(
    system: &WhiskerSystem,
    wire: &AcceptedWire,
    changed: &[AcceptedWire],
) -> Result<WireFrame, ContactError> {
    let yields = |w: &AcceptedWire| w.rod.compliance_rad_per_nmm != 0.0;
    if yields(wire) || changed.iter().any(yields) {
        return Ok(WireFrame::default());
    }
    WireFrame::new(&system.data.whisker, &system.data.moments)
        .map_err(|e| ContactError::value(e.key, e.expected, e.found))
}

/// The moments of a wire of a session in a frame.
fn turned_field(wire: &AcceptedWire, frame: &WireFrame, axes: &MomentAxes) -> MomentField {
    match wire.rod.turned(&frame.rotation()).filter(|_| !frame.is_base()) {
        Some(rod) => moment_field(&AcceptedWire { rod, ..wire.clone() }, &MomentAxes::default()),
        None => moment_field(wire, axes),
    }
}

/// Locates the contact on each trajectory; `chosen` tells which readings of the system's path are used.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn track(
    system: &WhiskerSystem,
    motion: GrooveMotion,
    chosen: impl Fn(usize) -> bool,
) -> Result<TrackedSession, ContactError> {
    let GrooveMotion { wire, changed, readings, correlated } = motion;
    let correlated = correlated
        .map(|[variance_share, time_constant_s]| CorrelatedNoise::InTime { variance_share, time_constant_s });
    let settings = Settings { correlated, ..Settings::default() };
    let frame = session_frame(system, &wire, &changed)?;
    let table = |wire: &AcceptedWire| turned_field(wire, &frame, &system.data.moments);
    let field = table(&wire).with_changed(changed.iter().map(table).collect());
    let mut by_line: BTreeMap<usize, Vec<ReadingWithMotion>> = BTreeMap::new();
    for reading in readings.into_iter().filter(|r| chosen(r.reading)) {
        by_line.entry(reading.line).or_default().push(reading);
    }
    let located =
        |(line, readings): (usize, Vec<ReadingWithMotion>)| -> Result<TrackedTrajectory, ContactError> {
            let trajectory = &system.data.trajectories[line];
            let direction = frame.rotation() * trajectory.direction;
            let rows: Vec<MotionRow> = readings
                .iter()
                .map(|r| MotionRow {
                    t_s: r.t_s,
                    moment_nmm: frame.moment(r.moment_nmm),
                    noise_nmm2: frame.covariance(&r.noise_nmm2),
                    shared_nmm: r.shared_nmm.iter().map(|h| frame.moment(*h)).collect(),
                    free_nmm2: None,
                    shared_displacement_mm: r.shared_displacement_mm.iter().map(|w| direction * *w).collect(),
                    moved_mm: direction * r.stage_mm,
                    velocity_mm_s: direction * r.velocity_mm_s,
                    moved_sd_mm: 0.0,
                    turn: Rotation3::identity(),
                    free: r.rest,
                    contact_segment: r.contact_segment,
                })
                .collect();
            let episode = Episode { rows, push: Some(direction) };
            let found = estimate_contact(&field, &episode, &settings)?;
            Ok(TrackedTrajectory { id: trajectory.id, readings, found, episode })
        };
    let trajectories = by_line.into_par_iter().map(located).collect::<Result<Vec<_>, ContactError>>()?;
    Ok(TrackedSession { field, frame, wire, settings, trajectories })
}

impl TrackedSession {
    /// What is stated of each reading of the system's path.
    fn contacts(&self) -> BTreeMap<usize, Contact> {
        let of = |t: &TrackedTrajectory| -> Vec<(usize, Contact)> {
            let flags = if t.found.disagrees() { Flags::MOTION_DISAGREES } else { Flags::default() };
            let regions = t.found.posterior.as_ref().map(Posterior::regions).unwrap_or_default();
            let at = |(r, p): (&ReadingWithMotion, &EpisodeContact)| {
                let estimate = ContactEstimate::of_place(p).map(|e| in_base_frame(&self.frame, e));
                (r.reading, Contact { estimate, flags, regions: regions.clone(), ..Contact::default() })
            };
            t.readings.iter().zip(&t.found.places).map(at).collect()
        };
        self.trajectories.iter().flat_map(of).collect()
    }

    /// The places beside the groove's, which `groove` gives by reading where it is known; in the order of the trajectories.
    ///
    /// # Errors
    /// Where the bound cannot be computed.
    pub fn compared(
        &self,
        system: &WhiskerSystem,
        groove: impl Fn(usize) -> Option<Vector3<f64>>,
    ) -> Result<Vec<Compared>, ContactError> {
        let settings = self.settings;
        let mut all = Vec::new();
        for t in &self.trajectories {
            let Some(posterior) = &t.found.posterior else { continue };
            let Some(path) = ContactPath::new(&self.field, &t.episode) else { continue };
            let mut bound = None;
            for (k, (reading, place)) in t.readings.iter().zip(&t.found.places).enumerate() {
                let (Some(groove), Some(at)) = (groove(reading.reading), place.place_mm) else { continue };
                if reading.rest {
                    continue;
                }
                let trajectory = &system.data.trajectories[reading.line];
                let truth = groove + trajectory.direction * reading.added_mm + self.wire.offset_mm;
                let truth = self.frame.rotation() * truth;
                let Some(state) = path.state_of(&truth, k, trajectory.nominal_arclength_mm) else { continue };
                if bound.is_none() {
                    let of = |episode| bound_mm(&self.field, episode, &settings, &state);
                    bound = of(&t.episode)?.zip(of(&t.noiseless())?);
                }
                let Some((bound_mm, bound_by_map_mm)) = bound else { continue };
                all.push(Compared {
                    trajectory: t.id,
                    arclength_mm: state.s_mm,
                    error_mm: (at - truth).norm(),
                    bound_mm,
                    bound_by_map_mm,
                    moment_nmm: t.largest_moment(),
                    held: posterior.holds(&state),
                    doubted: t.found.disagrees(),
                });
            }
        }
        Ok(all)
    }
}

/// A session along the known way of its groove, as an estimator: all readings are known beforehand.
pub struct SessionGroove {
    tracked: TrackedSession,
    /// Number of each reading in the system's path, in order of time.
    order: Vec<usize>,
    /// The comparison with the groove, once its place may be known.
    groove: Option<GrooveTracking>,
}

/// A session's readings through a calibration, in order of time, with the estimator that knows their motion.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn session_readings(
    system: &WhiskerSystem,
    motion: GrooveMotion,
) -> Result<(Vec<Reading>, SessionGroove), ContactError> {
    let one = |r: &ReadingWithMotion| {
        let sd = |c: usize| {
            let shared: f64 = r.shared_nmm.iter().map(|h| h[c] * h[c]).sum();
            (r.noise_nmm2[(c, c)] + shared).sqrt()
        };
        let moments = Moments {
            moment_nmm: r.moment_nmm,
            sd_nmm: [sd(0), sd(1)],
            valid: r.valid,
            pose_nmm2: r.noise_nmm2,
            own_nmm2: None,
            drift_nmm2: Matrix2::zeros(),
            zero_nmm2: Matrix2::zeros(),
            shared_nmm: r.shared_nmm.clone(),
        };
        // Each trajectory has its own way, which the estimator knows.
        Reading::alone(system.row(r.reading).point, r.t_s, Some(moments))
    };
    let readings = motion.readings.iter().map(one).collect();
    let order = motion.readings.iter().map(|r| r.reading).collect();
    let tracked = track(system, motion, |_| true)?;
    Ok((readings, SessionGroove { tracked, order, groove: None }))
}

impl SessionGroove {
    /// Compares the answers with the groove, whose place `known` gives by reading of the system's path.
    ///
    /// # Errors
    /// Where the bound cannot be computed.
    pub fn compare(
        &mut self,
        system: &WhiskerSystem,
        known: impl Fn(usize) -> Option<Vector3<f64>>,
    ) -> Result<Option<GrooveTracking>, ContactError> {
        self.groove = groove_tracking(&self.tracked.compared(system, known)?, "fit");
        Ok(self.groove.clone())
    }
}

impl Estimator for SessionGroove {
    fn push(&mut self, _: &Reading) -> Result<Vec<Contact>, ContactError> {
        Ok(Vec::new())
    }

    fn finish(&mut self) -> Result<Vec<Contact>, ContactError> {
        let mut contacts = self.tracked.contacts();
        Ok(self.order.iter().map(|r| contacts.remove(r).unwrap_or_default()).collect())
    }

    fn findings(&self) -> Findings {
        let each = || self.tracked.trajectories.iter();
        let of = |t: &TrackedTrajectory| ContactDocument::of_trajectory(t.id, &t.found, t.readings.len());
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            trajectories: Some(each().map(of).collect()),
            ..EstimatorDocument::default()
        };
        let disagreement = |t: &TrackedTrajectory| {
            let said = t.found.innovations.sentence()?;
            Some(format!("trajectory {}: {said}; marked motion-disagrees in status", t.id))
        };
        let mut messages: Vec<String> = each().filter_map(disagreement).collect();
        let doubt = !messages.is_empty();
        messages.extend(self.groove.as_ref().map(groove_sentence));
        let coverage_rejected = self.groove.as_ref().is_some_and(coverage_rejected);
        Findings { document, messages, doubt, coverage_rejected, ..Findings::default() }
    }
}
