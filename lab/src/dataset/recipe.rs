//! `recipe.json`: what the shards of a folder follow from, written before the first of them, so
//! that a folder holds one dataset and no mixture.

use super::{Dataset, shard};
use crate::LabError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_mesh::Mesh;

/// Name of the file.
const FILE: &str = "recipe.json";
/// Its format.
const FORMAT: &str = "wcal-sweep-recipe/2";
/// Differences that are named; more are counted.
const MAX_NAMED: usize = 8;

/// What a dataset follows from; the number of sweeps is none of it, a dataset may grow.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Recipe {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    format: String,
    /// Engine and its settings: `name` (`rod` or `mujoco`), and what else its tables follow from:
    /// `links` and `method` of the rod, `options` and `rod` of MuJoCo.
    engine: Value,
    /// Seed of every random draw.
    seed: u64,
    /// How sweeps are drawn (the plan's keys).
    plan: Value,
    /// The wire, by the names of session.toml.
    whisker: Value,
    /// By object.
    objects: BTreeMap<String, Source>,
}

/// What an object's shards follow from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Source {
    /// SHA-256 of the mesh.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    mesh: String,
    /// As in the manifests of its shards.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    made_from: String,
}

impl Recipe {
    fn of(dataset: &Dataset) -> Result<Self, LabError> {
        let source = |mesh: &Mesh| {
            Ok((
                mesh.name.clone(),
                Source {
                    mesh: mesh.sha256(),
                    made_from: dataset.made_from(mesh)?,
                },
            ))
        };
        let recipe = Self {
            format: FORMAT.to_owned(),
            engine: dataset.engine.identity(),
            seed: dataset.seed,
            plan: serde_json::to_value(&dataset.plan).map_err(|e| written_wrong(&e))?,
            whisker: serde_json::to_value(&dataset.whisker).map_err(|e| written_wrong(&e))?,
            objects: dataset
                .objects
                .iter()
                .map(source)
                .collect::<Result<_, LabError>>()?,
        };
        // Through text once: numbers are then those that a file gives back.
        let text = serde_json::to_string(&recipe).map_err(|e| written_wrong(&e))?;
        serde_json::from_str(&text).map_err(|e| written_wrong(&e))
    }

    /// That of a folder; none where it has none.
    fn read(folder: &Path) -> Result<Option<Self>, LabError> {
        let path = folder.join(FILE);
        let text = match wcal_core::files::read_text(&path) {
            Err(e) if e.source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            other => other?,
        };
        let recipe = wcal_core::document::json_as(&text);
        recipe.map(Some).map_err(|e| LabError::Shard {
            path,
            detail: e.to_string(),
        })
    }

    fn write(&self, folder: &Path) -> Result<(), LabError> {
        let path = folder.join(FILE);
        let bytes = serde_json::to_vec_pretty(self).map_err(|e| written_wrong(&e))?;
        std::fs::create_dir_all(folder).map_err(LabError::file("creating", folder))?;
        shard::write_whole(&path, &bytes)
    }

    /// What in `found` is not as here, by name.
    fn differences(&self, found: &Self) -> Vec<String> {
        let parts = |r: &Self| {
            [
                Value::from(r.seed),
                r.engine.clone(),
                r.whisker.clone(),
                r.plan.clone(),
            ]
        };
        let both = ["seed", "engine", "whisker", "plan"]
            .into_iter()
            .zip(parts(found).into_iter().zip(parts(self)));
        let differ = both.filter(|(_, (there, own))| there != own);
        let mut all: Vec<String> = differ
            .map(|(name, (there, own))| format!("{name}: there {there}, asked for {own}"))
            .collect();
        for (name, own) in &self.objects {
            match found.objects.get(name) {
                None => all.push(format!("object {name}: not there")),
                Some(there) if there.mesh != own.mesh => {
                    all.push(format!("object {name}: there with another mesh"));
                }
                // Everything else may be equal and the way of solving not.
                Some(there) if there.made_from != own.made_from && all.is_empty() => {
                    all.push(format!(
                        "object {name}: there made by another version of the engine"
                    ));
                }
                Some(_) => {}
            }
        }
        let more = found
            .objects
            .keys()
            .filter(|name| !self.objects.contains_key(*name));
        all.extend(more.map(|name| format!("object {name}: there, not asked for")));
        all
    }
}

