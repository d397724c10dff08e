//! Answers compared with the groove of a calibration, whose place is known at each of its readings.
//!
//! A reading at which the stage stood takes the last answer before it, a moving one what lies
//! between the answers around it, in proportion to the time. Readings of one visit are not
//! independent: a visit is held where half of its readings or more lie in their 95 % regions. With
//! h of n visits held, `P(H <= h)` of the binomial distribution with p = 0.95 says whether fewer
//! are an accident.

use crate::arc_posterior::REGION;
use crate::estimator::ContactEstimate;
use crate::mesh_score::Distances;
use crate::track_document::GrooveScore;
use nalgebra::{Matrix3, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use wcal_core::observation::WhiskerSpec;

/// Longest interval between a reading and an answer that it is compared with, s; a longer one
/// between readings parts visits.
pub(crate) const MAX_INTERVAL_S: f64 = 0.3;
/// Squared radius of the 95 % region of three Gaussian numbers (chi-squared, three degrees of
/// freedom).
const CHI2_95: f64 = 7.814_727_903_251_18;
/// Level of significance of a test against the stated coverage.
const LEVEL: f64 = 0.01;

/// Where the groove held the wire at a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPlace {
    /// Line of the table.
    pub line: usize,
    /// Time, s.
    pub t_s: f64,
    /// Centre of the wire in the groove, base frame, mm.
    pub groove_mm: Vector3<f64>,
    /// Whether the stage stood still; none where the table does not say.
    pub settled: Option<bool>,
    /// Number of the visit: a trajectory, or readings that follow each other.
    pub visit: usize,
}

/// Velocity of the base past the groove between the readings of a table, base frame, mm/s, by line.
pub fn velocities(places: &[KnownPlace], max_step_s: f64) -> BTreeMap<usize, Vector3<f64>> {
    let mut all = BTreeMap::new();
    for (k, place) in places.iter().enumerate() {
        let before = k
            .checked_sub(1)
            .map(|k| &places[k])
            .filter(|b| place.t_s - b.t_s <= max_step_s);
        let moved = before.filter(|b| place.t_s > b.t_s);
        if place.settled == Some(true) {
            all.insert(place.line, Vector3::zeros());
        } else if let Some(b) = moved {
            all.insert(
                place.line,
                (b.groove_mm - place.groove_mm) / (place.t_s - b.t_s),
            );
        }
    }
    all
}

/// An answer of the tracker.
#[derive(Debug, Clone, Copy)]
struct Answer {
    t_s: f64,
    axis_mm: Vector3<f64>,
    covariance_mm2: Matrix3<f64>,
    contact: f64,
}

impl Answer {
    /// What lies between this answer and a later one at a time: the base goes on evenly from one to
    /// the other.
    fn until(&self, later: &Self, t_s: f64) -> Self {
        let share = (t_s - self.t_s) / (later.t_s - self.t_s);
        Self {
            t_s,
            axis_mm: self.axis_mm.lerp(&later.axis_mm, share),
            // Errors of answers that follow each other are nearly the same.
            covariance_mm2: self.covariance_mm2 * (1.0 - share) + later.covariance_mm2 * share,
            contact: self.contact + (later.contact - self.contact) * share,
        }
    }
}

/// Known places compared with the answers.
#[derive(Debug, Clone)]
pub struct KnownGroove {
    places: Vec<KnownPlace>,
    next: usize,
    radius_mm: f64,
    last: Option<Answer>,
    compared: Vec<GrooveError>,
    /// Readings at which the tracker sees no contact.
    unseen: usize,
}

/// A place of the groove compared with its answer.
#[derive(Debug, Clone, Copy)]
struct GrooveError {
    t_s: f64,
    visit: usize,
    /// Distance, mm.
    off_mm: f64,
    /// Whether the place lies in the stated 95 % region; none where the covariance states none.
    in_region95: Option<bool>,
}

impl GrooveError {
    /// Of a place and its answer.
    fn new(place: &KnownPlace, answer: &Answer) -> Self {
        let off_mm = answer.axis_mm - place.groove_mm;
        let factor = answer.covariance_mm2.cholesky();
        let in_region95 = factor.map(|c| off_mm.dot(&c.solve(&off_mm)) <= CHI2_95);
        Self {
            t_s: place.t_s,
            visit: place.visit,
            off_mm: off_mm.norm(),
            in_region95,
        }
    }
}

