//! The smallest error that a tracker of a sweep can have: the posterior Cramer-Rao bound of a contact that slides over a rigid object.
//!
//! State at sample k: place q on the curve of inverse solutions (nodes; along the wire, past its end the tilt of the force), true moments mu,
//! velocity v = dq/dz by the base's travel z, base speed u, zero b of the moments; and theta, what all readings of a calibration share:
//!
//! ```text
//! contact       p = p(q, mu),  n = n(q, mu)                       point and direction of the force (`StaticInverse`)
//! constraint    n . (p' - p + z e_z)        = w_n z               rigid object at rest; n the mean direction of both samples
//! turn          a . (n' - n)                = w_t z               a: axis across wire and force
//! path          (q' - q) / z = v',   v' - v = w_v                 velocity along the wire persists
//! base, zero    u' - u = w_u,   b' - b = w_b,   z = u' dt
//! measurement   y = mu + b + sum_j h_j theta_j + noise
//! ```
//!
//! Recursion, with A, C, B the blocks (before, before), (before, now), (now, now) of the transition's and measurement's information
//! `sum_i I_i r_i r_i'` (r_i: derivatives of relation i; I_i: Fisher information of its density's location):
//!
//! ```text
//! J' = B - C' (J + A)^-1 C,        E[(p^ - p)(p^ - p)'] >= T [J^-1] T',   T = dp/d(q, mu)
//! ```
//!
//! Source: P. Tichavsky, C. H. Muravchik, A. Nehorai, IEEE Trans. Signal Process. 46 (1998) 1386, eq. 21. The densities of w_n, w_t and w_v are
//! those of the sweeps in question ([`transition`]); independent errors add by Stam's inequality, 1 / I(x + y) >= 1 / I(x) + 1 / I(y) (A. J. Stam,
//! Inform. Control 2 (1959) 101), so that the bound stays one. The bound takes as known what no tracker knows: when the wire touches,
//! jumps or slips, the densities themselves, and that friction is what it is. At first touch q has the variance that it has in the sweeps, and
//! the deflection is uniform up to the base's travel z (information 12 / z^2 of its variance). It is evaluated at the true contacts
//! and holds for small errors: at first touches and jumps, where it is millimetres wide ([`ContactBound::is_regular`]), it bounds nothing.

mod curve_state;
mod information;
pub mod transition;

use crate::inverse::StaticInverse;
use crate::sweep_series::{SweepSample, SweepSeries};
use curve_state::CurveState;
use information::{Information, Relation, State};
use nalgebra::{Matrix2, Matrix3, Vector3};
use transition::TransitionDensities;

/// Knowledge of moments and motion along a series.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepKnowledge {
    /// Covariance of a reading's own noise, (N mm)^2.
    pub noise_nmm2: Matrix2<f64>,
    /// Standard deviation of the zero of the moments at the start, N mm.
    pub zero_sd_nmm: f64,
    /// Variance by which each zero wanders in a second, (N mm)^2.
    pub drift_nmm2_per_s: f64,
    /// Error of the moments by one standard deviation of each common unknown, at every sample, N mm; empty without common unknowns.
    pub shared_nmm: Vec<Vec<[f64; 2]>>,
    /// Standard deviation of each displacement of the base, mm.
    pub motion_sd_mm: f64,
    /// Range of the base's speed (mm/s) and largest acceleration (mm/s^2) where the speed is not known.
    pub unknown_speed: Option<([f64; 2], f64)>,
}

impl SweepKnowledge {
    /// Of moments with this noise alone, and with the base's speed known or not.
    #[must_use]
    pub fn of_noise(noise_nmm: f64, unknown_speed: Option<([f64; 2], f64)>) -> Self {
        Self {
            noise_nmm2: Matrix2::identity() * noise_nmm * noise_nmm,
            zero_sd_nmm: 0.0,
            drift_nmm2_per_s: 0.0,
            shared_nmm: Vec::new(),
            motion_sd_mm: 0.0,
            unknown_speed,
        }
    }
}

/// Bound at a sample with contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactBound {
    /// Smallest covariance of the contact point, mm^2.
    pub covariance_mm2: Matrix3<f64>,
    /// Direction of the force: across the object's surface where there is no friction.
    pub normal: Vector3<f64>,
}

impl ContactBound {
    /// Smallest RMS error in space, mm.
    #[must_use]
    pub fn contact_mm(&self) -> f64 {
        self.covariance_mm2.trace().max(0.0).sqrt()
    }

    /// Whether the true contact's neighbourhood is all that the bound is about: the curve of inverse solutions is straight over some
    /// millimetres. A wider one says that the motion has not determined the contact yet; what an estimate then makes of the prior is no
    /// matter of derivatives at the truth.
    #[must_use]
    pub fn is_regular(&self) -> bool {
        self.contact_mm() <= MAX_REGULAR_MM
    }

