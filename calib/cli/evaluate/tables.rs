//! The paper's tables II and III, the virtual real bench, and ablations. All of it is SIMULATED.

use super::document::{both_means, intervals, mean, object};
use super::virtual_bench::VirtualBench;
use super::work::{ABLATION, BENCH, ON_BENCH, SWEEP, Work};
use super::{EvaluateArgs, meshes};
use crate::track::filters_for;
use anyhow::Context;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_calibration::CalibrationModel;
use wcal_sim::physics::Medium;
use wcal_sim::{Mesh, SweepPlan, Turn};
use wcal_track::bootstrap::{mean_interval95, worst_interval95};
use wcal_track::evaluate::{Estimate, Method, ObjectScores, score_objects};
use wcal_track::filter::BayesSettings;
use wcal_track::generate_sweeps::{SweepRequest, generate_sweeps};
use wcal_track::model_file::Card;
use wcal_track::{SweepSeries, Tracker};

type SeriesByObject = BTreeMap<String, Vec<SweepSeries>>;
type Meshes = BTreeMap<String, Mesh>;

/// Speeds of table II, mm/s.
const SPEEDS_MM_S: [f64; 5] = [4.0, 6.0, 8.0, 10.0, 12.0];
/// Rows of the ablations, those of the maps included.
const ABLATIONS: f64 = 11.0;
/// Objects of table III.
const SIM_TO_REAL: [&str; 3] = ["vase", "035_power_drill", "rock"];
/// Faces of an object in table I, and how many times as many sweeps it has as the others.
const FACES: usize = 4;
const UPRIGHT: usize = 4;

/// How many times as many; a quick evaluation takes no more of them than of the others.
fn upright(args: &EvaluateArgs) -> usize {
    if args.quick { 1 } else { UPRIGHT }
}
/// Steps of the base in which jumps are distinguished from slides, mm.
const JUMPS_TOLD_MM: f64 = 0.1;
/// Bounds of the random speeds as shares, and of their accelerations, mm/s^2.
const RANDOM: [f64; 2] = [0.75, 1.25];
const RANDOM_MM_S2: f64 = 1.0;
/// Readings a second.
const RATE_HZ: f64 = 10.0;
/// Sweeps that were trained on have small seeds: the same number must not draw the same sweeps here.
const ON_THE_SPOT: u64 = 0x6576_616c_7561_7465;
/// TrainingData time of the released cable, joint damping 0.005 N m s/rad over the stiffness of a joint, s.
const DAMPING_S: f64 = 0.24;

/// What the tables are made with.
pub struct Maker<'a> {
    /// Network.
    pub tracker: &'a Tracker,
    /// Its card.
    pub card: &'a Card,
    /// Arguments of the command.
    pub args: &'a EvaluateArgs,
    /// Folder for what is in between.
    pub folder: &'a Path,
    /// How far the work is.
    pub work: &'a Work<'a>,
}

/// Sweeps that are drawn for a table, plain and on the virtual bench, and those that ablations track again.
struct Sweeps {
    faces: f64,
    real: f64,
    ablations: f64,
    speeds: f64,
    media: f64,
}

impl Sweeps {
    fn of(card: &Card, args: &EvaluateArgs) -> Self {
        let objects = |names: &[String]| names.len().min(args.objects) as f64;
        let (each, [seen, unseen]) =
            (args.sweeps_each as f64, [&card.objects.training, &card.objects.unseen].map(|n| objects(n)));
        let faces = (args.sweeps_each.next_multiple_of(FACES) * upright(args)) as f64;
        Self {
            faces: (seen + unseen) * faces,
            real: (seen + unseen) * each,
            ablations: ABLATIONS * unseen * each,
            speeds: if args.quick { 0.0 } else { 2.0 * SPEEDS_MM_S.len() as f64 * unseen * each },
            media: if args.quick { 0.0 } else { 3.0 * SIM_TO_REAL.len() as f64 * each },
        }
    }
}

/// Cost of all tables (see `work`).
pub fn cost(card: &Card, args: &EvaluateArgs) -> f64 {
    if args.simulation_only {
        return 0.0;
    }
    let s = Sweeps::of(card, args);
    BENCH + SWEEP * (s.faces + s.speeds) + ON_BENCH * (s.real + s.media) + ABLATION * s.ablations
}

