//! The sweep dataset: blocks of sweeps over objects on all cores, written shard by shard, taken up again where it stopped.

use crate::rod_engine::{LINKS, RodEngine};
use crate::shard::{self, Manifest, Outcome};
use crate::{Mesh, Sweep, SweepPlan, TwinError};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;
use wcal_core::observation::WhiskerSpec;
use wcal_core::provenance::sha256_hex;

/// Sweeps in a shard.
pub const BLOCK: u64 = 25;

/// What is to be made.
#[derive(Debug, Clone)]
pub struct Dataset {
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
    /// Core seconds of what was made now.
    pub core_s: f64,
    /// Sweeps made now: the others were there already.
    pub made: u64,
}

impl Total {
    fn add(&mut self, manifest: &Manifest, made: bool) {
        self.sweeps += manifest.sweeps[1];
        self.samples += manifest.samples;
        for (verdict, count) in &manifest.verdicts {
            *self.verdicts.entry(verdict.clone()).or_default() += count;
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

impl Dataset {
    /// Names of this share's shards, with object and first sweep, in a fixed order.
    fn blocks(&self) -> Vec<(usize, u64)> {
        let per_object = self.sweeps.div_ceil(BLOCK);
        let all = (0..self.objects.len()).flat_map(|o| (0..per_object).map(move |b| (o, b * BLOCK)));
        let [share, shares] = self.share;
        all.enumerate().filter(|(k, _)| k % shares == share).map(|(_, block)| block).collect()
    }

    /// SHA-256 of what an object's tables follow from.
    fn made_from(&self, mesh: &Mesh) -> String {
        let mut bytes = format!("rod {LINKS} {:?} {:?} {}", self.whisker, self.plan, self.seed).into_bytes();
        for p in mesh.points() {
            p.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
        }
        mesh.triangles().iter().flatten().for_each(|k| bytes.extend(k.to_le_bytes()));
        sha256_hex(&bytes)
    }

    /// Makes what is missing in `folder`; `progress` hears of every shard: sweeps done and in all.
    ///
    /// # Errors
    /// Where the plan or wire cannot be, or the folder cannot be written.
    pub fn make(
        &self,
        folder: &Path,
        progress: impl Fn(u64, u64) + Sync,
    ) -> Result<BTreeMap<String, Total>, TwinError> {
        self.plan.check()?;
        std::fs::create_dir_all(folder).map_err(TwinError::io("creating", folder))?;
        let engine = RodEngine::new(&self.whisker, LINKS)?;
        let made_from: Vec<String> = self.objects.iter().map(|mesh| self.made_from(mesh)).collect();
        let blocks = self.blocks();
        let size = |first: u64| BLOCK.min(self.sweeps - first);
        let all: u64 = blocks.iter().map(|(_, first)| size(*first)).sum();
        let done = std::sync::atomic::AtomicU64::new(0);
        let shards: Vec<(usize, Manifest, bool)> = blocks
            .par_iter()
            .map(|&(object, first)| {
                let mesh = &self.objects[object];
                let name = format!("{}-{first:06}", mesh.name);
                let there = shard::is_done(folder, &name, &made_from[object]);
                let there = there.filter(|m| m.sweeps == [first, size(first)]);
                let made = there.is_none();
                let manifest = match there {
                    Some(manifest) => manifest,
                    None => {
                        let begin = Instant::now();
                        let outcomes = self.block(&engine, mesh, first, size(first));
                        let core_s = begin.elapsed().as_secs_f64();
                        shard::write(folder, &name, &mesh.name, &made_from[object], &outcomes, core_s)?
                    }
                };
                let before = done.fetch_add(size(first), std::sync::atomic::Ordering::SeqCst);
                progress(before + size(first), all);
                Ok((object, manifest, made))
            })
            .collect::<Result<_, TwinError>>()?;
        let mut totals: BTreeMap<String, Total> = BTreeMap::new();
        for (object, manifest, made) in &shards {
            totals.entry(self.objects[*object].name.clone()).or_default().add(manifest, *made);
        }
        Ok(totals)
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
