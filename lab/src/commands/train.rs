//! `wcal-lab train`: the contact tracker, trained on simulated sweeps.

mod sweeps;

use super::simulate::whisker;
use crate::model_file::read_card;
use crate::train::{Pass, TrainSettings, best};
use crate::train_model::{TrainingRequest, train_model};
use anyhow::ensure;
use burn::tensor::Device;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use sweeps::Sweeps;
use wcal::output::{Overwrite, ResultKind, unsaid};
use wcal::progress::Progress;

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
    /// Sweeps over each object, clean ones and as many with friction, and a quarter as many upright, where no folder is given
    #[arg(long, default_value_t = SWEEPS_EACH, conflicts_with = "sweeps")]
    pub sweeps_each: u64,
    /// Another folder, of sweeps with other physics (friction, weight, ...) or seed over the same objects: added to the training, never held out or scored (may be repeated)
    #[arg(long, value_name = "DIR", requires = "sweeps")]
    pub additional: Vec<PathBuf>,
    /// Folder of the objects' STL files: the answer is trained to lie on their surfaces, too; built-in objects need none
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Model with whose weights to begin; it must have been trained on the same split
    #[arg(long, value_name = "MODEL")]
    pub from: Option<PathBuf>,
    /// Network: compact (weights over the rod's inverse curve), or paper (the paper's size and head)
    #[arg(long, default_value = "compact")]
    pub preset: String,
    /// Passes over the sweeps at most
    #[arg(long, default_value_t = 12)]
    pub epochs: usize,
    /// Passes over one draw of noise and windows: drawing takes as long as some passes, the filters run over every sweep
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

/// Sweeps of each kind over an object where none are given.
const SWEEPS_EACH: u64 = 40;

/// A model, and what a second run goes on from.
const RESULT: ResultKind<'_> = ResultKind {
    command: "train",
    document: "model.json",
    format_prefix: "wcal-model/",
    files: &["model.safetensors"],
    kept: &["checkpoint", "sweeps"],
    resumes: true,
    made_of: unsaid,
};

/// Runs the command.
///
/// # Errors
/// Where the sweeps cannot be used or the model cannot be written.
pub fn run(args: &TrainArgs) -> anyhow::Result<ExitCode> {
    RESULT.check(&args.out, args.overwrite.force)?;
    let whisker = whisker(args.whisker.as_deref())?;
    ensure!(args.rate > 0.0 && args.rate < 1.0, "--rate: expected above 0 and below 1, found {}", args.rate);
    ensure!(args.passes_per_draw > 0, "--passes-per-draw: expected 1 or more, found 0");
    let settings = TrainSettings {
        epochs: args.epochs,
        passes_per_draw: args.passes_per_draw,
        rate: args.rate,
        seed: args.seed,
        ..TrainSettings::default()
    };
    // What cannot be read is known before the sweeps are made, which takes hours.
    args.from.as_deref().map(read_card).transpose()?;
    eprintln!("train: on SIMULATED sweeps");
    let sweeps = match &args.sweeps {
        Some(folder) => Sweeps::there(args, folder, &whisker)?,
        None => Sweeps::make(args)?,
    };
    let request = TrainingRequest {
        meshes: &sweeps.meshes,
        sweeps: &sweeps.folder,
        additional: &sweeps.additional,
        sweeps_cost: sweeps.cost,
        // As typed, but for where the program lies.
        command: std::iter::once("wcal-lab".to_owned()).chain(std::env::args().skip(1)).collect(),
        from: args.from.as_deref(),
        whisker,
        preset: &args.preset,
        settings,
        held_out: args.held_out,
        unseen: args.unseen,
        out: &args.out,
    };
    let progress = Progress::new("train");
    let card = train_model(&request, &Device::flex(), |pass| {
        on_pass(pass);
        progress.at(
            &format!("pass {} of at most {}", pass.epoch, args.epochs),
            pass.epoch as f64 / args.epochs as f64,
        );
    })?;
    drop(progress);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&card)?);
    } else if let Some(best) = best(&card.passes) {
        println!(
            "best pass {} of {}: {:.2} mm on held-out objects",
            best.epoch,
            card.passes.len(),
            best.held_out_mm
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn on_pass(pass: &Pass) {
    let surface =
        pass.held_out_surface_mm.map_or_else(String::new, |s| format!(", from the surface {s:.2} mm"));
    eprintln!(
        "pass {:3}: loss {:.3}, held-out {:.3}, RMSE of the contact {:.2} mm{surface}, {:.0} s",
        pass.epoch, pass.loss, pass.held_out_loss, pass.held_out_mm, pass.seconds
    );
}
