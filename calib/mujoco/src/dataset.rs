//! The sweep dataset: blocks of sweeps over objects on all cores, written shard by shard, taken up again where it stopped.

use crate::against::{self, AgainstRod};
use crate::cable_engine::{self, CableEngine};
use crate::convex::Convex;
use crate::mjcf::MjcfOptions;
use crate::rod_engine::{LINKS, RodEngine, Run};
use crate::shard::{self, Beside, Manifest, Outcome};
use crate::{Mesh, MujocoEngine, Sweep, SweepPlan, TwinError};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use wcal_core::observation::WhiskerSpec;
use wcal_core::provenance::sha256_hex;

/// Sweeps in a shard.
pub const BLOCK: u64 = 25;
/// Folder of the convex parts, in the dataset's.
const CONVEX: &str = "convex";

/// What runs the sweeps.
#[derive(Debug, Clone, Default)]
pub enum SweepEngine {
    /// The quasi-static rod.
    #[default]
    Rod,
    /// MuJoCo: inertia, damping, soft contacts with convex parts.
    Mujoco(Box<MjcfOptions>),
}

/// Corners of an object's parts, mm.
type Corners = Arc<Vec<Vec<Vector3<f64>>>>;
/// What is known of them; an object that cannot be taken apart has the reason instead.
type Parts = Mutex<Option<Result<Corners, String>>>;

/// What is to be made.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Engine.
    pub engine: SweepEngine,
    /// Wire.
    pub whisker: WhiskerSpec,
    /// How sweeps are drawn.
    pub plan: SweepPlan,
    /// Objects.
    pub objects: Vec<Mesh>,
    /// Sweeps an object.
    pub sweeps: u64,
    /// Seed of all draws.
    pub seed: u64,
    /// Share of the work: the `i`-th of `n`, from 0.
    pub share: [usize; 2],
}

/// What an object or all of them gave.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Total {
    /// Sweeps, and samples.
    pub sweeps: u64,
    /// See `sweeps`.
    pub samples: u64,
    /// By verdict.
    pub verdicts: BTreeMap<String, u64>,
    /// Onsets, releases, jumps and slips.
    pub events: BTreeMap<String, u64>,
    /// Processor seconds of what was made now; in a survey, of all.
    pub core_s: f64,
    /// Sweeps made now: the others were there already. In a survey all.
    pub made: u64,
    /// What went wrong with the object or the engine, in words.
    pub notes: Vec<String>,
    /// Shards that were there, could not be used and were made again, with the reason.
    pub again: Vec<String>,
}

/// A shard that is not there or cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Missing {
    /// Its name, without endings.
    pub name: String,
    /// Number among the shards surveyed, from 0: it belongs to share `number % n` of `n`.
    pub number: usize,
    /// Why.
    pub why: String,
}

/// What lies in a dataset's folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Survey {
    /// By object, of the shards that are whole.
    pub totals: BTreeMap<String, Total>,
    /// The others.
    pub missing: Vec<Missing>,
    /// Shards that there should be.
    pub shards: usize,
}

impl Total {
    fn add(&mut self, manifest: &Manifest, made: bool) {
        self.sweeps += manifest.sweeps[1];
        self.samples += manifest.samples;
        for (verdict, count) in &manifest.verdicts {
            *self.verdicts.entry(verdict.clone()).or_default() += count;
        }
        for (event, count) in &manifest.events {
            *self.events.entry(event.clone()).or_default() += count;
        }
        for note in manifest.notes.iter().filter(|n| !self.notes.contains(n)).collect::<Vec<_>>() {
            self.notes.push(note.clone());
        }
        if made {
            self.made += manifest.sweeps[1];
            self.core_s += manifest.core_s.unwrap_or(0.0);
        }
    }

    /// Sweeps kept.
    #[must_use]
    pub fn kept(&self) -> u64 {
        self.verdicts.get("kept").copied().unwrap_or(0)
    }

    /// Sweeps a second and core of what was made now.
    #[must_use]
    pub fn sweeps_per_core_s(&self) -> Option<f64> {
        (self.core_s > 0.0).then(|| self.made as f64 / self.core_s)
    }
}

/// How the rod is solved: its centre line between the links, and its contacts. Tables made otherwise are not the same.
const SOLVED: &str = "spline of third order, facets kept";

