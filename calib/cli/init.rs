//! `wcal init`: commented templates to start from.

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_core::files::write_atomic;

/// Arguments of `wcal init`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal init sessions/2026-11-20          a whisker session to fill in
  wcal init --kind rig rigs/bench-1      a rig description
  wcal init --kind plan plans/paper-27   a measurement plan")]
pub struct InitArgs {
    /// Folder for the templates; files that exist are never overwritten
    pub dir: PathBuf,
    /// What to start
    #[arg(long, value_enum, default_value_t = Template::Session)]
    pub kind: Template,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// What a template describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Template {
    /// session.toml and points.csv of a whisker.
    Session,
    /// rig.toml.
    Rig,
    /// plan.toml.
    Plan,
}

impl Template {
    fn files(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Session => &[
                ("session.toml", include_str!("templates/session.toml")),
                ("points.csv", include_str!("templates/points.csv")),
            ],
            Self::Rig => &[("rig.toml", include_str!("templates/rig.toml"))],
            Self::Plan => &[("plan.toml", include_str!("templates/plan.toml"))],
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Where a file exists already (nothing is written then), or on I/O errors.
pub fn run(args: &InitArgs) -> anyhow::Result<ExitCode> {
    let files = args.kind.files();
    for (name, _) in files {
        let path = args.dir.join(name);
        if path.exists() {
            bail!("{}: expected no such file, found one; choose another folder or remove it", path.display());
        }
    }
    std::fs::create_dir_all(&args.dir)
        .with_context(|| format!("making the folder {}", args.dir.display()))?;
    for (name, content) in files {
        write_atomic(&args.dir.join(name), content.as_bytes())?;
    }
    let written: Vec<PathBuf> = files.iter().map(|(name, _)| args.dir.join(name)).collect();
    if args.json {
        let document = serde_json::json!({ "format": "wcal-init/1", "files": written });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        written.iter().for_each(|path| println!("{}", path.display()));
    }
    Ok(ExitCode::SUCCESS)
}