    /// Smallest RMS distance from the surface, mm.
    #[must_use]
    pub fn surface_mm(&self) -> f64 {
        self.normal.dot(&(self.covariance_mm2 * self.normal)).max(0.0).sqrt()
    }
}

/// Information of what is known for certain: standard deviations of 1e-5 (mm/s, N mm).
const CERTAIN: f64 = 1e10;
/// Information that keeps the velocity to the path: a standard deviation of 1e-3 nodes/mm.
const SAME: f64 = 1e6;
/// Largest bound that counts as regular, mm.
const MAX_REGULAR_MM: f64 = 2.0;
/// Smallest travel between two samples, mm.
const MIN_TRAVEL_MM: f64 = 1e-3;

/// A series with its true contacts on the curves of inverse solutions.
#[derive(Debug, Clone)]
pub struct SweepContacts<'a> {
    series: &'a SweepSeries,
    /// None without contact, where several points touch, and where no single contact explains the moments.
    states: Vec<Option<CurveState>>,
}

impl<'a> SweepContacts<'a> {
    /// Of a series whose moments are true.
    #[must_use]
    pub fn new(inverse: &StaticInverse, series: &'a SweepSeries) -> Self {
        let state = |sample: &SweepSample| {
            let single = sample.contact.filter(|_| sample.contacts == 1);
            single.and_then(|truth| CurveState::of_contact(inverse, sample, &truth))
        };
        Self { series, states: series.samples.iter().map(state).collect() }
    }

    /// Bound at each sample; none where there is no single contact on the curve.
    #[must_use]
    pub fn bound(
        &self,
        densities: &TransitionDensities,
        knowledge: &SweepKnowledge,
    ) -> Vec<Option<ContactBound>> {
        let mut recursion = Recursion::new(densities, knowledge);
        let both = self.series.samples.iter().zip(&self.states).enumerate();
        both.map(|(k, (sample, state))| recursion.step(k, sample, state.as_ref())).collect()
    }
}

/// The recursion over one series.
struct Recursion<'a> {
    densities: &'a TransitionDensities,
    knowledge: &'a SweepKnowledge,
    information: Information,
    last: Option<(&'a SweepSample, Option<&'a CurveState>)>,
}

impl<'a> Recursion<'a> {
    fn new(densities: &'a TransitionDensities, knowledge: &'a SweepKnowledge) -> Self {
        let shared = knowledge.shared_nmm.first().map_or(0, Vec::len);
        let mut information = Information::none(shared);
        (0..shared).for_each(|j| information.add_shared(j, 1.0));
        let speed = match knowledge.unknown_speed {
            // A uniform prior counts with its variance.
            Some(([low, high], _)) => 12.0 / (high - low).powi(2),
            None => CERTAIN,
        };
        information.add(State::U, speed);
        let zero = (1.0 / knowledge.zero_sd_nmm.powi(2)).min(CERTAIN);
        [State::BY, State::BZ].into_iter().for_each(|b| information.add(b, zero));
        Self { densities, knowledge, information, last: None }
    }

    fn step(
        &mut self,
        k: usize,
        sample: &'a SweepSample,
        now: Option<&'a CurveState>,
    ) -> Option<ContactBound> {
        let before = self.last.replace((sample, now));
        let dt_s = before.map_or(0.0, |(last, _)| sample.t_s - last.t_s);
        let mut relations = self.base_and_zero(dt_s);
        let smooth = !["onset", "jump", "slip"].contains(&sample.event.as_str());
        match (before.and_then(|(_, from)| from).filter(|_| smooth), now) {
            (Some(from), Some(to)) => relations.extend(self.slide(sample, from, to, dt_s)),
            (None, Some(to)) => relations.extend(self.new_contact(sample, before, to, dt_s)),
            (_, None) => relations.extend(no_contact()),
        }
        self.information = self.information.advanced(&relations)?;
        self.measure(k, now.is_some(), sample.contact.is_none());
        now.and_then(|state| self.bound(state))
    }

    /// Random walks of base speed and zero.
    fn base_and_zero(&self, dt_s: f64) -> Vec<Relation> {
        let speed = match self.knowledge.unknown_speed {
            // A change uniform in [-a dt, a dt].
            Some((_, most_mm_s2)) if dt_s > 0.0 => 3.0 / (most_mm_s2 * dt_s).max(1e-4).powi(2),
            _ => CERTAIN,
        };
        let wander = (1.0 / (self.knowledge.drift_nmm2_per_s * dt_s).max(1e-300)).min(CERTAIN);
        [(State::U, speed), (State::BY, wander), (State::BZ, wander)]
            .map(|(state, information)| Relation::persists(state, information))
            .to_vec()
    }

