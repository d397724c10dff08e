//! `wcal import`: a foreign table becomes a session.

mod arguments;
mod columns;
mod description;
mod imported;
mod sweep;

use crate::output::OutputFolder;
use anyhow::Context;
pub use arguments::ImportArgs;
use arguments::{Kind, layout, name_of};
use columns::Plan;
pub use imported::ImportDocument;
use imported::{RESULT, refuse_other_tables, say};
use std::process::ExitCode;
use wcal_session::{SessionFiles, read_text_table, write_session};

/// Runs the command: exit code 0, or 3 where the new session carries warnings.
///
/// # Errors
/// Where the table or the resulting session cannot be used; nothing is written then.
pub fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    if args.kind == Kind::Sweep {
        return sweep::run(args);
    }
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let layout = layout(args);
    let table = read_text_table(&args.file, &layout)?;
    let plan = Plan::new(args, &table)?;
    let mut files = SessionFiles::default();
    files.tables.push(("points.csv".to_owned(), plan.csv(&table)?));
    let mut columns_left_out = plan.left_out(&table);
    let mut sources = vec![&table];
    let holdout = args.holdout.as_deref().map(|path| read_text_table(path, &layout)).transpose()?;
    if let Some(holdout) = &holdout {
        let plan = Plan::new(args, holdout)?;
        files.tables.push(("holdout.csv".to_owned(), plan.csv(holdout)?));
        let more = plan.left_out(holdout);
        columns_left_out.extend(more.into_iter().filter(|name| !table.columns.contains(name)));
        sources.push(holdout);
    }
    refuse_other_tables(&out, &sources, &files.tables[0].1)?;
    let (text, more) = description::write(args, &sources)?;
    files.session_toml = text;
    files.tables.extend(more);
    // Every check on a copy first.
    let trial = tempfile::tempdir().context("making a folder to check the session in")?;
    let session = write_session(&trial.path().join("session"), &files)
        .with_context(|| format!("importing {} as a session", args.file.display()))?;
    for (name, bytes) in files.tables {
        out.put(&name, bytes);
    }
    out.put("session.toml", files.session_toml);
    out.finish()?;
    let document = ImportDocument {
        format: "wcal-import/1",
        session: session.id,
        kind: name_of(args.kind),
        folder: &args.out,
        simulated: session.simulated,
        rows: table.rows.len(),
        holdout_rows: holdout.as_ref().map_or(0, |h| h.rows.len()),
        columns_left_out,
        warnings: session.warnings.iter().map(ToString::to_string).chain(plan.repeated).collect(),
        inputs: session.inputs,
    };
    say(args, &document, &sources)
}