fn written_wrong(error: &serde_json::Error) -> LabError {
    LabError::Shard {
        path: FILE.into(),
        detail: error.to_string(),
    }
}

/// Manifests of a folder by the shards' names, their tables unread.
fn shards_of(folder: &Path) -> Result<Vec<(String, shard::Manifest)>, LabError> {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Ok(Vec::new());
    };
    let names = entries.filter_map(|e| e.ok()?.file_name().into_string().ok());
    let mut names: Vec<String> = names
        .filter_map(|n| n.strip_suffix(".sweeps.parquet").map(str::to_owned))
        .collect();
    names.sort_unstable();
    // A shard whose manifest is not there or not whole is made again: it says nothing.
    let manifest = |name: String| {
        Some((
            name.clone(),
            shard::read_manifest(&folder.join(format!("{name}.json"))).ok()?,
        ))
    };
    Ok(names.into_iter().filter_map(manifest).collect())
}

fn refuse(folder: &Path, mut differences: Vec<String>) -> Result<(), LabError> {
    if differences.is_empty() {
        return Ok(());
    }
    let more = differences.len().saturating_sub(MAX_NAMED);
    differences.truncate(MAX_NAMED);
    if more > 0 {
        differences.push(format!("{more} more differences"));
    }
    Err(LabError::Mixture {
        folder: folder.to_owned(),
        differences: differences.join("; "),
    })
}

impl Dataset {
    /// Refuses a folder that holds another dataset, naming what differs: seed, plan, whisker,
    /// engine or objects. Nothing is written.
    ///
    /// # Errors
    /// [`LabError::Mixture`], or where the folder cannot be read.
    pub fn check_folder(&self, folder: &Path) -> Result<(), LabError> {
        let own = Recipe::of(self)?;
        let mut differences = match Recipe::read(folder)? {
            Some(found) if found.format != FORMAT => {
                let detail = format!("expected {FORMAT}, found {}", found.format);
                return Err(LabError::Shard {
                    path: folder.join(FILE),
                    detail,
                });
            }
            Some(found) => own.differences(&found),
            None => Vec::new(),
        };
        // Folders from before there was a recipe, and mixtures that were made then.
        if differences.is_empty() {
            let made_from = |object: &str| own.objects.get(object).map(|s| s.made_from.as_str());
            let foreign = shards_of(folder)?.into_iter();
            let foreign =
                foreign.filter(|(_, m)| made_from(&m.object) != Some(m.made_from.as_str()));
            differences.extend(foreign.map(|(name, _)| {
                format!("shard {name}: made from another wire, plan, mesh, seed or engine, or by an earlier version of wcal")
            }));
        }
        refuse(folder, differences)
    }

    /// As [`Self::check_folder`], and says in the folder what it holds from now on.
    pub(crate) fn claim(&self, folder: &Path) -> Result<(), LabError> {
        self.check_folder(folder)?;
        let own = Recipe::of(self)?;
        if Recipe::read(folder)?.is_none() {
            own.write(folder)
        } else {
            Ok(())
        }
    }
}

/// Refuses a folder whose shards are not of one dataset; those from before there was a recipe are
/// compared object by object.
///
/// # Errors
/// [`LabError::Mixture`] with the shards, or where the folder cannot be read.
pub fn check_one_dataset(folder: &Path) -> Result<(), LabError> {
    let shards = shards_of(folder)?;
    let recipe = Recipe::read(folder)?;
    let mut first: BTreeMap<&str, &str> = BTreeMap::new();
    let mut differences = Vec::new();
    for (name, manifest) in &shards {
        let expected = match &recipe {
            Some(recipe) => recipe
                .objects
                .get(&manifest.object)
                .map(|s| s.made_from.as_str()),
            None => Some(*first.entry(&manifest.object).or_insert(&manifest.made_from)),
        };
        match expected {
            None => differences.push(format!(
                "shard {name}: of an object that {FILE} does not name"
            )),
            Some(expected) if expected != manifest.made_from => differences.push(format!(
                "shard {name}: made from another wire, plan, mesh, seed or engine than the others"
            )),
            Some(_) => {}
        }
    }
    refuse(folder, differences)
}
