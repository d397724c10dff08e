//! What `wcal-lab simulate` is asked.

use super::slurm::SlurmArgs;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use wcal::output::Overwrite;

/// Arguments of `wcal-lab simulate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal-lab simulate --object can --object vase --sweeps 50 --out sweeps
  wcal-lab simulate --meshes ycb/meshes --sweeps 200 --seed 1 --out sweeps
  wcal-lab simulate --meshes ycb/meshes --sweeps 200 --out /shared/sweeps --slurm header.sh

Writes for every 25 sweeps over an object three Parquet tables (sweeps, samples, contacts) and a manifest with their checksums, and
dataset.json. A second run with the same arguments goes on where the first stopped; one with another seed, plan, whisker, engine or other
objects is refused: one folder, one dataset (recipe.json says which). With --engine mujoco the rod runs on the same sweeps:
how far moments and contacts are from it, by speed, is printed and goes into dataset.json (against_rod), with
how far the convex parts are from each mesh. Everything here is SIMULATED. It runs on all
cores; RAYON_NUM_THREADS=N asks for N. Exit code 3: made, with objects left out, meshes
that are not closed or not in millimetres, objects without a usable sweep, or an engine that died; with --check, 4: shards are missing or damaged.")]
pub struct SimulateArgs {
    /// Model of the wire: the quasi-static rod, or MuJoCo (inertia, damping, convex parts of the
    /// object; some 100 times slower)
    #[arg(long, value_enum, default_value = "rod")]
    pub engine: Engine,
    /// Built-in object (may be repeated); "all" takes every one
    #[arg(long, value_name = "NAME")]
    pub object: Vec<String>,
    /// STL file, or folder of them (may be repeated)
    #[arg(long, value_name = "PATH")]
    pub meshes: Vec<PathBuf>,
    /// Sweeps over each object
    #[arg(long, default_value_t = 200)]
    pub sweeps: u64,
    /// Seed of all draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Whisker (whisker.toml of `wcal fit-whisker`, with its damping and contact where they were
    /// fitted); the nominal one without it
    #[arg(long, value_name = "TOML")]
    pub whisker: Option<PathBuf>,
    /// How sweeps are drawn, and their physics (lab/sweeps.toml has every key with its default)
    #[arg(long, value_name = "TOML")]
    pub plan: Option<PathBuf>,
    /// Share of the work, "i/n" from 1: the shards of all shares together are the dataset
    #[arg(long, value_name = "i/n", default_value = "1/1")]
    pub shard: String,
    /// Make nothing: compare every shard with its checksums, name what is missing, write
    /// dataset.json
    #[arg(long)]
    pub check: bool,
    /// Folder for the shards
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print the summary as JSON on stdout
    #[arg(long)]
    pub json: bool,
    /// For a cluster
    #[command(flatten)]
    pub slurm: SlurmArgs,
}

/// Models of the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Engine {
    /// Quasi-static rod on the exact mesh
    Rod,
    /// MuJoCo's cable on convex parts, labels on the exact mesh
    Mujoco,
}