/// Known motion: the tracker on the groove of the bench's session by `verify`'s own calibration, beside the posterior Cramer-Rao bound.
fn known_motion(bench: &VirtualBench) -> Value {
    bench.groove.as_ref().map_or(Value::Null, |g| {
        json!({"virtual": true, "error_mm": g.rmse_mm, "bound_mm": g.bound_mm, "error_over_bound": g.rmse_mm / g.bound_mm,
            "trajectories": g.trajectories, "trajectories_held": g.trajectories_held, "readings": g.points, "split": g.split})
    })
}

impl Maker<'_> {
    /// All tables by their names in evaluation.json.
    pub fn tables(&self) -> anyhow::Result<BTreeMap<&'static str, Value>> {
        self.work.next("calibrating the virtual bench", BENCH);
        let bench = VirtualBench::new(&self.card.whisker, self.args.seed, self.folder)
            .context("calibrating the virtual bench")?;
        eprintln!(
            "virtual bench: {} act; verify says {:?} and accepts {:?}",
            bench.acting.join(", "),
            bench.verdict,
            bench.accepted
        );
        let objects = |names: &[String]| -> anyhow::Result<Meshes> {
            meshes(names.iter().take(self.args.objects), self.args)
        };
        let (seen, unseen) = (objects(&self.card.objects.training)?, objects(&self.card.objects.unseen)?);
        let sweeps = Sweeps::of(self.card, self.args);
        self.work.next("virtual bench", ON_BENCH * sweeps.real);
        let (real, ablations) = self.virtual_real(&bench, &seen, &unseen, &sweeps)?;
        self.work.next("upright objects", SWEEP * sweeps.faces);
        let mut all = BTreeMap::from([
            ("faces", self.faces(&seen, &unseen)?),
            ("virtual_real", real),
            ("ablations", ablations),
            ("known_motion", known_motion(&bench)),
        ]);
        if !self.args.quick {
            all.insert("speed", self.speeds(&unseen, &sweeps)?);
            all.insert("sim2real", self.sim_to_real(&bench, &sweeps)?);
        }
        Ok(all)
    }

    /// Seed of sweeps that are drawn on the spot.
    fn seed(&self) -> u64 {
        self.args.seed ^ ON_THE_SPOT
    }

    /// Table I as the paper draws it: objects upright, four faces in turn, sweeps with a contact jump left out. A few lost sweeps make most of
    /// the error: there are `UPRIGHT` times as many as of the others, but where the speed is not known. Steps are short: long ones hide small
    /// jumps.
    fn faces(&self, seen: &Meshes, unseen: &Meshes) -> anyhow::Result<Value> {
        let plan = SweepPlan {
            turn: Turn::Faces,
            keep_jumps: false,
            rate_hz: RATE_HZ,
            step_mm: JUMPS_TOLD_MM,
            ..SweepPlan::default()
        };
        let fewer = self.args.sweeps_each.next_multiple_of(FACES);
        let order = SweepRequest {
            whisker: &self.card.whisker,
            plan: &plan,
            seed: self.seed(),
            sweeps: upright(self.args) * fewer,
        };
        let sets = [("seen", seen), ("unseen", unseen)];
        let mut all_series = [self.all_series(seen, &order)?, self.all_series(unseen, &order)?];
        let rows = |all_series: &[SeriesByObject; 2], known: bool| -> anyhow::Result<Value> {
            let score = |k: usize| {
                score_objects(
                    &|c: &SweepSeries| Method::Network(self.tracker, known).run(c),
                    &all_series[k],
                    sets[k].1,
                )
            };
            let [seen, unseen] = [score(0)?, score(1)?];
            let objects = seen.iter().map(|o| object(o, "seen"));
            let objects = objects.chain(unseen.iter().map(|o| object(o, "unseen")));
            let means = |rows: &[ObjectScores]| mean(rows, |o| o.all.rmse_mm);
            Ok(json!({"seen_mean_mm": means(&seen), "unseen_mean_mm": means(&unseen),
                "interval95": both_means(&seen, &unseen), "objects": objects.collect::<Vec<Value>>()}))
        };
        let mut table = rows(&all_series, true)?;
        all_series.iter_mut().flat_map(BTreeMap::values_mut).for_each(|all| all.truncate(fewer));
        table["speed_not_known"] = rows(&all_series, false)?;
        Ok(table)
    }

    fn all_series(&self, meshes: &Meshes, order: &SweepRequest<'_>) -> anyhow::Result<SeriesByObject> {
        let mut all = SeriesByObject::new();
        for (name, mesh) in meshes {
            let all_series = generate_sweeps(mesh, order)?;
            if !all_series.is_empty() {
                all.insert(name.clone(), all_series);
            }
        }
        Ok(all)
    }

    fn on_bench(
        &self,
        bench: &VirtualBench,
        meshes: &Meshes,
        medium: Medium,
    ) -> anyhow::Result<SeriesByObject> {
        let plan = VirtualBench::plan(medium);
        let (seed, sweeps) = (self.seed(), self.args.sweeps_each);
        self.all_series(meshes, &SweepRequest { whisker: &bench.whisker, plan: &plan, seed, sweeps })
    }

    fn through(
        &self,
        bench: &VirtualBench,
        by: &CalibrationModel,
        all_series: &SeriesByObject,
    ) -> anyhow::Result<SeriesByObject> {
        let one = |(name, all): (&String, &Vec<SweepSeries>)| {
            let seen = all.iter().map(|c| bench.through(c, by, self.args.seed, self.folder));
            Ok((name.clone(), seen.collect::<anyhow::Result<Vec<SweepSeries>>>()?))
        };
        all_series.iter().map(one).collect()
    }

    /// The tracker with the measurement noise of a calibration and the standard deviations of a stream, as `wcal track` has it.
    fn on_stream(&self, by: &CalibrationModel) -> Tracker {
        Tracker {
            filters: filters_for(self.tracker.filters, by),
            sd_factors: self.card.sd_factors_of_stream(),
            ..self.tracker.clone()
        }
    }

    fn virtual_real(
        &self,
        bench: &VirtualBench,
        seen: &Meshes,
        unseen: &Meshes,
        sweeps: &Sweeps,
    ) -> anyhow::Result<(Value, Value)> {
        let by = bench.verified.as_ref().unwrap_or(&bench.map);
        let multi_mu = filters_for(BayesSettings::multi_mu().into(), by).frictional;
        let tracker = self.on_stream(by);
        let score = |meshes: &Meshes, all_series: &SeriesByObject, known: bool| {
            score_objects(&|c: &SweepSeries| Method::Network(&tracker, known).run(c), all_series, meshes)
        };
        let [true_seen, true_unseen] =
            [self.on_bench(bench, seen, Medium::Air)?, self.on_bench(bench, unseen, Medium::Air)?];
        let rows_seen = score(seen, &self.through(bench, by, &true_seen)?, true)?;
        let measured = self.through(bench, by, &true_unseen)?;
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
        self.work.next("ablations", ABLATION * sweeps.ablations);
        let damped = |all_series: &SeriesByObject| -> SeriesByObject {
            all_series.iter().map(|(n, all)| (n.clone(), all.iter().map(damped).collect())).collect()
        };
        let row = |name: &str, rows: Vec<ObjectScores>| {
            json!({"name": name, "rmse_mm": means(&rows), "followed_rmse_mm": mean(&rows, |o| o.followed.rmse_mm),
                "true_contact_rmse_mm": mean(&rows, |o| o.all.true_contact_rmse_mm), "p95_mm": mean(&rows, |o| o.all.p95_mm),
                "interval95": intervals(&rows)})
        };
        let mut ablations = vec![
            row("effects-accepted", rows_unseen),
            row(
                "effects-not-accepted",
                score(unseen, &self.through(bench, &bench.map, &true_unseen)?, true)?,
            ),
            row("moments-without-error", score(unseen, &true_unseen, true)?),
            row("speed-not-known", score(unseen, &measured, false)?),
            row("horizon-1", score_objects(&later, &measured, unseen)?),
            row("damping-bias", score(unseen, &damped(&measured), true)?),
            row(
                "bayes-filter",
                score_objects(
                    &|c: &SweepSeries| Method::Bayes(&tracker.inverse, true, &multi_mu).run(c),
                    &measured,
                    unseen,
                )?,
            ),
        ];
        for (name, map) in &bench.maps {
            let rows = score(unseen, &self.through(bench, map, &true_unseen)?, true)?;
            ablations.push(row(&format!("map-{name}"), rows));
        }
        Ok((real, Value::Array(ablations)))
    }

    fn speeds(&self, meshes: &Meshes, sweeps: &Sweeps) -> anyhow::Result<Value> {
        let mut rows = Vec::new();
        for speed in SPEEDS_MM_S {
            self.work.next("speeds", SWEEP * sweeps.speeds / SPEEDS_MM_S.len() as f64);
            let run = |speed_mm_s: [f64; 2], acceleration_mm_s2: f64| -> anyhow::Result<Mean> {
                let plan =
                    SweepPlan { speed_mm_s, acceleration_mm_s2, rate_hz: RATE_HZ, ..SweepPlan::default() };
                let (seed, sweeps) = (self.seed(), self.args.sweeps_each);
                let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed, sweeps };
                let all_series = self.all_series(meshes, &order)?;
                let rows = score_objects(
                    &|c: &SweepSeries| Method::Network(self.tracker, true).run(c),
                    &all_series,
                    meshes,
                )?;
                Ok(mean_with_interval(&rows))
            };
            let constant = run([speed, speed], 0.0)?;
            let random = run(RANDOM.map(|r| r * speed), RANDOM_MM_S2)?;
            rows.push(json!({"mm_s": speed, "constant_mm": constant.0, "random_mm": random.0,
                "interval95": {"constant_mm": constant.1, "random_mm": random.1}}));
        }
        Ok(Value::Array(rows))
    }

    fn sim_to_real(&self, bench: &VirtualBench, sweeps: &Sweeps) -> anyhow::Result<Value> {
        let by = bench.verified.as_ref().unwrap_or(&bench.map);
        let tracker = self.on_stream(by);
        let mut rows = Vec::new();
        for name in SIM_TO_REAL {
            self.work.next("air and water", ON_BENCH * sweeps.media / SIM_TO_REAL.len() as f64);
            let name = name.to_owned();
            let Ok(mesh) = meshes(std::iter::once(&name), self.args) else {
                eprintln!("table III: {name}: no mesh; left out");
                continue;
            };
            let plan = SweepPlan { rate_hz: RATE_HZ, ..SweepPlan::default() };
            let (seed, sweeps) = (self.seed(), self.args.sweeps_each);
            let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed, sweeps };
            let score = |all_series: &SeriesByObject, tracker: &Tracker| -> anyhow::Result<Mean> {
                let rows = score_objects(
                    &|c: &SweepSeries| Method::Network(tracker, true).run(c),
                    all_series,
                    &mesh,
                )?;
                Ok(mean_with_interval(&rows))
            };
            let simulation = score(&self.all_series(&mesh, &order)?, self.tracker)?;
            let mut media = Vec::new();
            for medium in [Medium::Air, Medium::Water] {
                let all_series = self.on_bench(bench, &mesh, medium)?;
                media.push(score(&self.through(bench, by, &all_series)?, &tracker)?);
            }
            rows.push(json!({"name": name, "seen": self.card.objects.training.contains(&name),
                "simulation_mm": simulation.0, "air_mm": media[0].0, "water_mm": media[1].0,
                "interval95": {"simulation_mm": simulation.1, "air_mm": media[0].1, "water_mm": media[1].1}}));
        }
        Ok(Value::Array(rows))
    }
}

/// Mean over objects of the RMSE with its 95 % interval, mm.
type Mean = (f64, Option<[f64; 2]>);

fn mean_with_interval(rows: &[ObjectScores]) -> Mean {
    (mean(rows, |o| o.all.rmse_mm), mean_interval95(rows, |s| s.surface))
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

/// Slope of an error over the speed by least squares, s.
pub fn slope_s(rows: &[Value], key: &str) -> f64 {
    let points: Vec<[f64; 2]> =
        rows.iter().filter_map(|r| Some([r["mm_s"].as_f64()?, r[key].as_f64()?])).collect();
    let n = points.len().max(1) as f64;
    let middle = points.iter().fold([0.0; 2], |a, p| [a[0] + p[0] / n, a[1] + p[1] / n]);
    let sum =
        |f: fn([f64; 2]) -> f64| points.iter().map(|p| f([p[0] - middle[0], p[1] - middle[1]])).sum::<f64>();
    sum(|[x, y]| x * y) / sum(|[x, _]| x * x).max(1e-12)
}
