//! The tracker on the virtual real bench, and what each part of it buys there.

use super::super::document::{both_means, intervals, mean, object};
use super::super::virtual_bench::{STREAM_NOISES, VirtualBench};
use super::super::work::ABLATION;
use super::{Maker, Meshes, SeriesByObject};
use crate::track::filters_for;
use serde_json::{Value, json};
use wcal_calibration::CalibrationModel;
use wcal_plant::noise::Noise;
use wcal_sim::physics::Medium;
use wcal_track::bootstrap::worst_interval95;
use wcal_track::evaluate::{Estimate, Method, ObjectScores, score_objects};
use wcal_track::filter::BayesSettings;
use wcal_track::generate_sweeps::SweepRequest;
use wcal_track::{SweepSeries, Tracker};

/// Time of the released cable, joint damping 0.005 N m s/rad over the stiffness of a joint, s.
const DAMPING_S: f64 = 0.24;

impl Maker<'_> {
    pub(super) fn sweeps_on_bench(
        &self,
        bench: &VirtualBench,
        meshes: &Meshes,
        medium: Medium,
    ) -> anyhow::Result<SeriesByObject> {
        let plan = VirtualBench::plan(medium);
        let (seed, sweeps) = (self.seed(), self.args.sweeps_each);
        self.all_series(meshes, &SweepRequest { whisker: &bench.whisker, plan: &plan, seed, sweeps })
    }

    /// The network with the base's speed known, on true sweeps as a calibration measures them.
    pub(super) fn score_measured(
        &self,
        bench: &VirtualBench,
        by: &CalibrationModel,
        true_series: &SeriesByObject,
        meshes: &Meshes,
    ) -> anyhow::Result<Vec<ObjectScores>> {
        let tracker = self.on_stream(by);
        let measured = self.measured(bench, by, true_series, Noise::Gaussian)?;
        let run = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        Ok(score_objects(&run, &measured, meshes)?)
    }

    fn measured(
        &self,
        bench: &VirtualBench,
        by: &CalibrationModel,
        all_series: &SeriesByObject,
        noise: Noise,
    ) -> anyhow::Result<SeriesByObject> {
        let one = |c: &SweepSeries| bench.through(c, by, self.args.seed, noise, self.folder);
        let of = |all: &Vec<SweepSeries>| all.iter().map(one).collect::<anyhow::Result<Vec<SweepSeries>>>();
        all_series.iter().map(|(name, all)| Ok((name.clone(), of(all)?))).collect()
    }

    /// The tracker with the measurement noise of a calibration and the standard deviations of a stream, as `wcal track` has it.
    fn on_stream(&self, by: &CalibrationModel) -> Tracker {
        Tracker {
            filters: filters_for(self.tracker.filters, by),
            sd_factors: self.card.sd_factors_of_stream(),
            ..self.tracker.clone()
        }
    }

    /// The network on the bench under each kind of a stream's noise: error and coverage over the unseen objects.
    pub(super) fn noises(&self, bench: &VirtualBench, unseen: &Meshes) -> anyhow::Result<Value> {
        let by = bench.verified.as_ref().unwrap_or(&bench.map);
        let tracker = self.on_stream(by);
        let truth = self.sweeps_on_bench(bench, unseen, Medium::Air)?;
        let run = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        let row = |noise: Noise| {
            let measured = self.measured(bench, by, &truth, noise)?;
            let rows = score_objects(&run, &measured, unseen)?;
            Ok(json!({"noise": noise.name(), "rmse_mm": mean(&rows, |o| o.all.rmse_mm),
                "true_contact_rmse_mm": mean(&rows, |o| o.all.true_contact_rmse_mm),
                "coverage90": mean(&rows, |o| o.all.coverage90.unwrap_or(f64::NAN)), "interval95": intervals(&rows)}))
        };
        Ok(Value::Array(STREAM_NOISES.into_iter().map(row).collect::<anyhow::Result<_>>()?))
    }

    pub(super) fn virtual_real(
        &self,
        bench: &VirtualBench,
        seen: &Meshes,
        unseen: &Meshes,
        ablations: f64,
    ) -> anyhow::Result<(Value, Value)> {
        let by = bench.verified.as_ref().unwrap_or(&bench.map);
        let multi_mu = filters_for(BayesSettings::multi_mu().into(), by).frictional;
        let tracker = self.on_stream(by);
        let [true_seen, true_unseen] = [
            self.sweeps_on_bench(bench, seen, Medium::Air)?,
            self.sweeps_on_bench(bench, unseen, Medium::Air)?,
        ];
        let measured_of = |t: &SeriesByObject| self.measured(bench, by, t, Noise::Gaussian);
        let (measured_seen, measured) = (measured_of(&true_seen)?, measured_of(&true_unseen)?);
        let of = |method: &Method<'_>, meshes: &Meshes, all_series: &SeriesByObject| {
            score_objects(&|c: &SweepSeries| method.run(c), all_series, meshes)
        };
        let score = |meshes: &Meshes, all_series: &SeriesByObject, known: bool| {
            of(&Method::Network(&tracker, known), meshes, all_series)
        };
        let rows_seen = score(seen, &measured_seen, true)?;
        let rows_unseen = score(unseen, &measured, true)?;
        let every: Vec<&ObjectScores> = rows_seen.iter().chain(&rows_unseen).collect();
        let worst = every.iter().map(|o| o.all.rmse_mm).fold(0.0, f64::max);
        let mut interval95 = both_means(&rows_seen, &rows_unseen);
        interval95["worst_mm"] = json!(worst_interval95(&every, |s| s.surface));
        let with_set = |set: &'static str| move |o: &ObjectScores| object(o, set);
        let objects: Vec<Value> = rows_seen
            .iter()
            .map(with_set("seen"))
            .chain(rows_unseen.iter().map(with_set("unseen")))
            .collect();
        let means = |rows: &[ObjectScores]| mean(rows, |o| o.all.rmse_mm);
        let covers = |rows: &[ObjectScores]| mean(rows, |o| o.all.coverage90.unwrap_or(f64::NAN));
        let real = json!({
            "coverage90": {"seen": covers(&rows_seen), "unseen": covers(&rows_unseen)},
            "virtual": true, "seen_mean_mm": means(&rows_seen), "unseen_mean_mm": means(&rows_unseen), "worst_mm": worst,
            "interval95": interval95, "acting": bench.acting, "verdict": bench.verdict, "accepted": bench.accepted,
            "calibration": if bench.verified.is_some() { "verify" } else { "fit-gpr" },
            "objects": objects,
        });
        let later = |c: &SweepSeries| {
            // The estimate of the reading before; the first one has none.
            let estimates: Vec<Estimate> = Method::Network(&tracker, true).run(c);
            estimates.first().into_iter().chain(&estimates).take(c.samples.len()).copied().collect()
        };
        self.work.next("ablations", ABLATION * ablations);
        let damped = |all_series: &SeriesByObject| -> SeriesByObject {
            all_series.iter().map(|(n, all)| (n.clone(), all.iter().map(damped).collect())).collect()
        };
        let row = |name: &str, rows: Vec<ObjectScores>| {
            json!({"name": name, "rmse_mm": means(&rows), "followed_rmse_mm": mean(&rows, |o| o.followed.rmse_mm),
                "true_contact_rmse_mm": mean(&rows, |o| o.all.true_contact_rmse_mm), "p95_mm": mean(&rows, |o| o.all.p95_mm),
                "interval95": intervals(&rows)})
        };
        let network = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        let other = |all_series: &SeriesByObject| score_objects(&network, all_series, unseen);
        let filter = Method::Bayes(&tracker.inverse, true, &multi_mu);
        let mut ablations = vec![
            row("effects-accepted", rows_unseen),
            row(
                "effects-not-accepted",
                other(&self.measured(bench, &bench.map, &true_unseen, Noise::Gaussian)?)?,
            ),
            row("moments-without-error", other(&true_unseen)?),
            row("speed-not-known", score(unseen, &measured, false)?),
            row("horizon-1", score_objects(&later, &measured, unseen)?),
            row("damping-bias", other(&damped(&measured))?),
            row("bayes-filter", of(&filter, unseen, &measured)?),
        ];
        for (name, map) in &bench.maps {
            let rows = other(&self.measured(bench, map, &true_unseen, Noise::Gaussian)?)?;
            ablations.push(row(&format!("map-{name}"), rows));
        }
        Ok((real, Value::Array(ablations)))
    }
}

/// The moments that a cable with damped joints would have: damping and stiffness of all its joints have one ratio.
fn damped(series: &SweepSeries) -> SweepSeries {
    let mut with = series.clone();
    for (k, pair) in series.samples.windows(2).enumerate() {
        let dt = pair[1].t_s - pair[0].t_s;
        for axis in 0..2 {
            let rate = (pair[1].moment_nmm[axis] - pair[0].moment_nmm[axis]) / dt;
            with.samples[k + 1].moment_nmm[axis] += DAMPING_S * rate;
        }
    }
    with
}
