//! Sweeps of a dataset by MuJoCo, with the quasi-static rod on the same sweeps.

use super::Dataset;
use super::engine::{Block, BlockTask, RodSweeps, SweepEngine};
use crate::LabError;
use nalgebra::Vector3;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use wcal_lab_sweeps::cable_engine::{CableEngine, no_softening};
use wcal_lab_sweeps::convex::Convex;
use wcal_lab_sweeps::rod_comparison::ComparisonSum;
use wcal_lab_sweeps::rod_engine::{LINKS, RodEngine, Run};
use wcal_lab_sweeps::{Sweep, SweepPlan};
use wcal_mesh::{Mesh, MeshError};
use wcal_mujoco::mjcf::MjcfOptions;
use wcal_mujoco::{MujocoEngine, TwinError};

/// Folder of the convex parts, in the dataset's.
const CONVEX: &str = "convex";

/// Corners of an object's parts, mm.
type Corners = Arc<Vec<Vec<Vector3<f64>>>>;
/// What is known of them; an object that cannot be decomposed has the reason instead.
type Parts = Arc<Mutex<Option<Result<Corners, String>>>>;

/// Sweeps by MuJoCo: inertia, damping, soft contacts with convex parts.
#[derive(Debug, Default)]
pub struct MujocoSweeps {
    /// The wire's model.
    pub options: MjcfOptions,
    /// By object.
    parts: Mutex<BTreeMap<String, Parts>>,
}

impl MujocoSweeps {
    /// With a wire's model.
    pub fn new(options: MjcfOptions) -> Self {
        Self {
            options,
            parts: Mutex::default(),
        }
    }

    /// An object's parts: made once a run, whichever block asks first, also where CoACD dies or
    /// hangs over them.
    fn parts(&self, mesh: &Mesh, folder: &Path) -> Result<Result<Corners, String>, TwinError> {
        let own = {
            let mut all = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
            all.entry(mesh.name.clone()).or_default().clone()
        };
        // Blocks of one object wait for each other, those of others go on.
        let mut known = own.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = &*known {
            return Ok(known.clone());
        }
        let found = match Convex::of(mesh, folder) {
            // An object that cannot be decomposed: its sweeps are rejected, the others' go on.
            Err(e @ (TwinError::Sim(MeshError::Mesh { .. }) | TwinError::EngineDied(_))) => {
                Err(format!("no convex parts: {e}"))
            }
            other => Ok(Arc::new(other?.corners())),
        };
        Ok(known.insert(found).clone())
    }

    fn block(&self, task: &BlockTask<'_>) -> Result<Block, TwinError> {
        let BlockTask {
            whisker,
            plan,
            mesh,
            ..
        } = *task;
        let parts = self.parts(mesh, &task.folder.join(CONVEX))?;
        let rod = RodEngine::new(whisker, LINKS)?;
        let mut engine = CableEngine::start(whisker, &self.options)?;
        let (mut outcomes, mut against_rod) = (Vec::new(), ComparisonSum::over(plan));
        for index in task.sweeps.clone() {
            let sweep = Sweep::draw(mesh, plan, task.seed, index, engine.reach_mm());
            let outcome = match (sweep, &parts) {
                (None, _) => None,
                (Some(sweep), Err(_)) => Some((sweep, Run::rejected("no-convex-parts"))),
                (Some(sweep), Ok(parts)) => {
                    let run = engine.run(mesh, parts, &sweep, plan)?;
                    against_rod.add(&run, &rod.run(mesh, &sweep, plan));
                    Some((sweep, run))
                }
            };
            outcomes.push((index, outcome));
        }
        let notes = parts
            .err()
            .into_iter()
            .chain(engine.refused.take())
            .collect();
        Ok(Block {
            outcomes,
            against_rod: Some(against_rod),
            notes,
            other_core_s: engine.core_s(),
        })
    }
}

impl SweepEngine for MujocoSweeps {
    fn identity(&self) -> Value {
        json!({ "name": "mujoco", "options": self.options, "rod": RodSweeps.identity() })
    }

    fn check(&self, plan: &SweepPlan) -> Result<(), LabError> {
        if let Some(onset) = plan.physics.softening_onset_per_m {
            return Err(no_softening(&format!("{onset:?}")).into());
        }
        MujocoEngine::start().map(drop).map_err(LabError::from)
    }

    fn run_block(&self, task: &BlockTask<'_>) -> Result<Block, LabError> {
        Ok(self.block(task)?)
    }
}

/// The convex parts that MuJoCo's sweeps in `folder` were made with, by object; those that are
/// there.
pub fn convex_parts(dataset: &Dataset, folder: &Path) -> BTreeMap<String, Convex> {
    let there = |mesh: &Mesh| {
        Some((
            mesh.name.clone(),
            Convex::kept(mesh, &folder.join(CONVEX)).ok()??,
        ))
    };
    dataset.objects.iter().filter_map(there).collect()
}