impl Dataset {
    /// Names of this share's shards, with object and first sweep, in a fixed order.
    fn blocks(&self) -> Vec<(usize, u64)> {
        let per_object = self.sweeps.div_ceil(BLOCK);
        let all = (0..self.objects.len()).flat_map(|o| (0..per_object).map(move |b| (o, b * BLOCK)));
        let [share, shares] = self.share;
        all.enumerate().filter(|(k, _)| k % shares == share).map(|(_, block)| block).collect()
    }

    /// SHA-256 of what an object's tables follow from.
    pub(crate) fn made_from(&self, mesh: &Mesh) -> String {
        let engine = match &self.engine {
            SweepEngine::Rod => format!("rod {LINKS} {SOLVED}"),
            SweepEngine::Mujoco(options) => format!("mujoco {options:?} beside rod {LINKS} {SOLVED}"),
        };
        let mut bytes = format!("{engine} {:?} {:?} {}", self.whisker, self.plan, self.seed).into_bytes();
        for p in mesh.points() {
            p.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        }
        mesh.triangles().iter().flatten().for_each(|k| bytes.extend(k.to_le_bytes()));
        sha256_hex(&bytes)
    }

    /// Names of this share's shards, without endings.
    #[must_use]
    pub fn shards(&self) -> Vec<String> {
        self.blocks().into_iter().map(|block| self.name(block)).collect()
    }

    fn name(&self, (object, first): (usize, u64)) -> String {
        format!("{}-{first:06}", self.objects[object].name)
    }

    /// Reads every shard of this share in `folder` and compares it with its checksums.
    #[must_use]
    pub fn survey(&self, folder: &Path) -> Survey {
        let made_from: Vec<String> = self.objects.par_iter().map(|mesh| self.made_from(mesh)).collect();
        let mut survey = Survey::default();
        for (number, block) in self.blocks().into_iter().enumerate() {
            let (object, first) = block;
            let name = self.name(block);
            survey.shards += 1;
            match shard::done(folder, &name, &made_from[object], [first, self.size(first)]) {
                Ok(manifest) => {
                    survey.totals.entry(self.objects[object].name.clone()).or_default().add(&manifest, true);
                }
                Err(e) => survey.missing.push(Missing { name, number, why: e.to_string() }),
            }
        }
        survey
    }

    /// Sweeps in the shard that begins with `first`.
    fn size(&self, first: u64) -> u64 {
        BLOCK.min(self.sweeps - first)
    }

    /// Makes what is missing in `folder`; `progress` hears of every shard: sweeps done and in all.
    ///
    /// # Errors
    /// Where the plan or wire cannot be, the folder holds another dataset, or cannot be written.
    pub fn make(
        &self,
        folder: &Path,
        progress: impl Fn(u64, u64) + Sync,
    ) -> Result<BTreeMap<String, Total>, TwinError> {
        self.plan.check()?;
        // Before anything is written.
        if let SweepEngine::Mujoco(_) = self.engine {
            if let Some(onset) = self.plan.physics.softening_onset_per_m {
                return Err(cable_engine::no_softening(&format!("{onset:?}")));
            }
            MujocoEngine::start()?;
        }
        self.claim(folder)?;
        let engine = RodEngine::new(&self.whisker, LINKS)?;
        let made_from: Vec<String> = self.objects.par_iter().map(|mesh| self.made_from(mesh)).collect();
        let parts: Vec<Parts> = self.objects.iter().map(|_| Parts::default()).collect();
        let blocks = self.blocks();
        let all: u64 = blocks.iter().map(|(_, first)| self.size(*first)).sum();
        let done = std::sync::atomic::AtomicU64::new(0);
        let shards: Vec<(usize, Manifest, bool, Option<String>)> = blocks
            .par_iter()
            .map(|&(object, first)| {
                let mesh = &self.objects[object];
                let (name, size) = (self.name((object, first)), self.size(first));
                let there = shard::done(folder, &name, &made_from[object], [first, size]);
                // A shard that is there and cannot be used is told; one that was never made is no news.
                let was_there = folder.join(format!("{name}.json")).exists();
                let again = there.as_ref().err().filter(|_| was_there).map(|why| format!("{name}: {why}"));
                let made = there.is_err();
                let manifest = match there {
                    Ok(manifest) => manifest,
                    Err(_) => {
                        let begin_s = thread_s();
                        let (outcomes, beside, engine_s) = match &self.engine {
                            SweepEngine::Rod => (self.block(&engine, mesh, first, size), None, 0.0),
                            SweepEngine::Mujoco(options) => {
                                let parts = self.parts(mesh, &folder.join(CONVEX), &parts[object])?;
                                self.block_by_mujoco(options, &engine, &parts, mesh, first, size)?
                            }
                        };
                        let core_s = thread_s() - begin_s + engine_s;
                        let made_from = &made_from[object];
                        shard::write(
                            folder,
                            &name,
                            &mesh.name,
                            made_from,
                            &outcomes,
                            beside.as_ref(),
                            core_s,
                        )?
                    }
                };
                let before = done.fetch_add(size, std::sync::atomic::Ordering::SeqCst);
                progress(before + size, all);
                Ok((object, manifest, made, again))
            })
            .collect::<Result<_, TwinError>>()?;
        let mut totals: BTreeMap<String, Total> = BTreeMap::new();
        for (object, manifest, made, again) in shards {
            let total = totals.entry(self.objects[object].name.clone()).or_default();
            total.add(&manifest, made);
            total.again.extend(again);
        }
        Ok(totals)
    }

