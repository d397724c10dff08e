//! The sweep dataset: blocks of sweeps over objects on all cores, written shard by shard, taken up
//! again where it stopped.

pub mod columns;
pub mod engine;
pub mod mujoco;
pub mod read;
pub mod recipe;
pub mod shard;

pub use engine::{RodSweeps, SweepEngine};
pub use mujoco::MujocoSweeps;

use crate::LabError;
use engine::BlockTask;
use rayon::prelude::*;
use serde_json::json;
use shard::Manifest;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use wcal_core::observation::WhiskerSpec;
use wcal_core::provenance::{canonical_json, sha256_hex};
use wcal_lab_sweeps::SweepPlan;
use wcal_lab_sweeps::rod_comparison::ComparisonSum;
use wcal_mesh::Mesh;

/// Sweeps in a shard.
pub const BLOCK: u64 = 25;

/// What is to be made.
#[derive(Debug, Clone)]
pub struct Dataset {
    /// Engine.
    pub engine: Arc<dyn SweepEngine>,
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
    /// MuJoCo's sweeps beside the rod's.
    pub against_rod: Option<ComparisonSum>,
    /// Shards that were there, could not be used and were made again, with the reason.
    pub again: Vec<String>,
}

/// A shard that is not there or cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingShard {
    /// Its name, without endings.
    pub name: String,
    /// Why.
    pub why: String,
}

/// What lies in a dataset's folder.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Survey {
    /// By object, of the shards that are whole.
    pub totals: BTreeMap<String, Total>,
    /// The others.
    pub missing: Vec<MissingShard>,
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
        for note in manifest
            .notes
            .iter()
            .filter(|n| !self.notes.contains(n))
            .collect::<Vec<_>>()
        {
            self.notes.push(note.clone());
        }
        if let Some(more) = &manifest.against_rod {
            self.against_rod.get_or_insert_default().merge(more);
        }
        if made {
            self.made += manifest.sweeps[1];
            self.core_s += manifest.core_s.unwrap_or(0.0);
        }
    }

    /// Sweeps kept.
    pub fn kept(&self) -> u64 {
        self.verdicts.get("kept").copied().unwrap_or(0)
    }

    /// Sweeps a second and core of what was made now.
    pub fn sweeps_per_core_s(&self) -> Option<f64> {
        (self.core_s > 0.0).then(|| self.made as f64 / self.core_s)
    }
}

impl Dataset {
    /// Names of this share's shards, with object and first sweep, in a fixed order.
    fn blocks(&self) -> Vec<(usize, u64)> {
        let per_object = self.sweeps.div_ceil(BLOCK);
        let all =
            (0..self.objects.len()).flat_map(|o| (0..per_object).map(move |b| (o, b * BLOCK)));
        let [share, shares] = self.share;
        all.enumerate()
            .filter(|(k, _)| k % shares == share)
            .map(|(_, block)| block)
            .collect()
    }

    /// SHA-256 of what an object's tables follow from, as canonical JSON: engine, whisker, plan,
    /// seed and the mesh's own hash.
    ///
    /// # Errors
    /// Where a value cannot be written as JSON.
    pub(crate) fn made_from(&self, mesh: &Mesh) -> Result<String, LabError> {
        let fault = |e: serde_json::Error| LabError::Value {
            what: "dataset".to_owned(),
            expected: "values that JSON can hold".to_owned(),
            found: e.to_string(),
        };
        let identity = json!({
            "engine": self.engine.identity(),
            "whisker": serde_json::to_value(&self.whisker).map_err(fault)?,
            "plan": serde_json::to_value(&self.plan).map_err(fault)?,
            "seed": self.seed,
            "mesh": mesh.sha256(),
        });
        Ok(sha256_hex(canonical_json(&identity).as_bytes()))
    }

    fn identities(&self) -> Result<Vec<String>, LabError> {
        self.objects
            .par_iter()
            .map(|mesh| self.made_from(mesh))
            .collect()
    }

    /// Names of this share's shards, without endings.
    pub fn shards(&self) -> Vec<String> {
        self.blocks()
            .into_iter()
            .map(|block| self.name(block))
            .collect()
    }

    fn name(&self, (object, first): (usize, u64)) -> String {
        format!("{}-{first:06}", self.objects[object].name)
    }

