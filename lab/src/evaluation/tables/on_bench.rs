//! The tracker on the virtual real bench, and what each part of it buys there.

use super::{BenchEvaluator, Meshes, SeriesByObject};
use crate::LabError;
use crate::bootstrap::worst_interval95;
use crate::evaluate::{Estimate, Method, ObjectScores, score_objects};
use crate::evaluation::document::{AblationRow, BySet, NoiseRow, VirtualReal, coverage90, intervals, mean};
use crate::evaluation::document::{Means, both_means};
use crate::evaluation::virtual_bench::{STREAM_NOISES, VirtualBench};
use crate::evaluation::work::ABLATION;
use crate::generate_sweeps::SweepRequest;
use crate::sweep_series::SweepSeries;
use wcal_calibration::CalibrationModel;
use wcal_plant::noise::Noise;
use wcal_sim::physics::Medium;
use wcal_track::Tracker;
use wcal_track::filter::BayesSettings;

/// Time of the released cable, joint damping 0.005 N m s/rad over the stiffness of a joint, s.
const DAMPING_S: f64 = 0.24;

impl BenchEvaluator<'_> {
    pub(super) fn sweeps_on_bench(
        &self,
        bench: &VirtualBench,
        meshes: &Meshes,
        medium: Medium,
    ) -> Result<SeriesByObject, LabError> {
        let plan = VirtualBench::plan(medium);
        let (seed, sweeps) = (self.seed(), self.order.sweeps_each);
        self.all_series(meshes, &SweepRequest { whisker: &bench.whisker, plan: &plan, seed, sweeps })
    }

    /// The network with the base's speed known, on true sweeps as a calibration measures them.
    pub(super) fn score_measured(
        &self,
        bench: &VirtualBench,
        by: &CalibrationModel,
        true_series: &SeriesByObject,
        meshes: &Meshes,
    ) -> Result<Vec<ObjectScores>, LabError> {
        let tracker = self.on_stream(by);
        let measured = self.measured(bench, by, true_series, Noise::Gaussian)?;
        let run = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        score_objects(&run, &measured, meshes)
    }

    fn measured(
        &self,
        bench: &VirtualBench,
        by: &CalibrationModel,
        all_series: &SeriesByObject,
        noise: Noise,
    ) -> Result<SeriesByObject, LabError> {
        let one = |c: &SweepSeries| bench.through(c, by, self.order.seed, noise, self.folder);
        let of = |all: &Vec<SweepSeries>| all.iter().map(one).collect::<Result<Vec<SweepSeries>, LabError>>();
        all_series.iter().map(|(name, all)| Ok((name.clone(), of(all)?))).collect()
    }

    /// The tracker with the measurement noise of a calibration and the standard deviations of a stream, as `wcal track` has it.
    fn on_stream(&self, by: &CalibrationModel) -> Tracker {
        Tracker {
            filters: (self.around.filters_for)(self.tracker.filters, by),
            sd_factors: self.card.sd_on_bench.clone(),
            ..self.tracker.clone()
        }
    }

    /// The network on the bench under each kind of a stream's noise: error and coverage over the unseen objects.
    pub(super) fn noises(&self, bench: &VirtualBench, unseen: &Meshes) -> Result<Vec<NoiseRow>, LabError> {
        let by = bench.calibration.best();
        let tracker = self.on_stream(by);
        let truth = self.sweeps_on_bench(bench, unseen, Medium::Air)?;
        let run = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        let row = |noise: Noise| {
            let measured = self.measured(bench, by, &truth, noise)?;
            let rows = score_objects(&run, &measured, unseen)?;
            Ok(NoiseRow {
                noise: noise.name(),
                rmse_mm: mean(&rows, |o| o.all.rmse_mm),
                true_contact_rmse_mm: mean(&rows, |o| o.all.true_contact_rmse_mm),
                coverage90: coverage90(&rows),
                interval95: intervals(&rows),
            })
        };
        STREAM_NOISES.into_iter().map(row).collect()
    }

    pub(super) fn virtual_real(
        &self,
        bench: &VirtualBench,
        seen: &Meshes,
        unseen: &Meshes,
        ablations: f64,
    ) -> Result<(VirtualReal, Vec<AblationRow>), LabError> {
        let by = bench.calibration.best();
        let multi_mu = (self.around.filters_for)(BayesSettings::multi_mu().into(), by).frictional;
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
        interval95.insert("worst_mm", worst_interval95(&every, |s| s.surface));
        let means = Means::of(&rows_seen, &rows_unseen);
        let calibration = &bench.calibration;
        let real = VirtualReal {
            coverage90: BySet { seen: coverage90(&rows_seen), unseen: coverage90(&rows_unseen) },
            is_virtual: true,
            seen_mean_mm: means.seen_mean_mm,
            unseen_mean_mm: means.unseen_mean_mm,
            worst_mm: worst,
            interval95,
            acting: bench.acting.clone(),
            verdict: calibration.verdict,
            accepted: calibration.accepted.clone(),
            calibration: if calibration.verified.is_some() { "verify" } else { "fit-gpr" },
            objects: means.objects,
        };
        let later = |c: &SweepSeries| {
            // The estimate of the reading before; the first one has none.
            let estimates: Vec<Estimate> = Method::Network(&tracker, true).run(c);
            estimates.first().into_iter().chain(&estimates).take(c.samples.len()).copied().collect()
        };
        self.work.next("ablations", ABLATION * ablations);
        let damped = |all_series: &SeriesByObject| -> SeriesByObject {
            all_series.iter().map(|(n, all)| (n.clone(), all.iter().map(damped).collect())).collect()
        };
        let row = |name: &str, rows: Vec<ObjectScores>| AblationRow::of(name, &rows);
        let network = |c: &SweepSeries| Method::Network(&tracker, true).run(c);
        let other = |all_series: &SeriesByObject| score_objects(&network, all_series, unseen);
        let filter = Method::Bayes(&tracker.inverse, true, &multi_mu);
        let mut ablations = vec![
            row("effects-accepted", rows_unseen),
            row(
                "effects-not-accepted",
                other(&self.measured(bench, &calibration.map, &true_unseen, Noise::Gaussian)?)?,
            ),
            row("moments-without-error", other(&true_unseen)?),
            row("speed-not-known", score(unseen, &measured, false)?),
            row("horizon-1", score_objects(&later, &measured, unseen)?),
            row("damping-bias", other(&damped(&measured))?),
            row("bayes-filter", of(&filter, unseen, &measured)?),
        ];
        for (name, map) in &calibration.maps {
            let rows = other(&self.measured(bench, map, &true_unseen, Noise::Gaussian)?)?;
            ablations.push(row(&format!("map-{name}"), rows));
        }
        Ok((real, ablations))
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
