//! A dataset from what the command names: read, made or gone on with, and described in
//! dataset.json.

use super::arguments::{Engine, SimulateArgs};
use super::document::{DatasetDocument, Faults, Twin, document};
use super::inputs::{mjcf_options, objects_of, whisker};
use crate::dataset::{Dataset, MissingShard, MujocoSweeps, RodSweeps, SweepEngine, Total};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use wcal::output::write_file;
use wcal::progress::Progress;
use wcal_lab_sweeps::SweepPlan;
use wcal_mujoco::mjcf::MjcfOptions;

/// Shards made again that are named one by one.
const MAX_REPEATS_SHOWN: usize = 5;

/// Datasets are made from it: what there is to make, and what was said of the objects beforehand.
pub struct Order {
    /// Its plan and seed may be changed for another dataset over the same objects.
    pub dataset: Dataset,
    mujoco: Option<MjcfOptions>,
    left_out: Vec<String>,
    notes: Vec<String>,
}

impl Order {
    /// Reads whisker and objects; warns of objects that are left out or doubtful.
    ///
    /// # Errors
    /// Where nothing can be simulated.
    pub fn new(args: &SimulateArgs, plan: SweepPlan, share: [usize; 2]) -> anyhow::Result<Self> {
        plan.check()?;
        let (whisker, options) = (
            whisker(args.whisker.as_deref())?,
            mjcf_options(args.whisker.as_deref())?,
        );
        let (objects, left_out) = objects_of(args)?;
        let mut notes: Vec<String> = Vec::new();
        for mesh in &objects {
            notes.extend(
                mesh.notes
                    .iter()
                    .map(|note| format!("{}: {note}", mesh.name)),
            );
        }
        for line in left_out.iter().chain(&notes) {
            eprintln!("simulate: warning: {line}");
        }
        let mujoco = (args.engine == Engine::Mujoco).then_some(options);
        let engine: Arc<dyn SweepEngine> = match &mujoco {
            None => Arc::new(RodSweeps),
            Some(options) => Arc::new(MujocoSweeps::new(options.clone())),
        };
        let dataset = Dataset {
            engine,
            whisker,
            plan,
            objects,
            sweeps: args.sweeps,
            seed: args.seed,
            share,
        };
        Ok(Self {
            dataset,
            mujoco,
            left_out,
            notes,
        })
    }

    /// Makes what is missing in a folder; `what` names the sweeps in the progress.
    ///
    /// # Errors
    /// Where the folder holds another dataset or cannot be written.
    pub fn make(
        &self,
        folder: &Path,
        progress: &Progress,
        what: &str,
    ) -> anyhow::Result<BTreeMap<String, Total>> {
        let totals = self.dataset.make(folder, |done, all| {
            progress.at(
                &format!("{done} of {all} {what}"),
                done as f64 / all.max(1) as f64,
            );
        })?;
        let again: Vec<&String> = totals.values().flat_map(|t| &t.again).collect();
        for line in again.iter().take(MAX_REPEATS_SHOWN) {
            eprintln!("simulate: made again: {line}");
        }
        if again.len() > MAX_REPEATS_SHOWN {
            eprintln!(
                "simulate: made again: {} more",
                again.len() - MAX_REPEATS_SHOWN
            );
        }
        Ok(totals)
    }

    /// Writes dataset.json into the folder of the shards, and warns of what went wrong while they
    /// were made.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn write_document(
        &self,
        args: &SimulateArgs,
        totals: &BTreeMap<String, Total>,
        missing: Vec<MissingShard>,
    ) -> anyhow::Result<DatasetDocument> {
        let mut notes = Vec::new();
        for (name, total) in totals {
            notes.extend(total.notes.iter().map(|note| format!("{name}: {note}")));
            if let Some(died) = total.verdicts.get("engine-died") {
                notes.push(format!(
                    "{name}: the engine died in {died} sweeps: a second run makes them again"
                ));
            }
            if total.kept() == 0 {
                notes.push(format!("{name}: none of {} sweeps is kept", total.sweeps));
            }
        }
        for note in &notes {
            eprintln!("simulate: warning: {note}");
        }
        notes.splice(..0, self.notes.iter().cloned());
        let missing: Vec<String> = missing
            .iter()
            .map(|MissingShard { name, why, .. }| format!("{name} is missing: {why}"))
            .collect();
        for line in &missing {
            eprintln!("simulate: {line}");
        }
        let mujoco = self.mujoco.as_ref();
        let twin = Twin::of(&self.dataset, totals, &args.out);
        let faults = Faults {
            left_out: self.left_out.clone(),
            notes,
            missing,
        };
        let document = document(args, &self.dataset, mujoco, totals, faults, twin);
        let [share, shares] = self.dataset.share;
        let name = if shares == 1 {
            "dataset.json".to_owned()
        } else {
            format!("dataset-{}-of-{shares}.json", share + 1)
        };
        write_file(
            &args.out.join(&name),
            serde_json::to_string_pretty(&document)?.as_bytes(),
        )?;
        Ok(document)
    }
}