    /// Reads every shard of this share in `folder` and compares it with its checksums.
    ///
    /// # Errors
    /// Where the dataset has no identity: a value that JSON cannot hold.
    pub fn survey(&self, folder: &Path) -> Result<Survey, LabError> {
        let made_from = self.identities()?;
        let mut survey = Survey::default();
        for block in self.blocks() {
            let (object, first) = block;
            let name = self.name(block);
            match shard::done(folder, &name, &made_from[object], [first, self.size(first)]) {
                Ok(manifest) => {
                    survey
                        .totals
                        .entry(self.objects[object].name.clone())
                        .or_default()
                        .add(&manifest, true);
                }
                Err(e) => survey.missing.push(MissingShard {
                    name,
                    why: e.to_string(),
                }),
            }
        }
        Ok(survey)
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
    ) -> Result<BTreeMap<String, Total>, LabError> {
        self.plan.check()?;
        // Before anything is written.
        self.engine.check(&self.plan)?;
        self.claim(folder)?;
        let made_from = self.identities()?;
        let blocks = self.blocks();
        let all: u64 = blocks.iter().map(|(_, first)| self.size(*first)).sum();
        let done = std::sync::atomic::AtomicU64::new(0);
        let shards: Vec<(usize, Manifest, bool, Option<String>)> = blocks
            .par_iter()
            .map(|&(object, first)| {
                let mesh = &self.objects[object];
                let (name, size) = (self.name((object, first)), self.size(first));
                let there = shard::done(folder, &name, &made_from[object], [first, size]);
                // A shard that is there and cannot be used is reported; one that was never made is
                // no news.
                let was_there = folder.join(format!("{name}.json")).exists();
                let again = there
                    .as_ref()
                    .err()
                    .filter(|_| was_there)
                    .map(|why| format!("{name}: {why}"));
                let made = there.is_err();
                let manifest = match there {
                    Ok(manifest) => manifest,
                    Err(_) => {
                        let begin_s = thread_s();
                        let block = self.engine.run_block(&BlockTask {
                            whisker: &self.whisker,
                            plan: &self.plan,
                            seed: self.seed,
                            mesh,
                            sweeps: first..first + size,
                            folder,
                        })?;
                        let core_s = thread_s() - begin_s + block.other_core_s;
                        shard::write(
                            folder,
                            &name,
                            &mesh.name,
                            &made_from[object],
                            &block,
                            core_s,
                        )?
                    }
                };
                let before = done.fetch_add(size, std::sync::atomic::Ordering::SeqCst);
                progress(before + size, all);
                Ok((object, manifest, made, again))
            })
            .collect::<Result<_, LabError>>()?;
        let mut totals: BTreeMap<String, Total> = BTreeMap::new();
        for (object, manifest, made, again) in shards {
            let total = totals.entry(self.objects[object].name.clone()).or_default();
            total.add(&manifest, made);
            total.again.extend(again);
        }
        Ok(totals)
    }
}

/// Processor time of this thread, s: what a sweep costs, whoever else computes on the machine.
pub fn thread_s() -> f64 {
    cpu_s(rustix::time::ClockId::ThreadCPUTime)
}

/// Processor time of all threads of this program, s.
pub fn process_s() -> f64 {
    cpu_s(rustix::time::ClockId::ProcessCPUTime)
}

fn cpu_s(clock: rustix::time::ClockId) -> f64 {
    let now = rustix::time::clock_gettime(clock);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::Dataset;
    use super::engine::{Block, BlockTask};
    use super::{RodSweeps, SweepEngine};
    use crate::LabError;
    use serde_json::{Value, json};
    use std::sync::Arc;
    use wcal_core::observation::WhiskerSpec;
    use wcal_lab_sweeps::{SweepPlan, objects};

    /// An engine of that identity.
    #[derive(Debug)]
    struct Named(Value);

    impl SweepEngine for Named {
        fn identity(&self) -> Value {
            self.0.clone()
        }

        fn check(&self, _: &SweepPlan) -> Result<(), LabError> {
            Ok(())
        }

        fn run_block(&self, _: &BlockTask<'_>) -> Result<Block, LabError> {
            Ok(Block::default())
        }
    }

    /// The identity follows from values alone, so a plan that was read in another order or by its
    /// newer names is the same; any other value is another identity.
    #[test]
    fn the_identity_is_of_values_not_of_their_order() {
        let dataset = |plan: &str, engine: Arc<dyn SweepEngine>| Dataset {
            engine,
            whisker: WhiskerSpec::nominal(),
            plan: serde_json::from_str(plan).unwrap(),
            objects: vec![objects::built_in("block").unwrap()],
            sweeps: 1,
            seed: 7,
            share: [0, 1],
        };
        let rod = || -> Arc<dyn SweepEngine> { Arc::new(RodSweeps) };
        let of = |d: &Dataset| d.made_from(&d.objects[0]).unwrap();
        let written = r#"{"most_mm": 4.0, "rate_hz": 2.0, "most_strain": 0.01}"#;
        let own = dataset(written, rod());
        let reordered = r#"{"max_strain": 0.01, "rate_hz": 2.00, "max_travel_mm": 4}"#;
        assert_eq!(of(&own), of(&dataset(reordered, rod())));
        let engine = |json: Value| of(&dataset(written, Arc::new(Named(json))));
        assert_eq!(
            engine(json!({"name": "a", "links": 2})),
            engine(json!({"links": 2, "name": "a"}))
        );
        // Pinned: an identity that changed would orphan every dataset there is.
        assert_eq!(
            of(&own),
            "070ae562acb415a24cbbaa346859a15c4df2548c812bdb3af7ae32821db37d2b"
        );

        // Negative controls: each value that tables follow from.
        let mut whisker = own.clone();
        whisker.whisker.youngs_gpa += 1.0;
        let mesh = objects::built_in("can").unwrap();
        let others = [
            ("plan", of(&dataset(&written.replace("4.0", "5.0"), rod()))),
            (
                "seed",
                of(&Dataset {
                    seed: 8,
                    ..own.clone()
                }),
            ),
            ("whisker", of(&whisker)),
            ("mesh", own.made_from(&mesh).unwrap()),
            ("engine", engine(json!({"name": "a", "links": 2}))),
            ("engine's value", engine(json!({"name": "a", "links": 3}))),
        ];
        for (k, (what, other)) in others.iter().enumerate() {
            assert_ne!(*other, of(&own), "{what}");
            assert!(
                others[..k].iter().all(|(_, before)| before != other),
                "{what}"
            );
        }
    }
}
