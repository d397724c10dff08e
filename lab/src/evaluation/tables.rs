//! The paper's tables II and III, the virtual real bench, and ablations. All of it is SIMULATED.

mod on_bench;
mod upright;

use crate::LabError;
use crate::bootstrap::mean_interval95;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::evaluation::document::{Interval, KnownMotion, MediumRow, SpeedRow, Tables, mean};
use crate::evaluation::virtual_bench::{STREAM_NOISES, VirtualBench};
use crate::evaluation::work::{ABLATION, BENCH, EvaluationProgress, ON_BENCH, SWEEP};
use crate::evaluation::{Order, Surroundings, meshes};
use crate::generate_sweeps::{SweepRequest, generate_sweeps};
use crate::model_file::Card;
use crate::sweep_series::SweepSeries;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_sim::physics::Medium;
use wcal_sim::{Mesh, SweepPlan};
use wcal_track::{StaticInverse, Tracker};

type Meshes = BTreeMap<String, Mesh>;
/// Series by object.
type SeriesByObject = BTreeMap<String, Vec<SweepSeries>>;

/// Speeds of table II, mm/s.
const SPEEDS_MM_S: [f64; 5] = [4.0, 6.0, 8.0, 10.0, 12.0];
/// Rows of the ablations, those of the maps included.
const ABLATIONS: f64 = 11.0;
/// Objects of table III.
const SIM_TO_REAL: [&str; 3] = ["vase", "035_power_drill", "rock"];
/// Bounds of the random speeds as shares, and of their accelerations, mm/s^2.
const RANDOM: [f64; 2] = [0.75, 1.25];
const RANDOM_MM_S2: f64 = 1.0;
/// Readings a second.
const RATE_HZ: f64 = 10.0;
/// Sweeps that were trained on have small seeds: the same number must not draw the same sweeps here.
const ON_THE_SPOT: u64 = 0x6576_616c_7561_7465;

/// What the tables are made with.
pub struct BenchEvaluator<'a> {
    /// Network.
    pub tracker: &'a Tracker,
    /// Its card.
    pub card: &'a Card,
    /// What is asked for.
    pub order: &'a Order<'a>,
    /// What the caller supplies.
    pub around: &'a Surroundings<'a>,
    /// Folder for what is in between.
    pub folder: &'a Path,
    /// How far the work is.
    pub work: &'a EvaluationProgress<'a>,
    /// Curves of inverse solutions of the model's whisker.
    pub curve: &'a StaticInverse,
}

/// Sweeps that are drawn for a table, plain and on the virtual bench, and those that ablations track again.
struct Sweeps {
    faces: f64,
    real: f64,
    ablations: f64,
    speeds: f64,
    media: f64,
    noises: f64,
}

impl Sweeps {
    fn of(card: &Card, order: &Order<'_>) -> Self {
        let objects = |names: &[String]| names.len().min(order.objects) as f64;
        let (each, [seen, unseen]) =
            (order.sweeps_each as f64, [&card.objects.training, &card.objects.unseen].map(|n| objects(n)));
        let faces = upright::sweeps_each(order.sweeps_each, order.quick)[0] as f64;
        Self {
            faces: (seen + unseen) * faces,
            real: (seen + unseen) * each,
            ablations: ABLATIONS * unseen * each,
            speeds: if order.quick { 0.0 } else { 2.0 * SPEEDS_MM_S.len() as f64 * unseen * each },
            media: if order.quick { 0.0 } else { 3.0 * SIM_TO_REAL.len() as f64 * each },
            noises: if order.quick { 0.0 } else { STREAM_NOISES.len() as f64 * unseen * each },
        }
    }
}

/// Cost of all tables (see `work`).
pub fn cost(card: &Card, order: &Order<'_>) -> f64 {
    if order.simulation_only {
        return 0.0;
    }
    let s = Sweeps::of(card, order);
    BENCH + SWEEP * (s.faces + s.speeds) + ON_BENCH * (s.real + s.media + s.noises) + ABLATION * s.ablations
}

/// Known motion: the tracker on the groove of the bench's session by `verify`'s own calibration, beside the posterior Cramer-Rao bound.
fn known_motion(bench: &VirtualBench) -> Option<KnownMotion> {
    bench.calibration.groove.as_ref().map(|g| KnownMotion {
        is_virtual: true,
        error_mm: g.rmse_mm,
        bound_mm: g.bound_mm,
        error_over_bound: g.rmse_mm / g.bound_mm,
        trajectories: g.trajectories,
        trajectories_held: g.trajectories_held,
        readings: g.points,
        split: g.split.clone(),
    })
}

