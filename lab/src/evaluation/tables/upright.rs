//! Table I as the paper draws it: objects upright, four faces in turn, sweeps with a contact jump left out.

use super::{BenchEvaluator, Meshes, RATE_HZ, SeriesByObject};
use crate::LabError;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::evaluation::document::{Faces, Means, MethodRow};
use crate::generate_sweeps::SweepRequest;
use crate::sweep_series::SweepSeries;
use wcal_sim::{SweepPlan, Turn};
use wcal_track::filter::BayesSettings;

/// Faces of an object in table I, and how many times as many sweeps it has as the others.
const FACES: usize = 4;
const UPRIGHT: usize = 4;
/// Steps of the base in which jumps are distinguished from slides, mm.
const RESOLVED_JUMP_MM: f64 = 0.1;

/// Sweeps over each object: where the speed is known, and where it is not.
pub fn sweeps_each(sweeps_each: usize, quick: bool) -> [usize; 2] {
    let fewer = sweeps_each.next_multiple_of(FACES);
    // A quick evaluation takes no more of them than of the others.
    [if quick { fewer } else { UPRIGHT * fewer }, fewer]
}

impl BenchEvaluator<'_> {
    /// A few lost sweeps make most of the error: there are `UPRIGHT` times as many as of the others, but where the speed is not known. Steps
    /// are short: long ones hide small jumps.
    pub(super) fn upright(&self, seen: &Meshes, unseen: &Meshes) -> Result<Faces, LabError> {
        let plan = SweepPlan {
            turn: Turn::Faces,
            keep_jumps: false,
            rate_hz: RATE_HZ,
            step_mm: RESOLVED_JUMP_MM,
            ..SweepPlan::default()
        };
        let [sweeps, fewer] = sweeps_each(self.order.sweeps_each, self.order.quick);
        let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed: self.seed(), sweeps };
        let meshes = [seen, unseen];
        let all_series = [self.all_series(seen, &order)?, self.all_series(unseen, &order)?];
        let shortened = |all: &SeriesByObject| -> SeriesByObject {
            all.iter().map(|(n, all)| (n.clone(), all.iter().take(fewer).cloned().collect())).collect()
        };
        let few_series = all_series.each_ref().map(shortened);
        let score =
            |method: &Method<'_>, all: &[SeriesByObject; 2]| -> Result<[Vec<ObjectScores>; 2], LabError> {
                let run = |c: &SweepSeries| method.run(c);
                let of = |k: usize| score_objects(&run, &all[k], meshes[k]);
                Ok([of(0)?, of(1)?])
            };
        let network = |known: bool| Method::Network(self.tracker, known);
        let table = |[seen, unseen]: [Vec<ObjectScores>; 2]| Means::of(&seen, &unseen);
        let speed_known = table(score(&network(true), &all_series)?);
        let speed_not_known = table(score(&network(false), &few_series)?);
        // Filter and network side by side on the same sweeps.
        let multi_mu = BayesSettings::multi_mu();
        let mut methods = vec![("network", network(false)), ("network, speed known", network(true))];
        if !self.order.quick {
            methods.push(("bayes, speed known", Method::Bayes(self.curve, true, &multi_mu)));
        }
        let mut rows = Vec::new();
        for (name, method) in methods {
            let scores = score(&method, &few_series)?;
            for (set, of_set) in ["seen", "unseen"].into_iter().zip(&scores).filter(|s| !s.1.is_empty()) {
                rows.push(MethodRow::of(set, name, of_set));
            }
        }
        Ok(Faces { speed_known, speed_not_known, methods: rows })
    }
}