    /// Relations of a contact that slides from one sample to the next.
    fn slide(&self, sample: &SweepSample, from: &CurveState, to: &CurveState, dt_s: f64) -> Vec<Relation> {
        let travel_mm = (sample.speed_mm_s * dt_s).max(MIN_TRAVEL_MM);
        let path = to.point_mm - from.point_mm + Vector3::z() * travel_mm;
        let normal = (from.normal + to.normal).try_normalize(0.1).unwrap_or(to.normal);
        let d = self.densities;
        // Constraint: derivatives of point and mean direction, and of the travel by the speed.
        let by = |state: &CurveState, sign: f64| -> [f64; 3] {
            let by = (state.point_by.transpose() * normal) * sign + state.normal_by.transpose() * path * 0.5;
            [by.x, by.y, by.z]
        };
        // The displacement is the difference of two places of the base.
        let motion = 2.0 * (self.knowledge.motion_sd_mm * normal.z).powi(2);
        let mut constraint = Relation::new(d.constraint.information_with(travel_mm, motion));
        constraint.before_contact(&by(from, -1.0));
        constraint.now_contact(&by(to, 1.0));
        constraint.now(State::U, normal.z * dt_s);
        let mut relations = vec![constraint];
        if let Some(axis) = to.axis {
            let by = |state: &CurveState, sign: f64| -> [f64; 3] {
                (state.normal_by.transpose() * axis * sign).into()
            };
            let mut turn = Relation::new(d.turn.information_with(travel_mm, 0.0));
            turn.before_contact(&by(from, -1.0));
            turn.now_contact(&by(to, 1.0));
            relations.push(turn);
        }
        // Path along the curve; past the wire's end it is another coordinate.
        let mut along = Relation::new(SAME);
        along.now(State::V, 1.0);
        along.now(State::Q, -1.0 / travel_mm);
        along.before(State::Q, 1.0 / travel_mm);
        along.now(State::U, (to.q - from.q) * dt_s / (travel_mm * travel_mm));
        relations.push(along);
        let velocity = if to.at_tip { &d.tip_velocity } else { &d.wire_velocity };
        match from.at_tip == to.at_tip {
            true => relations.push(Relation::persists(State::V, velocity.information_with(1.0, 0.0))),
            false => relations.push(Relation::prior(State::V, d.velocity_prior())),
        }
        relations
    }

    /// Relations of a contact that begins, or continues elsewhere.
    fn new_contact(
        &self,
        sample: &SweepSample,
        before: Option<(&SweepSample, Option<&CurveState>)>,
        to: &CurveState,
        dt_s: f64,
    ) -> Vec<Relation> {
        let d = self.densities;
        let anywhere = Relation::prior(State::Q, 1.0 / d.onset_variance);
        let mut relations = vec![Relation::prior(State::V, d.velocity_prior())];
        match before {
            // The wire was free: its deflection is at most the base's travel.
            Some((last, None)) if last.contact.is_none() => {
                relations.push(anywhere);
                let depth_mm = (sample.speed_mm_s * dt_s * to.normal.z.abs()).max(MIN_TRAVEL_MM);
                let mut depth = Relation::new(12.0 / (depth_mm * depth_mm));
                depth.now_contact(&to.depth_by);
                relations.push(depth);
            }
            // A jump: the place before is known as well as it was, and the path is drawn from all jumps'.
            Some((_, Some(_))) => {
                let place = self.information.variance(State::Q).unwrap_or(d.onset_variance);
                relations.push(Relation::prior(State::Q, d.jump.information_with(1.0, place)));
            }
            _ => relations.push(anywhere),
        }
        relations
    }

    /// Adds a reading of the moments: those of the contact, or of the free wire.
    fn measure(&mut self, k: usize, contact: bool, free: bool) {
        if !contact && !free {
            // Several points touch: the moments say nothing of one.
            return;
        }
        let Some(own) = self.knowledge.noise_nmm2.cholesky() else { return };
        let white = own.l().try_inverse().unwrap_or_else(Matrix2::identity);
        let shared = self.knowledge.shared_nmm.get(k).filter(|_| contact);
        for row in 0..2 {
            // A whitened reading has unit variance.
            let mut reading = Relation::new(1.0);
            for (c, (mu, b)) in [(State::MY, State::BY), (State::MZ, State::BZ)].into_iter().enumerate() {
                if contact {
                    reading.now(mu, white[(row, c)]);
                }
                reading.now(b, white[(row, c)]);
            }
            for (j, h) in shared.into_iter().flatten().enumerate() {
                reading.shared.push((j, white[(row, 0)] * h[0] + white[(row, 1)] * h[1]));
            }
            self.information.observe(&reading);
        }
    }

    /// `T [J^-1] T'` at a contact.
    fn bound(&self, state: &CurveState) -> Option<ContactBound> {
        let covariance = self.information.contact_covariance()?;
        let covariance_mm2 = state.point_by * covariance * state.point_by.transpose();
        Some(ContactBound { covariance_mm2, normal: state.normal })
    }
}

/// Without a contact its state means nothing: any values that do not touch the rest.
fn no_contact() -> Vec<Relation> {
    State::CONTACT.map(|state| Relation::prior(state, 1.0)).to_vec()
}
