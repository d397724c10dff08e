//! `wcal import`: a foreign table becomes a session.

mod arguments;
mod columns;
mod description;
mod imported;
mod noticed;
mod sweep;
mod units;

use crate::output::OutputFolder;
use anyhow::Context;
pub(crate) use arguments::ImportArgs;
use arguments::{Kind, layout, name_of};
use columns::Plan;
pub(crate) use imported::ImportDocument;
use imported::{RESULT, refuse_other_tables, say};
use noticed::Noticed;
use std::process::ExitCode;
use wcal_core::files::write_atomic;
use wcal_session::{SessionError, TextTable, load, read_text_table};

/// Runs the command: exit code 0, or 3 where the new session carries warnings.
///
/// # Errors
/// Where the table or the resulting session cannot be used; nothing is written then.
pub(crate) fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    if args.kind == Kind::Sweep {
        return sweep::run(args);
    }
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let layout = layout(args);
    let tables = [Some(&args.file), args.holdout.as_ref()];
    let tables = tables.into_iter().flatten();
    let tables: Vec<TextTable> = tables
        .map(|path| read_text_table(path, &layout))
        .collect::<Result<_, _>>()?;
    let mut plans: Vec<Plan<'_>> = Vec::new();
    for table in &tables {
        // Time stamps of the holdout count from the first table's beginning: one axis for both.
        let since = plans.first().and_then(Plan::since);
        plans.push(Plan::new(args, table, since.as_deref())?);
    }
    let first = &plans[0];
    refuse_other_tables(&out, &tables, &first.csv)?;
    let mut noticed = Noticed::of(&tables);
    for plan in &plans {
        noticed.remarks.extend_from_slice(&plan.noticed.remarks);
        noticed.warnings.extend_from_slice(&plan.noticed.warnings);
    }
    let (session_toml, more) = description::write(args, &tables, first, &noticed)?;
    let own = ["points.csv", "holdout.csv"];
    let written = own.into_iter().zip(&plans);
    let written = written.map(|(name, plan)| (name.to_owned(), plan.csv.clone().into_bytes()));
    let description = ("session.toml".to_owned(), session_toml.into_bytes());
    let files: Vec<_> = written.chain(more).chain([description]).collect();
    // Every check on a copy first; what it says of a table of the session is said of the one that
    // this was made of.
    let trial = tempfile::tempdir().context("making a folder to check the session in")?;
    for (name, bytes) in &files {
        write_atomic(&trial.path().join(name), bytes)?;
    }
    let source = |file: &str| plans.get(own.iter().position(|name| *name == file)?);
    let session = load(trial.path()).map_err(|error| match error {
        SessionError::Content(error) => SessionError::Content(match source(&error.file) {
            Some(plan) => error.of_source(
                &plan.table.file,
                |line| plan.line(line),
                |name| plan.source_of(name),
            ),
            None => error,
        }),
        other => other,
    });
    let session =
        session.with_context(|| format!("importing {} as a session", args.file.display()))?;
    let mut warnings = noticed.warnings;
    for warning in session.warnings {
        let warning = match source(&warning.file) {
            Some(plan) => warning.of_source(&plan.table.file, |line| plan.line(line)),
            None => warning,
        };
        warnings.push(warning.to_string());
    }
    // The copy has passed every check: only now the folder changes.
    for (name, bytes) in files {
        out.put(&name, bytes);
    }
    out.finish()?;
    let mut columns_left_out = first.left_out();
    for holdout in &plans[1..] {
        let more = holdout.left_out();
        let new = more.into_iter().filter(|c| !tables[0].columns.contains(c));
        columns_left_out.extend(new);
    }
    let document = ImportDocument {
        format: "wcal-import/1",
        session: session.id,
        kind: name_of(args.kind),
        folder: &args.out,
        simulated: session.simulated,
        rows: first.rows.len(),
        holdout_rows: plans[1..].iter().map(|plan| plan.rows.len()).sum(),
        columns_left_out,
        remarks: noticed.remarks,
        warnings,
        inputs: session.inputs,
    };
    say(args, &document, &tables)
}
