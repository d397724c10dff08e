//! Contacts of a table by its moments alone, where the wire is taken to sweep past an object at rest: continuity of the contact stands for the
//! motion that nobody knows.
//!
//! Hypotheses h: the base travels along +z or -z of the wire's frame at a steady speed. A Bayes filter for each ([`BayesFilter`]) gives the
//! posterior `b_hk(t)` over the nodes of the static inverse and the predictive density of each reading; speed and direction are one unknown of
//! the whole table, so that late readings help the early ones:
//!
//! ```text
//! w_h ~ exp(T sum_t log p(m_t | m_1 .. m_t-1, h)),    u_k(t) = (1 - a) sum_h w_h b_hk(t) + a v_k(t)
//! ```
//!
//! v: what the moments of the reading allow by themselves ([`crate::arc`]); a: probability that the contact does not move as in a sweep; T < 1, since
//! the errors of the filter's model are shared by the readings. The motion stays an assumption: every contact is `motion-assumed`.

use crate::ContactError;
use crate::arc::{allowed_weights, arclength_regions, stated_answer};
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, Message};
use crate::reading::{Moments, Reading};
use crate::static_arc::loaded;
use crate::track_document::{EstimatorDocument, Method, POINT_OF_OBJECT};
use rayon::prelude::*;
use wcal_core::WhiskerSpec;
use wcal_core::stream::Flags;
use wcal_track::filter::{BayesFilter, BayesSettings, ObjectStep};
use wcal_track::network::Prediction;
use wcal_track::{InverseGrid, StaticInverse};

/// Speeds of a sweep, mm/s: those that arms and stages are driven at (2.5 to 7.5).
const SPEEDS_MM_S: [f64; 6] = [2.5, 3.1, 3.9, 4.8, 6.0, 7.5];
/// Weight of a reading's evidence (T), and probability that the contact moves in another way (a). Chosen on simulated sweeps.
const EVIDENCE: f64 = 0.3;
const OTHERWISE: f64 = 0.1;
/// The table of the wire reaches this multiple of the largest moment.
const TABLE_REACH: f64 = 1.05;

/// The estimator of a sweep whose motion is not known.
pub struct SweepFilter {
    whisker: WhiskerSpec,
    readings: Vec<(f64, Option<Moments>)>,
    loaded: usize,
}

/// Posteriors over the nodes by reading, and the evidence, of one hypothesis.
struct Hypothesis {
    posteriors: Vec<Vec<f64>>,
    evidence: f64,
}

impl SweepFilter {
    /// Of a wire.
    #[must_use]
    pub fn new(whisker: &WhiskerSpec) -> Self {
        Self { whisker: whisker.clone(), readings: Vec::new(), loaded: 0 }
    }

    fn run(&self, inverse: &StaticInverse, settings: BayesSettings, speed_mm_s: f64) -> Hypothesis {
        let mut filter = BayesFilter::new(inverse, settings);
        let mut last_s = None;
        let mut found = Hypothesis { posteriors: Vec::with_capacity(self.readings.len()), evidence: 0.0 };
        for (t_s, moments) in &self.readings {
            let Some(m) = moments.as_ref().filter(|m| loaded(m)) else {
                filter = BayesFilter::new(inverse, settings);
                last_s = Some(*t_s);
                found.posteriors.push(Vec::new());
                continue;
            };
            let dt_s = last_s.replace(*t_s).map_or(0.0, |last| t_s - last);
            filter.step_along(dt_s, m.moment_nmm, &ObjectStep::past_base(speed_mm_s * dt_s));
            found.evidence += filter.log_evidence();
            found.posteriors.push(filter.posterior());
        }
        found
    }

    /// The contact at a reading from all hypotheses.
    fn contact(&self, k: usize, inverse: &StaticInverse, all: &[(f64, Hypothesis)]) -> Contact {
        let Some(m) = self.readings[k].1.as_ref().filter(|m| loaded(m)) else { return Contact::default() };
        let (solutions, allowed) = allowed_weights(inverse, m.moment_nmm);
        let mut weights: Vec<f64> = allowed.iter().map(|v| OTHERWISE * v).collect();
        for (w, h) in all {
            let total: f64 = h.posteriors[k].iter().sum();
            // A filter that has lost the contact says what the moments allow.
            let of = if total > 0.0 { &h.posteriors[k] } else { &allowed };
            let share = (1.0 - OTHERWISE) * w / if total > 0.0 { total } else { 1.0 };
            weights.iter_mut().zip(of).for_each(|(u, b)| *u += share * b);
        }
        let answer = stated_answer(&solutions, &weights, m.sd_nmm, &Prediction::unknown());
        let regions = arclength_regions(&inverse.nodes, &answer.weights);
        let estimate = Some(ContactEstimate::from(&answer));
        Contact { estimate, flags: Flags::MOTION_ASSUMED, regions, on_object: true, ..Contact::default() }
    }
}

impl Estimator for SweepFilter {
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, ContactError> {
        self.readings.push((reading.t_s, reading.moments.clone()));
        Ok(Vec::new())
    }

    fn finish(&mut self) -> Result<Vec<Contact>, ContactError> {
        let touching = || self.readings.iter().filter_map(|r| r.1.as_ref()).filter(|m| loaded(m));
        self.loaded = touching().count();
        let largest_nmm = touching().map(|m| m.moment_nmm[0].hypot(m.moment_nmm[1])).fold(0.0, f64::max);
        let grid = InverseGrid::coarse();
        let max_nmm = grid.max_nmm.max(TABLE_REACH * largest_nmm);
        let inverse = StaticInverse::new(&self.whisker, InverseGrid { max_nmm, ..grid })?;
        let noise = |m: &Moments| (0.5 * m.own_nmm2.unwrap_or(m.pose_nmm2).trace()).sqrt();
        let noise_nmm = touching().map(noise).fold(0.0, f64::max);
        let settings = BayesSettings { onset_nmm: 0.0, ..BayesSettings::multi_mu() };
        let settings = BayesSettings { noise_nmm: settings.noise_nmm.max(noise_nmm), ..settings };
        let speeds: Vec<f64> = SPEEDS_MM_S.iter().flat_map(|v| [*v, -*v]).collect();
        let run = |v: &f64| self.run(&inverse, settings, *v);
        let found: Vec<Hypothesis> = speeds.par_iter().map(run).collect();
        let best = found.iter().map(|h| h.evidence).fold(f64::NEG_INFINITY, f64::max);
        let weight = |h: &Hypothesis| (EVIDENCE * (h.evidence - best)).exp();
        let total: f64 = found.iter().map(weight).sum();
        let all: Vec<(f64, Hypothesis)> = found.into_iter().map(|h| (weight(&h) / total, h)).collect();
        Ok((0..self.readings.len()).map(|k| self.contact(k, &inverse, &all)).collect())
    }

    fn findings(&self) -> Findings {
        let document = EstimatorDocument {
            method: Some(Method::StaticArc),
            place: Some(POINT_OF_OBJECT),
            ..EstimatorDocument::default()
        };
        let message = format!(
            "{} of {} readings are loaded; their contacts assume a sweep past an object at rest (along the wire's +z or -z at a steady 2.5 to 7.5 mm/s); \
             marked motion-assumed in status",
            self.loaded,
            self.readings.len()
        );
        Findings {
            document,
            messages: vec![Message::note(message)],
            doubt: self.loaded > 0,
            ..Findings::default()
        }
    }
}
