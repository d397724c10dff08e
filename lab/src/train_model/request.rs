//! What a model is made of.

use super::cost::Seconds;
use crate::train::TrainSettings;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use wcal_core::observation::WhiskerSpec;
use wcal_mesh::Mesh;

/// What is made of what.
#[derive(Debug, Clone)]
pub struct TrainingRequest<'a> {
    /// Folder of shards.
    pub sweeps: &'a Path,
    /// Other folders: sweeps with other physics or seeds over the same objects, which are trained
    /// on only.
    pub additional: &'a [PathBuf],
    /// The objects' meshes, where they are known.
    pub meshes: &'a BTreeMap<String, Mesh>,
    /// Folder of a model with which to begin.
    pub from: Option<&'a Path>,
    /// Whisker of the sweeps.
    pub whisker: WhiskerSpec,
    /// What making the sweeps took, where the same command made them.
    pub sweeps_cost: Option<Seconds>,
    /// The command as it was typed.
    pub command: Vec<String>,
    /// compact or paper.
    pub preset: &'a str,
    /// How it is trained.
    pub settings: TrainSettings,
    /// Objects held out, and kept unseen; an eighth of all where it is not given.
    pub held_out: Option<usize>,
    /// See `held_out`.
    pub unseen: Option<usize>,
    /// Folder for model and checkpoint.
    pub out: &'a Path,
}
