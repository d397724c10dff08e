//! `wcal-lab train`: the contact tracker, trained on simulated sweeps.

mod arguments;
mod sweeps;

use super::simulate::whisker;
use crate::model_file::read_card;
use crate::train::{Pass, TrainSettings, best};
use crate::train_model::{TrainingRequest, train_model};
use anyhow::ensure;
pub use arguments::TrainArgs;
use burn::tensor::Device;
use std::process::ExitCode;
use sweeps::Sweeps;
use wcal::output::ResultKind;
use wcal::progress::Progress;

/// A model, and what a second run goes on from.
const RESULT: ResultKind<'_> = ResultKind {
    kept: &["checkpoint", "sweeps"],
    resumes: true,
    ..ResultKind::new("train", "model.json", "wcal-model/", &["model.safetensors"])
};

/// Runs the command.
///
/// # Errors
/// Where the sweeps cannot be used or the model cannot be written.
pub fn run(args: &TrainArgs) -> anyhow::Result<ExitCode> {
    RESULT.check(&args.out, args.overwrite.force)?;
    let whisker = whisker(args.whisker.as_deref())?;
    ensure!(
        args.rate > 0.0 && args.rate < 1.0,
        "--rate: expected above 0 and below 1, found {}",
        args.rate
    );
    ensure!(
        args.passes_per_draw > 0,
        "--passes-per-draw: expected 1 or more, found 0"
    );
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
        command: std::iter::once("wcal-lab".to_owned())
            .chain(std::env::args().skip(1))
            .collect(),
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
    let surface = pass
        .held_out_surface_mm
        .map_or_else(String::new, |s| format!(", from the surface {s:.2} mm"));
    eprintln!(
        "pass {:3}: loss {:.3}, held-out {:.3}, RMSE of the contact {:.2} mm{surface}, {:.0} s",
        pass.epoch, pass.loss, pass.held_out_loss, pass.held_out_mm, pass.seconds
    );
}
