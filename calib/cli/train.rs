//! `wcal train`: the contact tracker, trained on simulated sweeps.

mod sweeps;

use crate::output::{Overwrite, ResultKind, unsaid};
use crate::progress::Progress;
use crate::simulate::whisker;
use anyhow::{bail, ensure};
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use sweeps::Sweeps;
use wcal_report::{Curves, Fact, NumberTable, TrackingInput, render_tracking};
use wcal_session::TextTableLayout;
use wcal_track::classes::ObjectClasses;
use wcal_track::model_file::{Card, SplitBy, read_card};
use wcal_track::train::{Pass, TrainSettings, best};
use wcal_track::train_model::{TrainingRequest, train_model};

/// Arguments of `wcal train`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal train --meshes ycb/meshes --preset compact --out model
  wcal simulate --object all --sweeps 50 --out sweeps
  wcal train sweeps --epochs 8 --out model

Without a folder of sweeps it makes its own in OUT/sweeps, over the objects of --meshes or the built-in ones: clean ones, ones with friction, weight
and the drag of air, and upright ones; `wcal evaluate OUT/sweeps/clean --model OUT` scores the model.

Objects are split: some are held out for the early stop and the stated spread, some are never looked at (`wcal evaluate` scores them as
unseen), and of the others the last tenth of the sweeps is kept back. Writes model.safetensors, model.json (the card), report.html (learning
curves) and checkpoint/, from which the same command resumes. Everything here is SIMULATED.")]
pub struct TrainArgs {
    /// Folder of shards from `wcal simulate`; without it the sweeps are made, too
    pub sweeps: Option<PathBuf>,
    /// Sweeps over each object, clean ones and as many with friction, and a quarter as many upright, where no folder is given
    #[arg(long, default_value_t = SWEEPS_EACH, conflicts_with = "sweeps")]
    pub sweeps_each: u64,
    /// Another folder, of sweeps with other physics (friction, weight, ...) or seed over the same objects: added to the training, never held out or scored (may be repeated)
    #[arg(long, alias = "beside", value_name = "DIR", requires = "sweeps")]
    pub additional: Vec<PathBuf>,
    /// Folder of the objects' STL files: the answer is trained to lie on their surfaces, too; built-in objects need none
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Model with whose weights to begin; it must have been trained on the same split
    #[arg(long, value_name = "MODEL")]
    pub from: Option<PathBuf>,
    /// Network: default (weights over the rod's inverse curve), compact (the same of a third of its size), paper, or baseline (40 thousand parameters, nothing of the rod)
    #[arg(long, default_value = "default")]
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
    /// What is split: whole objects, or sweeps at random as in the paper (`wcal evaluate` then shows what that hides)
    #[arg(long, value_enum, default_value_t = SplitKind::Objects)]
    pub split: SplitKind,
    /// Classes of the objects (CSV: object,class): the spread is stated for each class, too, and `wcal track --object-class` uses it
    #[arg(long, value_name = "CSV")]
    pub classes: Option<PathBuf>,
    /// Whisker of the sweeps (whisker.toml); the nominal one without it
    #[arg(long, value_name = "TOML")]
    pub whisker: Option<PathBuf>,
    /// Seed of all draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Where to train: cpu, or gpu (gpu:N) of a program built with `--features gpu`
    #[arg(long, default_value = "cpu")]
    pub device: String,
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

/// What is split into training, early stop and test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SplitKind {
    /// Whole objects
    Objects,
    /// Sweeps at random: 70 % trained on, 10 % held out, 20 % for the test, but for the objects kept unseen
    Sweeps,
}

/// Sweeps of each kind over an object where none are given.
const SWEEPS_EACH: u64 = 40;

/// A model, its small transformer (`evaluate --baseline`) and what a second run goes on from.
const RESULT: ResultKind<'_> = ResultKind {
    command: "train",
    document: "model.json",
    format_prefix: "wcal-model/",
    files: &["model.safetensors", "report.html"],
    kept: &["checkpoint", "baseline", "sweeps"],
    resumes: true,
    made_of: unsaid,
};

