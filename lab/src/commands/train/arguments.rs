//! What `wcal-lab train` is asked.

use crate::train::TrainSettings;
use clap::Args;
use std::path::PathBuf;
use wcal::output::Overwrite;

/// Sweeps of each kind over an object where none are given.
const SWEEPS_EACH: u64 = 40;

/// Arguments of `wcal-lab train`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal-lab train --meshes ycb/meshes --out model
  wcal-lab simulate --object all --sweeps 50 --out sweeps
  wcal-lab train sweeps --epochs 8 --out model

Without a folder of sweeps it makes its own in OUT/sweeps, over the objects of --meshes or the built-in ones: clean ones, ones with friction, weight
and the drag of air, and upright ones; `wcal-lab evaluate OUT/sweeps/clean --model OUT` scores the model.

Objects are split: some are held out for the early stop and the stated spread, some are never looked at (`wcal-lab evaluate` scores them as
unseen), and of the others the last tenth of the sweeps is kept back. Writes model.safetensors, model.json (the card)
and checkpoint/, from which the same command resumes. Everything here is SIMULATED.")]
pub struct TrainArgs {
    /// Folder of shards from `wcal-lab simulate`; without it the sweeps are made, too
    pub sweeps: Option<PathBuf>,
    /// Sweeps over each object, clean ones and as many with friction, and a quarter as many
    /// upright, where no folder is given
    #[arg(long, default_value_t = SWEEPS_EACH, conflicts_with = "sweeps")]
    pub sweeps_each: u64,
    /// Another folder, of sweeps with other physics (friction, weight, ...) or seed over the same
    /// objects: added to the training, never held out or scored (may be repeated)
    #[arg(long, value_name = "DIR", requires = "sweeps")]
    pub additional: Vec<PathBuf>,
    /// Folder of the objects' STL files: the answer is trained to lie on their surfaces, too;
    /// built-in objects need none
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Model with whose weights to begin; it must have been trained on the same split
    #[arg(long, value_name = "MODEL")]
    pub from: Option<PathBuf>,
    /// Network: compact (weights over the rod's inverse curve), or paper (the paper's size and
    /// head)
    #[arg(long, default_value = "compact")]
    pub preset: String,
    /// Passes over the sweeps at most
    #[arg(long, default_value_t = 12)]
    pub epochs: usize,
    /// Passes over one draw of noise and windows: drawing takes as long as some passes, the filters
    /// run over every sweep
    #[arg(long, value_name = "N", default_value_t = TrainSettings::default().passes_per_draw)]
    pub passes_per_draw: usize,
    /// Largest learning rate
    #[arg(long, default_value_t = TrainSettings::default().rate)]
    pub rate: f64,
    /// Objects held out for the early stop and the spread; an eighth of all without it
    #[arg(long)]
    pub held_out: Option<usize>,
    /// Objects never looked at; an eighth of all without it
    #[arg(long)]
    pub unseen: Option<usize>,
    /// Whisker of the sweeps (whisker.toml); the nominal one without it
    #[arg(long, value_name = "TOML")]
    pub whisker: Option<PathBuf>,
    /// Seed of all draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder for the model
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print the card as JSON on stdout
    #[arg(long)]
    pub json: bool,
}