    /// The convex parts that MuJoCo's sweeps in `folder` were made with, by object; those that are there.
    #[must_use]
    pub fn convex(&self, folder: &Path) -> BTreeMap<String, Convex> {
        let there = |mesh: &Mesh| Some((mesh.name.clone(), Convex::kept(mesh, &folder.join(CONVEX)).ok()??));
        self.objects.iter().filter_map(there).collect()
    }

    /// MuJoCo's sweeps in `folder` against the rod's, over the shards that are there; none by another engine.
    ///
    /// # Errors
    /// Where a shard cannot be read.
    pub fn against_rod(&self, folder: &Path) -> Result<Option<AgainstRod>, TwinError> {
        if matches!(self.engine, SweepEngine::Rod) {
            return Ok(None);
        }
        let mut names = self.shards();
        names.retain(|name| folder.join(format!("{name}.json")).exists());
        against::of_shards(folder, &names, &against::edges(&self.plan)).map(Some)
    }

    fn block(&self, engine: &RodEngine, mesh: &Mesh, first: u64, count: u64) -> Vec<Outcome> {
        (first..first + count)
            .map(|index| {
                let sweep = Sweep::draw(mesh, &self.plan, self.seed, index, engine.reach_mm());
                (
                    index,
                    sweep.map(|sweep| {
                        let run = engine.run(mesh, &sweep, &self.plan);
                        (sweep, run)
                    }),
                )
            })
            .collect()
    }
}

impl Dataset {
    /// An object's parts: looked for once a run, whichever shard asks first, also where CoACD dies or hangs over them.
    fn parts(&self, mesh: &Mesh, folder: &Path, known: &Parts) -> Result<Result<Corners, String>, TwinError> {
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = &*known {
            return Ok(known.clone());
        }
        let found = match Convex::of(mesh, folder) {
            // An object that cannot be taken apart: its sweeps are rejected, the others' go on.
            Err(e @ (TwinError::Mesh { .. } | TwinError::EngineDied(_))) => {
                Err(format!("no convex parts: {e}"))
            }
            other => Ok(Arc::new(other?.corners())),
        };
        Ok(known.insert(found).clone())
    }

    /// Outcomes, the rod's on the same sweeps, and the processor time of the engine's own process, s.
    fn block_by_mujoco(
        &self,
        options: &MjcfOptions,
        rod: &RodEngine,
        parts: &Result<Corners, String>,
        mesh: &Mesh,
        first: u64,
        count: u64,
    ) -> Result<(Vec<Outcome>, Option<Beside>, f64), TwinError> {
        let mut beside = Beside::default();
        beside.notes.extend(parts.as_ref().err().cloned());
        let mut engine = CableEngine::start(&self.whisker, options)?;
        let mut outcomes: Vec<Outcome> = Vec::new();
        for index in first..first + count {
            let sweep = Sweep::draw(mesh, &self.plan, self.seed, index, engine.reach_mm());
            beside.quasi.push((index, sweep.as_ref().map(|sweep| rod.run(mesh, sweep, &self.plan))));
            let outcome = match (sweep, parts) {
                (None, _) => None,
                (Some(sweep), Err(_)) => Some((sweep, Run::rejected("no-convex-parts"))),
                (Some(sweep), Ok(parts)) => {
                    let run = engine.run(mesh, parts, &sweep, &self.plan)?;
                    Some((sweep, run))
                }
            };
            outcomes.push((index, outcome));
        }
        beside.notes.extend(engine.refused.take());
        Ok((outcomes, Some(beside), engine.core_s()))
    }
}

/// Processor time of this thread, s: what a sweep costs, whoever else computes on the machine.
#[must_use]
pub fn thread_s() -> f64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}
