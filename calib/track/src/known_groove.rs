//! Answers compared with the groove of a calibration, whose place is known at each of its readings.
//!
//! A reading at which the stage stood takes the last answer before it, a moving one what lies
//! between the answers around it, in proportion to the time. Readings of one visit are not
//! independent: a visit is held where half of its readings or more lie in their 95 % regions. With
//! h of n visits held, `P(H <= h)` of the binomial distribution with p = 0.95 says whether fewer
//! are an accident.

use crate::TrackError;
use crate::estimator::ContactEstimate;
use crate::groove_comparison::{rms, too_few, visits_held};
use crate::mesh_score::Distances;
use crate::track_document::GrooveScore;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_session::{TextTableLayout, read_text_table};

/// Longest interval between a reading and an answer that it is compared with, s; a longer one
/// between readings parts visits.
const MAX_INTERVAL_S: f64 = 0.3;
/// Squared radius of the 95 % region of three Gaussian numbers (chi-squared, three degrees of
/// freedom).
const CHI2_95: f64 = 7.814_727_903_251_18;

/// Where the groove held the wire at a reading.
#[derive(Debug, Clone, Copy)]
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

/// Columns of a session's own calibration that say where the groove was.
const GROOVE: [&str; 3] = ["groove_x_mm", "groove_y_mm", "groove_z_mm"];

/// Readings of a table with a known groove, in order of time; none where it has no such columns.
///
/// # Errors
/// Where the table cannot be read.
pub fn known_places(path: &Path) -> Result<Vec<KnownPlace>, TrackError> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    let column = |name: &str| table.column(name).ok();
    let (Some(time), [Some(x), Some(y), Some(z)]) = (column("t_s"), GROOVE.map(column)) else {
        return Ok(Vec::new());
    };
    let (role, speed, trajectory) = (column("role"), column("speed_mm_s"), column("trajectory"));
    let mut all: Vec<(Option<f64>, KnownPlace)> = Vec::new();
    for (k, (line, cells)) in table.rows.iter().enumerate() {
        let number = |column| table.number(k, column);
        // A wire at rest is not in the groove: there is no contact to compare.
        if role.is_some_and(|c| &cells[c] == "rest") {
            continue;
        }
        if let (Some(t_s), Some(x), Some(y), Some(z)) =
            (number(time)?, number(x)?, number(y)?, number(z)?)
        {
            let settled = speed.map(number).transpose()?.flatten().map(|v| v == 0.0);
            let groove_mm = Vector3::new(x, y, z);
            let place = KnownPlace {
                line: *line,
                t_s,
                groove_mm,
                settled,
                visit: 0,
            };
            all.push((trajectory.map(number).transpose()?.flatten(), place));
        }
    }
    all.sort_by(|a, b| a.1.t_s.total_cmp(&b.1.t_s));
    let goes_on =
        |(id, a): &(Option<f64>, KnownPlace), (next, b): &(Option<f64>, KnownPlace)| match id {
            Some(id) => Some(id) == next.as_ref(),
            None => next.is_none() && b.t_s - a.t_s <= MAX_INTERVAL_S,
        };
    let visits = all.chunk_by(goes_on).enumerate();
    Ok(visits
        .flat_map(|(visit, of)| of.iter().map(move |p| KnownPlace { visit, ..p.1 }))
        .collect())
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
            // In base coordinates the groove moves against the base: hence the reversed sign.
            all.insert(
                place.line,
                (b.groove_mm - place.groove_mm) / (place.t_s - b.t_s),
            );
        }
    }
    all
}

/// What lies between an answer at a time (s) and a later one: the base goes on evenly from one to
/// the other.
fn between(
    (from_s, from): (f64, ContactEstimate),
    (to_s, to): (f64, ContactEstimate),
    t_s: f64,
) -> (f64, ContactEstimate) {
    let share = (t_s - from_s) / (to_s - from_s);
    let estimate = ContactEstimate {
        place_mm: from.place_mm.lerp(&to.place_mm, share),
        // Errors of answers that follow each other are nearly the same.
        covariance_mm2: from.covariance_mm2 * (1.0 - share) + to.covariance_mm2 * share,
        probability: from.probability + (to.probability - from.probability) * share,
        ..to
    };
    (t_s, estimate)
}

/// Known places compared with the answers.
#[derive(Debug, Clone)]
pub struct KnownGroove {
    places: Vec<KnownPlace>,
    next: usize,
    radius_mm: f64,
    /// The last answer, at the wire's axis, and its time, s.
    last: Option<(f64, ContactEstimate)>,
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

impl KnownGroove {
    /// For a whisker; none without known places.
    pub fn new(places: Vec<KnownPlace>, whisker: &WhiskerSpec) -> Option<Self> {
        (!places.is_empty()).then(|| Self {
            places,
            next: 0,
            radius_mm: whisker.diameter_mm / 2.0,
            last: None,
            compared: Vec::new(),
            unseen: 0,
        })
    }

    /// Takes the answer at a time; readings up to there are compared with the last one before them,
    /// moving ones with what lies between.
    pub fn push(&mut self, t_s: f64, estimate: &ContactEstimate) {
        // The contact is on the object's surface; the groove's place is that of the wire's axis.
        let now = ContactEstimate {
            place_mm: estimate.place_mm + estimate.normal * self.radius_mm,
            ..*estimate
        };
        let now = (t_s, now);
        while let Some(place) = self.places.get(self.next).filter(|p| p.t_s <= t_s) {
            let (at_s, chosen) = match self.last.filter(|_| t_s > place.t_s) {
                Some(last) if place.settled == Some(true) => last,
                Some(last) if t_s - last.0 <= MAX_INTERVAL_S => between(last, now, place.t_s),
                _ => now,
            };
            if (at_s - place.t_s).abs() <= MAX_INTERVAL_S {
                let off_mm = chosen.place_mm - place.groove_mm;
                let factor = chosen.covariance_mm2.cholesky();
                self.compared.push(GrooveError {
                    t_s: place.t_s,
                    visit: place.visit,
                    off_mm: off_mm.norm(),
                    // Mahalanobis distance of the known place from the stated one.
                    in_region95: factor.map(|c| off_mm.dot(&c.solve(&off_mm)) <= CHI2_95),
                });
                self.unseen += usize::from(chosen.probability < 0.5);
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
        let last: Vec<&GrooveError> = contacts_s.iter().filter_map(within).collect();
        (!last.is_empty()).then(|| rms(last.iter().map(|c| c.off_mm)))
    }

    /// Visits, and those of which half of the readings or more lie in their regions.
    fn visits_held(&self) -> [usize; 2] {
        visits_held(
            self.compared
                .iter()
                .map(|c| (c.visit, c.in_region95 == Some(true))),
        )
    }

    /// Whether the stated regions hold fewer visits than chance explains.
    pub(crate) fn coverage_rejected(&self) -> bool {
        too_few(self.visits_held())
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

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
        assert!((crate::groove_comparison::binomial_cdf(1, 2, 0.9) - 0.19).abs() < 1e-12);
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