impl BenchEvaluator<'_> {
    /// All tables.
    pub fn tables(&self) -> Result<Tables, LabError> {
        self.work.next("calibrating the virtual bench", BENCH);
        let bench =
            VirtualBench::new(&self.card.whisker, self.order.seed, self.folder, self.around.calibrate)?;
        (self.around.note)(&format!(
            "virtual bench: {} act; verify says {:?} and accepts {:?}",
            bench.acting.join(", "),
            bench.calibration.verdict,
            bench.calibration.accepted
        ));
        let objects = |names: &[String]| -> Result<Meshes, LabError> {
            meshes(names.iter().take(self.order.objects), self.order.meshes, self.around.note)
        };
        let (seen, unseen) = (objects(&self.card.objects.training)?, objects(&self.card.objects.unseen)?);
        let sweeps = Sweeps::of(self.card, self.order);
        self.work.next("virtual bench", ON_BENCH * sweeps.real);
        let (virtual_real, ablations) = self.virtual_real(&bench, &seen, &unseen, sweeps.ablations)?;
        self.work.next("upright objects", SWEEP * sweeps.faces);
        let faces = self.upright(&seen, &unseen)?;
        let (mut speed, mut sim2real, mut noise) = (None, None, None);
        if !self.order.quick {
            speed = Some(self.speeds(&unseen, &sweeps)?);
            sim2real = Some(self.sim_to_real(&bench, &sweeps)?);
            self.work.next("noise of the stream", ON_BENCH * sweeps.noises);
            noise = Some(self.noises(&bench, &unseen)?);
        }
        let known_motion = known_motion(&bench);
        Ok(Tables { ablations, faces, known_motion, noise, sim2real, speed, virtual_real })
    }

    /// Seed of sweeps that are drawn on the spot.
    fn seed(&self) -> u64 {
        self.order.seed ^ ON_THE_SPOT
    }

    fn all_series(&self, meshes: &Meshes, request: &SweepRequest<'_>) -> Result<SeriesByObject, LabError> {
        let mut all = SeriesByObject::new();
        for (name, mesh) in meshes {
            let all_series = generate_sweeps(mesh, request)?;
            if !all_series.is_empty() {
                all.insert(name.clone(), all_series);
            }
        }
        Ok(all)
    }

    fn speeds(&self, meshes: &Meshes, sweeps: &Sweeps) -> Result<Vec<SpeedRow>, LabError> {
        let mut rows = Vec::new();
        for speed in SPEEDS_MM_S {
            self.work.next("speeds", SWEEP * sweeps.speeds / SPEEDS_MM_S.len() as f64);
            let run = |speed_mm_s: [f64; 2], acceleration_mm_s2: f64| -> Result<MeanError, LabError> {
                let plan =
                    SweepPlan { speed_mm_s, acceleration_mm_s2, rate_hz: RATE_HZ, ..SweepPlan::default() };
                let (seed, sweeps) = (self.seed(), self.order.sweeps_each);
                let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed, sweeps };
                let all_series = self.all_series(meshes, &order)?;
                Ok(MeanError::of(&self.score_simulated(&all_series, meshes)?))
            };
            let constant = run([speed, speed], 0.0)?;
            let random = run(RANDOM.map(|r| r * speed), RANDOM_MM_S2)?;
            rows.push(SpeedRow {
                mm_s: speed,
                constant_mm: constant.mean_mm,
                random_mm: random.mean_mm,
                interval95: BTreeMap::from([
                    ("constant_mm", constant.interval95),
                    ("random_mm", random.interval95),
                ]),
            });
        }
        Ok(rows)
    }

    fn sim_to_real(&self, bench: &VirtualBench, sweeps: &Sweeps) -> Result<Vec<MediumRow>, LabError> {
        let by = bench.calibration.best();
        let mut rows = Vec::new();
        for name in SIM_TO_REAL {
            self.work.next("air and water", ON_BENCH * sweeps.media / SIM_TO_REAL.len() as f64);
            let name = name.to_owned();
            let Ok(mesh) = meshes(std::iter::once(&name), self.order.meshes, self.around.note) else {
                (self.around.note)(&format!("table III: {name}: no mesh; left out"));
                continue;
            };
            let plan = SweepPlan { rate_hz: RATE_HZ, ..SweepPlan::default() };
            let (seed, sweeps) = (self.seed(), self.order.sweeps_each);
            let order = SweepRequest { whisker: &self.card.whisker, plan: &plan, seed, sweeps };
            let simulated = self.all_series(&mesh, &order)?;
            let simulation = MeanError::of(&self.score_simulated(&simulated, &mesh)?);
            let in_medium = |medium: Medium| -> Result<MeanError, LabError> {
                let all_series = self.sweeps_on_bench(bench, &mesh, medium)?;
                Ok(MeanError::of(&self.score_measured(bench, by, &all_series, &mesh)?))
            };
            let (air, water) = (in_medium(Medium::Air)?, in_medium(Medium::Water)?);
            rows.push(MediumRow {
                seen: self.card.objects.training.contains(&name),
                name,
                simulation_mm: simulation.mean_mm,
                air_mm: air.mean_mm,
                water_mm: water.mean_mm,
                interval95: BTreeMap::from([
                    ("simulation_mm", simulation.interval95),
                    ("air_mm", air.interval95),
                    ("water_mm", water.interval95),
                ]),
            });
        }
        Ok(rows)
    }

    /// The network with the base's speed known, on moments as the rod engine makes them.
    fn score_simulated(
        &self,
        all_series: &SeriesByObject,
        meshes: &Meshes,
    ) -> Result<Vec<ObjectScores>, LabError> {
        let run = |c: &SweepSeries| Method::Network(self.tracker, true).run(c);
        score_objects(&run, all_series, meshes)
    }
}

/// Mean over objects of the RMSE (mm) with its 95 % interval.
struct MeanError {
    mean_mm: f64,
    interval95: Interval,
}

impl MeanError {
    fn of(rows: &[ObjectScores]) -> Self {
        Self { mean_mm: mean(rows, |o| o.all.rmse_mm), interval95: mean_interval95(rows, |s| s.surface) }
    }
}

/// Slope of an error over the speed by least squares, s, of pairs of speed (mm/s) and error (mm).
pub fn slope_s(points: &[[f64; 2]]) -> f64 {
    let n = points.len().max(1) as f64;
    let middle = points.iter().fold([0.0; 2], |a, p| [a[0] + p[0] / n, a[1] + p[1] / n]);
    let sum =
        |f: fn([f64; 2]) -> f64| points.iter().map(|p| f([p[0] - middle[0], p[1] - middle[1]])).sum::<f64>();
    sum(|[x, y]| x * y) / sum(|[x, _]| x * x).max(1e-12)
}