/// Runs the command.
///
/// # Errors
/// Where the sweeps cannot be used or the model cannot be written.
pub fn run(args: &TrainArgs) -> anyhow::Result<ExitCode> {
    RESULT.check(&args.out, args.overwrite.force)?;
    let device = wcal_track::device(&args.device)?;
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
    let classes = args.classes.as_deref().map(object_classes).transpose()?.unwrap_or_default();
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
        command: std::iter::once("wcal".to_owned()).chain(std::env::args().skip(1)).collect(),
        from: args.from.as_deref(),
        whisker,
        preset: &args.preset,
        settings,
        held_out: args.held_out,
        unseen: args.unseen,
        split: match args.split {
            SplitKind::Objects => SplitBy::Objects,
            SplitKind::Sweeps => SplitBy::Sweeps,
        },
        classes,
        out: &args.out,
    };
    let progress = Progress::new("train");
    let card = train_model(&request, &device, |pass| {
        on_pass(pass);
        progress.at(
            &format!("pass {} of at most {}", pass.epoch, args.epochs),
            pass.epoch as f64 / args.epochs as f64,
        );
    })?;
    drop(progress);
    crate::picture_output::write(&args.out, "report.html", page(&card).as_bytes())?;
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

/// Reads `object,class`.
fn object_classes(path: &Path) -> anyhow::Result<ObjectClasses> {
    let table = wcal_session::read_text_table(path, &TextTableLayout::default())?;
    let columns = table.columns.join(",");
    ensure!(columns == "object,class", "{}: columns: expected object,class, found {columns}", table.file);
    let mut classes = ObjectClasses::new();
    for (line, row) in table.rows {
        let (object, class) = (row[0].clone(), row[1].clone());
        ensure!(!class.is_empty(), "{}:{line}: class: expected a name, found nothing", table.file);
        if let Some(before) = classes.insert(object.clone(), class) {
            bail!("{}:{line}: {object}: expected once, found again ({before})", table.file);
        }
    }
    Ok(classes)
}

/// Where trained networks run.
pub fn burn_device() -> wcal_track::Device {
    wcal_track::Device::flex()
}

fn on_pass(pass: &Pass) {
    let surface =
        pass.held_out_surface_mm.map_or_else(String::new, |s| format!(", from the surface {s:.2} mm"));
    eprintln!(
        "pass {:3}: loss {:.3}, held-out {:.3}, RMSE of the contact {:.2} mm{surface}, {:.0} s",
        pass.epoch, pass.loss, pass.held_out_loss, pass.held_out_mm, pass.seconds
    );
}

/// Learning curves and what was learned from.
pub fn page(card: &Card) -> String {
    let line = |value: fn(&Pass) -> f64| card.passes.iter().map(|p| [p.epoch as f64, value(p)]).collect();
    let mark = best(&card.passes).map(|b| (b.epoch as f64, "kept".to_owned()));
    let x = "pass".to_owned();
    let loss = Curves {
        title: "Loss".into(),
        x: x.clone(),
        y: "loss".into(),
        lines: vec![("training".into(), line(|p| p.loss)), ("held out".into(), line(|p| p.held_out_loss))],
        mark: mark.clone(),
    };
    let off = Curves {
        title: "RMSE of the true contact, held out".into(),
        x,
        y: "RMSE, mm".into(),
        lines: vec![("held out".into(), line(|p| p.held_out_mm))],
        mark,
    };
    let fact = |name: &str, value: String| Fact::new(name, value);
    let [training, held_out, unseen] =
        [&card.objects.training, &card.objects.held_out, &card.objects.unseen].map(Vec::len);
    let n = card.network;
    let row = |p: &Pass| {
        let numbers = [p.loss, p.held_out_loss, p.held_out_mm].map(|v| format!("{v:.3}"));
        std::iter::once(p.epoch.to_string()).chain(numbers).chain([format!("{:.0}", p.seconds)]).collect()
    };
    render_tracking(&TrackingInput {
        over: "Contact tracker".into(),
        title: "Training".into(),
        facts: vec![
            fact("weights, SHA-256", card.weights_sha256.clone()),
            fact("objects", format!("{training} trained on, {held_out} held out, {unseen} unseen")),
            fact(
                "network",
                format!("{} layers, {} heads, width {}, {} inputs", n.layers, n.heads, n.width, n.inputs),
            ),
            fact("seed", card.training.seed.to_string()),
        ],
        notes: Vec::new(),
        curves: if card.passes.is_empty() { Vec::new() } else { vec![loss, off] },
        tables: vec![NumberTable {
            caption: "Passes".into(),
            columns: ["pass", "loss", "held-out loss", "held-out RMSE, mm", "s"].map(str::to_owned).into(),
            rows: card.passes.iter().map(row).collect(),
        }],
    })
}
