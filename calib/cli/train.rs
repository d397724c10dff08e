//! `wcal train`: the contact tracker, trained on simulated sweeps.

use crate::simulate::whisker;
use anyhow::{Context, ensure};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_track::make::{Making, make_model};
use wcal_track::train::{Pass, TrainSettings, best};

/// Arguments of `wcal train`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal simulate --object all --sweeps 50 --out sweeps
  wcal train sweeps --epochs 8 --out model

Objects are split: some are held out for the early stop and the stated spread, some are never looked at (`wcal evaluate` scores them as
unseen), and of the others the last tenth of the sweeps is kept back. Writes model.safetensors, model.json (the card) and checkpoint/,
from which the same command goes on where it stopped. Everything here is SIMULATED.")]
pub struct TrainArgs {
    /// Folder of shards from `wcal simulate`
    pub sweeps: PathBuf,
    /// Network: default (weights over the rod's inverse curve) or paper
    #[arg(long, default_value = "default")]
    pub preset: String,
    /// Passes over the sweeps at most
    #[arg(long, default_value_t = 12)]
    pub epochs: usize,
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
    /// Print the card as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Where the sweeps cannot be used or the model cannot be written.
pub fn run(args: &TrainArgs) -> anyhow::Result<ExitCode> {
    let whisker = whisker(args.whisker.as_deref())?;
    same_whisker(&args.sweeps, &format!("{whisker:?}"))?;
    let settings = TrainSettings { epochs: args.epochs, seed: args.seed, ..TrainSettings::default() };
    let making = Making {
        sweeps: &args.sweeps,
        whisker,
        preset: &args.preset,
        settings,
        held_out: args.held_out,
        unseen: args.unseen,
        out: &args.out,
    };
    eprintln!("train: on SIMULATED sweeps");
    let card = make_model(&making, &burn_device(), heard)?;
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

/// Where networks run here.
pub fn burn_device() -> wcal_track::Device {
    wcal_track::Device::flex()
}

fn heard(pass: &Pass) {
    eprintln!(
        "pass {:3}: loss {:.3}, held-out {:.3}, RMSE of the contact {:.2} mm, {:.0} s",
        pass.epoch, pass.loss, pass.held_out_loss, pass.held_out_mm, pass.seconds
    );
}

/// Whether the sweeps were made with this whisker, where the folder says so.
fn same_whisker(sweeps: &Path, expected: &str) -> anyhow::Result<()> {
    let path = sweeps.join("dataset.json");
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!(
            "train: warning: {}: not there; the sweeps are taken to be those of this whisker",
            path.display()
        );
        return Ok(());
    };
    let document: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))?;
    let found = document["whisker"].as_str().unwrap_or("none");
    ensure!(found == expected, "{}: whisker: expected {expected}, found {found}", path.display());
    Ok(())
}