impl KnownGroove {
    /// For a whisker; none without known places.
    pub fn new(places: Vec<KnownPlace>, whisker: &WhiskerSpec) -> Option<Self> {
        let radius_mm = whisker.diameter_mm / 2.0;
        let own = Self {
            places,
            next: 0,
            radius_mm,
            last: None,
            compared: Vec::new(),
            unseen: 0,
        };
        (!own.places.is_empty()).then_some(own)
    }

    /// Takes the answer at a time; readings up to there are compared with the last one before them,
    /// moving ones with what lies between.
    pub fn push(&mut self, t_s: f64, estimate: &ContactEstimate) {
        let now = Answer {
            t_s,
            // The contact is on the object's surface; the groove's place is that of the wire's
            // axis.
            axis_mm: estimate.place_mm + estimate.normal * self.radius_mm,
            covariance_mm2: estimate.covariance_mm2,
            contact: estimate.probability,
        };
        while let Some(place) = self.places.get(self.next).filter(|p| p.t_s <= t_s) {
            let chosen = match self.last.filter(|_| t_s > place.t_s) {
                Some(last) if place.settled == Some(true) => last,
                Some(last) if t_s - last.t_s <= MAX_INTERVAL_S => last.until(&now, place.t_s),
                _ => now,
            };
            if (chosen.t_s - place.t_s).abs() <= MAX_INTERVAL_S {
                self.compared.push(GrooveError::new(place, &chosen));
                self.unseen += usize::from(chosen.contact < 0.5);
            }
            self.next += 1;
        }
        self.last = Some(now);
    }

    /// For track.json; none where nothing was compared.
    pub fn score(&self) -> Option<GrooveScore> {
        if self.compared.is_empty() {
            return None;
        }
        let Distances {
            rmse_mm,
            median_mm,
            p95_mm,
            ..
        } = Distances::new(self.compared.iter().map(|c| c.off_mm).collect());
        // A covariance that is not positive definite states nothing.
        let stated: Vec<bool> = self.compared.iter().filter_map(|c| c.in_region95).collect();
        let held = stated.iter().filter(|held| **held).count();
        Some(GrooveScore {
            readings: self.places.len(),
            compared: self.compared.len(),
            without_contact: self.unseen,
            rmse_mm,
            median_mm,
            p95_mm,
            largest_mm: self.compared.iter().map(|c| c.off_mm).fold(0.0, f64::max),
            coverage95: (!stated.is_empty()).then(|| held as f64 / stated.len() as f64),
        })
    }

    /// RMS error at the last compared reading of each contact (first and last time, s), mm: a
    /// contact's readings before it knew less. None where none was compared.
    pub fn end_rmse_mm(&self, contacts_s: &[[f64; 2]]) -> Option<f64> {
        let within = |[from, to]: &[f64; 2]| {
            self.compared
                .iter()
                .rfind(|c| (*from..=*to).contains(&c.t_s))
        };
        let last: Vec<f64> = contacts_s
            .iter()
            .filter_map(within)
            .map(|c| c.off_mm.powi(2))
            .collect();
        (!last.is_empty()).then(|| (last.iter().sum::<f64>() / last.len() as f64).sqrt())
    }

    /// Visits, and those of which half of the readings or more lie in their regions.
    fn visits_held(&self) -> [usize; 2] {
        let visits: BTreeSet<usize> = self.compared.iter().map(|c| c.visit).collect();
        let held = |visit: &&usize| {
            let own = || self.compared.iter().filter(|c| c.visit == **visit);
            2 * own().filter(|c| c.in_region95 == Some(true)).count() >= own().count()
        };
        [visits.len(), visits.iter().filter(held).count()]
    }

    /// Whether the stated regions hold fewer visits than chance explains.
    pub(crate) fn coverage_rejected(&self) -> bool {
        let [visits, held] = self.visits_held();
        too_few(held, visits, REGION)
    }

    /// The same for people.
    pub fn message(&self) -> Option<String> {
        let (s, [visits, held]) = (self.score()?, self.visits_held());
        Some(format!(
            "known groove, {} readings: the tracked contact is off by {:.2} mm RMS (median {:.2}, largest {:.2}); {:.0} % lie in the stated \
             95 % regions, which hold it on {held} of {visits} visits; no contact seen at {}",
            s.compared,
            s.rmse_mm,
            s.median_mm,
            s.largest_mm,
            100.0 * s.coverage95.unwrap_or(f64::NAN),
            s.without_contact
        ))
    }
}

