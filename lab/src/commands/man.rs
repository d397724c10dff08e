//! `wcal-lab man`: manual pages and completions of `wcal`, as a package installs them.

use anyhow::Context;
use clap::Args;
use clap_complete::Shell;
use clap_mangen::Man;
use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `wcal-lab man`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal-lab man --out target/man

Written: wcal.1, one page of each command (wcal-verify.1), and completions for bash (wcal.bash), zsh (_wcal) and fish (wcal.fish).
Earlier files of these names in the folder are replaced.")]
pub struct ManArgs {
    /// Folder for the files
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A file that cannot be written.
pub fn run(args: &ManArgs) -> anyhow::Result<ExitCode> {
    let writing = || format!("writing manual pages to {}", args.out.display());
    std::fs::create_dir_all(&args.out).with_context(writing)?;
    let mut whole = wcal::command().disable_help_subcommand(true);
    whole.build();
    for command in std::iter::once(&whole).chain(whole.get_subcommands()) {
        let page = Man::new(command.clone()).source(concat!("wcal ", env!("CARGO_PKG_VERSION")));
        let mut text = Vec::new();
        page.render(&mut text).with_context(writing)?;
        let text = with_examples_as_typed(&String::from_utf8_lossy(&text));
        std::fs::write(args.out.join(page.get_filename()), text).with_context(writing)?;
    }
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        clap_complete::generate_to(shell, &mut wcal::command(), "wcal", &args.out)
            .with_context(writing)?;
    }
    println!("manual pages and completions: {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}

/// A page whose indented lines, which are commands to type, are neither filled nor broken.
fn with_examples_as_typed(page: &str) -> String {
    let (mut out, mut filled) = (String::new(), true);
    for line in page.replace(".SH EXTRA\n", ".SH NOTES\n").lines() {
        let fill = !line.starts_with(' ');
        if fill != filled {
            out.push_str(if fill { ".fi\n" } else { ".nf\n" });
        }
        filled = fill;
        out.push_str(line);
        out.push('\n');
    }
    out
}
