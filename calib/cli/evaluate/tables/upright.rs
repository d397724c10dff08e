//! Table I as the paper draws it: objects upright, four faces in turn, sweeps with a contact jump left out.

use super::super::document::{both_means, mean, method as method_row, object};
use super::{Maker, Meshes, RATE_HZ, SeriesByObject};
use serde_json::{Value, json};
use wcal_sim::{SweepPlan, Turn};
use wcal_track::SweepSeries;
use wcal_track::evaluate::{Method, ObjectScores, score_objects};
use wcal_track::filter::BayesSettings;
use wcal_track::generate_sweeps::SweepRequest;

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

impl Maker<'_> {
    /// A few lost sweeps make most of the error: there are `UPRIGHT` times as many as of the others, but where the speed is not known. Steps
    /// are short: long ones hide small jumps.
    pub(super) fn upright(&self, seen: &Meshes, unseen: &Meshes) -> anyhow::Result<Value> {
        let plan = SweepPlan {
            turn: Turn::Faces,
            keep_jumps: false,
            rate_hz: RATE_HZ,
            step_mm: RESOLVED_JUMP_MM,
            ..SweepPlan::default()
        };
        let [sweeps, fewer] = sweeps_each(self.args.sweeps_each, self.args.quick);
        let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed: self.seed(), sweeps };
        let meshes = [seen, unseen];
        let all_series = [self.all_series(seen, &order)?, self.all_series(unseen, &order)?];
        let shortened = |all: &SeriesByObject| -> SeriesByObject {
            all.iter().map(|(n, all)| (n.clone(), all.iter().take(fewer).cloned().collect())).collect()
        };
        let few_series = all_series.each_ref().map(shortened);
        let score =
            |method: &Method<'_>, all: &[SeriesByObject; 2]| -> anyhow::Result<[Vec<ObjectScores>; 2]> {
                let run = |c: &SweepSeries| method.run(c);
                let of = |k: usize| score_objects(&run, &all[k], meshes[k]);
                Ok([of(0)?, of(1)?])
            };
        let network = |known: bool| Method::Network(self.tracker, known);
        let mut document = table_of(&score(&network(true), &all_series)?);
        document["speed_not_known"] = table_of(&score(&network(false), &few_series)?);
        // Filter and network side by side on the same sweeps.
        let multi_mu = BayesSettings::multi_mu();
        let mut methods = vec![("network", network(false)), ("network, speed known", network(true))];
        if !self.args.quick {
            methods.push(("bayes, speed known", Method::Bayes(self.curve, true, &multi_mu)));
        }
        let mut rows = Vec::new();
        for (name, method) in &methods {
            let scores = score(method, &few_series)?;
            for (set, of_set) in ["seen", "unseen"].into_iter().zip(&scores).filter(|s| !s.1.is_empty()) {
                rows.push(method_row(set, name, of_set));
            }
        }
        document["methods"] = Value::Array(rows);
        Ok(document)
    }
}

/// Means and the objects' rows.
fn table_of([seen, unseen]: &[Vec<ObjectScores>; 2]) -> Value {
    let objects = seen.iter().map(|o| object(o, "seen"));
    let objects = objects.chain(unseen.iter().map(|o| object(o, "unseen")));
    let means = |rows: &[ObjectScores]| mean(rows, |o| o.all.rmse_mm);
    json!({"seen_mean_mm": means(seen), "unseen_mean_mm": means(unseen),
        "interval95": both_means(seen, unseen), "objects": objects.collect::<Vec<Value>>()})
}