/// Whether `hits` of `n` are fewer than chance explains where the probability of each is `p`.
pub(crate) fn too_few(hits: usize, n: usize, p: f64) -> bool {
    n > 0 && binomial_cdf(hits, n, p) < LEVEL
}

/// Chance of `hits` or fewer of `n` with probability `p` each (binomial).
pub(crate) fn binomial_cdf(hits: usize, n: usize, p: f64) -> f64 {
    // Terms by their ratio, P(k + 1) / P(k) = (n - k) / (k + 1) p / (1 - p).
    let (mut ln_term, mut sum) = (n as f64 * (1.0 - p).ln(), 0.0);
    for k in 0..=hits {
        sum += ln_term.exp();
        ln_term += ((n - k) as f64 / (k + 1) as f64).ln() + (p / (1.0 - p)).ln();
    }
    sum.min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(line: usize, t_s: f64, x: f64, settled: bool) -> KnownPlace {
        KnownPlace {
            line,
            t_s,
            groove_mm: Vector3::new(x, 0.0, 0.0),
            settled: Some(settled),
            visit: line,
        }
    }

    fn answer(x: f64, sd_mm: f64) -> ContactEstimate {
        ContactEstimate {
            probability: 0.9,
            place_mm: Vector3::new(x, 0.0, -0.15),
            covariance_mm2: Matrix3::identity() * sd_mm * sd_mm,
            normal: Vector3::z(),
        }
    }

    #[test]
    fn answers_are_compared_with_the_groove_at_their_time() {
        let whisker = WhiskerSpec::nominal();
        let places = vec![
            place(2, 1.0, 20.0, true),
            place(3, 2.04, 30.0, false),
            place(4, 9.0, 30.0, true),
        ];
        let mut groove = KnownGroove::new(places, &whisker).unwrap();
        for (t_s, x) in [
            (0.95, 20.0),
            (1.05, 99.0),
            (2.0, 29.6),
            (2.1, 30.6),
            (9.5, 99.0),
        ] {
            groove.push(t_s, &answer(x, 0.5));
        }
        // Standing: the answer before. Moving: between both (the nearest is .4 mm off). None within
        // reach of the third.
        let s = groove.score().unwrap();
        assert_eq!((s.readings, s.compared), (3, 2), "{s:?}");
        assert!(s.largest_mm < 1e-6, "{s:?}");
        assert!(KnownGroove::new(Vec::new(), &whisker).is_none());
    }

    #[test]
    fn regions_that_hold_too_little_are_told_from_chance() {
        let run = |off_mm: f64, n: usize| {
            let places = (0..n).map(|k| place(k, k as f64, 20.0, true)).collect();
            let mut groove = KnownGroove::new(places, &WhiskerSpec::nominal()).unwrap();
            (0..n).for_each(|k| groove.push(k as f64, &answer(20.0 + off_mm, 1.0)));
            groove.coverage_rejected()
        };
        assert!(run(22.0, 9) && !run(0.5, 9), "22 mm off with 1 mm stated");
        assert!(!run(22.0, 1), "one visit of twenty may lie outside");
        // Readings of one visit are no nine witnesses.
        let places = (0..9)
            .map(|k| KnownPlace {
                visit: 0,
                ..place(k, k as f64, 20.0, true)
            })
            .collect();
        let mut groove = KnownGroove::new(places, &WhiskerSpec::nominal()).unwrap();
        (0..9).for_each(|k| groove.push(f64::from(k), &answer(42.0, 1.0)));
        assert!(!groove.coverage_rejected());
        assert!((binomial_cdf(1, 2, 0.9) - 0.19).abs() < 1e-12);
    }

    #[test]
    fn velocities_are_those_of_the_base_past_the_groove() {
        let all = velocities(
            &[
                place(2, 0.0, 0.0, true),
                place(3, 0.1, 0.4, false),
                place(4, 9.0, 5.0, false),
            ],
            1.0,
        );
        assert_eq!(all[&2], Vector3::zeros());
        assert!(
            (all[&3].x + 4.0).abs() < 1e-9 && !all.contains_key(&4),
            "{all:?}"
        );
    }
}
