//! What runs the sweeps of a dataset: the quasi-static rod here, MuJoCo in [`super::mujoco`].

use crate::LabError;
use serde_json::{Value, json};
use std::fmt::Debug;
use std::ops::Range;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::rod_comparison::ComparisonSum;
use wcal_lab_sweeps::rod_engine::{LINKS, Run};
use wcal_lab_sweeps::{RodEngine, Sweep, SweepPlan};
use wcal_mesh::Mesh;

/// One sweep with what it gave; `None` where its plane misses the object.
pub type Outcome = (u64, Option<(Sweep, Run)>);

/// A block of sweeps over one object.
#[derive(Debug, Clone)]
pub struct BlockTask<'a> {
    /// Wire.
    pub whisker: &'a WhiskerSpec,
    /// How sweeps are drawn.
    pub plan: &'a SweepPlan,
    /// Seed of all draws.
    pub seed: u64,
    /// Object.
    pub mesh: &'a Mesh,
    /// Numbers of the sweeps.
    pub sweeps: Range<u64>,
    /// Folder of the dataset: an engine may keep there what it needs for an object.
    pub folder: &'a Path,
}

/// What a block gave.
#[derive(Debug, Default)]
pub struct Block {
    /// By sweep.
    pub outcomes: Vec<Outcome>,
    /// The quasi-static rod on the same sweeps, where another engine made them.
    pub against_rod: Option<ComparisonSum>,
    /// What went wrong with the object or the engine, in words.
    pub notes: Vec<String>,
    /// Processor time of other processes, s; that of the calling thread is not in it.
    pub other_core_s: f64,
}

/// Runs sweeps for a [`super::Dataset`].
pub trait SweepEngine: Debug + Send + Sync {
    /// What tables follow from besides wire, plan, object and seed; it goes into the dataset's
    /// identity.
    fn identity(&self) -> Value;

    /// Whether it can run a plan here; asked before anything is written.
    ///
    /// # Errors
    /// Where the plan asks for what the engine does not have, or a program is missing.
    fn check(&self, plan: &SweepPlan) -> Result<(), LabError>;

    /// Runs a block.
    ///
    /// # Errors
    /// Where the wire cannot be, or the engine fails for good.
    fn run_block(&self, task: &BlockTask<'_>) -> Result<Block, LabError>;
}

/// How the rod is solved: its centre line between the links, and its contacts. Tables made
/// otherwise are not the same.
const METHOD: &str = "spline of third order, facets kept";

/// Sweeps by the quasi-static rod.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct RodSweeps;

impl SweepEngine for RodSweeps {
    fn identity(&self) -> Value {
        json!({ "name": "rod", "links": LINKS, "method": METHOD })
    }

    fn check(&self, _: &SweepPlan) -> Result<(), LabError> {
        Ok(())
    }

    fn run_block(&self, task: &BlockTask<'_>) -> Result<Block, LabError> {
        let engine = RodEngine::new(task.whisker, LINKS)?;
        let run = |index| {
            let sweep = Sweep::draw(task.mesh, task.plan, task.seed, index, engine.reach_mm())?;
            let run = engine.run(task.mesh, &sweep, task.plan);
            Some((sweep, run))
        };
        let outcomes = task
            .sweeps
            .clone()
            .map(|index| (index, run(index)))
            .collect();
        Ok(Block {
            outcomes,
            ..Block::default()
        })
    }
}
