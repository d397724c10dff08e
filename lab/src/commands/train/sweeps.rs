//! What a tracker is trained on: sweeps that are there, or those that `wcal-lab train` makes
//! itself.

use super::arguments::TrainArgs;
use crate::commands::simulate::{Engine, MAX_SWEEPS, Order, SimulateArgs, SlurmArgs};
use crate::dataset::read::manifests;
use crate::dataset::recipe::check_one_dataset;
use crate::train_model::Seconds;
use crate::training_sweeps::sweep_kinds;
use anyhow::{Context, ensure};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;
use wcal::output::write_file;
use wcal::output::{Overwrite, within};
use wcal::progress::Progress;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::{SweepPlan, objects};
use wcal_mesh::Mesh;

/// Sweeps to train on.
pub(crate) struct Sweeps {
    /// Objects are held out of these.
    pub folder: PathBuf,
    /// Trained on only.
    pub additional: Vec<PathBuf>,
    /// Meshes of the objects, where all of them are known.
    pub meshes: BTreeMap<String, Mesh>,
    /// What making them took, where they were made here.
    pub cost: Option<Seconds>,
}

impl Sweeps {
    /// Those in the folders that the command names.
    ///
    /// # Errors
    /// Where a folder holds no dataset, several, or one of another whisker.
    pub(crate) fn there(
        args: &TrainArgs,
        folder: &Path,
        whisker: &WhiskerSpec,
    ) -> anyhow::Result<Self> {
        let folders =
            || std::iter::once(folder).chain(args.additional.iter().map(PathBuf::as_path));
        for folder in folders() {
            same_whisker(folder, &format!("{whisker:?}"))?;
            check_one_dataset(folder)?;
        }
        let mut names = BTreeSet::new();
        for folder in folders() {
            names.extend(
                manifests(folder)?
                    .into_iter()
                    .map(|(_, manifest)| manifest.object),
            );
        }
        let meshes = surfaces(names, args.meshes.as_deref())?;
        Ok(Self {
            folder: folder.to_owned(),
            additional: args.additional.clone(),
            meshes,
            cost: None,
        })
    }

    /// Makes the three kinds in OUT/sweeps, a folder each, or goes on with them: over the objects
    /// of `--meshes`, or over the built-in ones.
    ///
    /// # Errors
    /// Where there is no object, or a folder holds other sweeps.
    pub(crate) fn make(args: &TrainArgs) -> anyhow::Result<Self> {
        within("--sweeps-each", args.sweeps_each, MAX_SWEEPS)?;
        let (begin, mut made) = (Instant::now(), 0);
        let progress = Progress::new("train");
        let mut simulate = arguments(args);
        let mut order = Order::new(&simulate, SweepPlan::default(), [0, 1])?;
        let (mut folders, mut cpu_s) = (Vec::new(), 0.0);
        for kind in sweep_kinds(args.sweeps_each, args.seed) {
            simulate.out = args.out.join("sweeps").join(kind.name);
            (order.dataset.plan, order.dataset.seed, order.dataset.sweeps) =
                (kind.plan, kind.seed, kind.sweeps);
            let totals = order.make(&simulate.out, &progress, &format!("{} sweeps", kind.name))?;
            order.write_document(&simulate, &totals, Vec::new())?;
            made += totals.values().map(|t| t.made).sum::<u64>();
            // Shards remember what they cost, also those of an earlier run.
            cpu_s += manifests(&simulate.out)?
                .iter()
                .filter_map(|(_, m)| m.core_s)
                .sum::<f64>();
            folders.push(simulate.out.clone());
        }
        let meshes = order
            .dataset
            .objects
            .into_iter()
            .map(|m| (m.name.clone(), m))
            .collect();
        let wall_s = remembered(&args.out, (made > 0).then(|| begin.elapsed().as_secs_f64()))?;
        let cost = wall_s.map(|wall_s| Seconds { wall_s, cpu_s });
        Ok(Self {
            folder: folders.remove(0),
            additional: folders,
            meshes,
            cost,
        })
    }
}

/// What all runs that came to the end of the sweeps took by the clock, s, with what this one took
/// where it made some; kept with the checkpoint.
fn remembered(out: &Path, more_s: Option<f64>) -> anyhow::Result<Option<f64>> {
    let (folder, name) = (out.join("checkpoint"), "sweeps_wall_s.json");
    let earlier = wcal_core::files::read_text(folder.join(name)).ok();
    let earlier_s: Option<f64> = earlier.and_then(|text| serde_json::from_str(&text).ok());
    let Some(more_s) = more_s else {
        return Ok(earlier_s);
    };
    let wall_s = earlier_s.unwrap_or(0.0) + more_s;
    write_file(&folder.join(name), wall_s.to_string().as_bytes())?;
    Ok(Some(wall_s))
}

/// `wcal-lab simulate` with the objects and the whisker of this command.
fn arguments(args: &TrainArgs) -> SimulateArgs {
    SimulateArgs {
        engine: Engine::Rod,
        object: if args.meshes.is_none() {
            vec!["all".to_owned()]
        } else {
            Vec::new()
        },
        meshes: args.meshes.iter().cloned().collect(),
        sweeps: args.sweeps_each,
        seed: args.seed,
        whisker: args.whisker.clone(),
        plan: None,
        shard: "1/1".to_owned(),
        check: false,
        out: PathBuf::new(),
        overwrite: Overwrite { force: false },
        json: false,
        slurm: SlurmArgs::default(),
    }
}

/// Meshes of the sweeps' objects; none where one of them is not there and no folder was named.
fn surfaces(
    names: BTreeSet<String>,
    folder: Option<&Path>,
) -> anyhow::Result<BTreeMap<String, Mesh>> {
    let mut meshes = BTreeMap::new();
    for name in names {
        match objects::named(&name, folder) {
            Ok(mesh) => {
                mesh.notes
                    .iter()
                    .for_each(|note| eprintln!("warning: object {name}: {note}"));
                meshes.insert(name, mesh);
            }
            Err(_) if folder.is_none() => {
                eprintln!(
                    "train: {name}: surface not known (--meshes): trained on the true contacts alone"
                );
                return Ok(BTreeMap::new());
            }
            Err(e) => {
                return Err(e).with_context(|| format!("object {name}: mesh in --meshes DIR"));
            }
        }
    }
    Ok(meshes)
}

/// Whether the sweeps were made with this whisker, where the folder says so.
fn same_whisker(sweeps: &Path, expected: &str) -> anyhow::Result<()> {
    let path = sweeps.join("dataset.json");
    let Ok(text) = wcal_core::files::read_text(&path) else {
        eprintln!(
            "train: warning: {}: not there; the sweeps are taken to be those of this whisker",
            path.display()
        );
        return Ok(());
    };
    let document =
        wcal_core::document::json(&text).with_context(|| format!("reading {}", path.display()))?;
    let found = document["whisker"].as_str().unwrap_or("none");
    ensure!(
        found == expected,
        "{}: whisker: expected {expected}, found {found}",
        path.display()
    );
    Ok(())
}
