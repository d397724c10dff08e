//! `wcal import`: a foreign table becomes a session.

mod arguments;
mod columns;
mod description;
mod imported;
mod sweep;
mod units;

use crate::output::OutputFolder;
use anyhow::Context;
pub(crate) use arguments::ImportArgs;
use arguments::{Kind, layout, name_of};
use columns::Plan;
pub(crate) use imported::ImportDocument;
use imported::{Noticed, RESULT, refuse_other_tables, say};
use std::process::ExitCode;
use wcal_session::{SessionError, SessionFiles, TextTable, read_text_table, write_session};

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
    let mut files = SessionFiles::default();
    let (mut sources, mut plans) = (Vec::new(), Vec::new());
    for (name, path) in [
        ("points.csv", Some(&args.file)),
        ("holdout.csv", args.holdout.as_ref()),
    ] {
        let Some(path) = path else { continue };
        let table = read_text_table(path, &layout)?;
        let since = plans.first().and_then(|(plan, _): &(Plan, _)| plan.since());
        let mut plan = Plan::new(args, &table, since)?;
        let points = plan.points(&table, args.kind)?;
        files.tables.push((name.to_owned(), points.csv.clone()));
        sources.push(table);
        plans.push((plan, points));
    }
    let mut columns_left_out = plans[0].0.left_out(&sources[0]);
    if let (Some(holdout), Some((plan, _))) = (sources.get(1), plans.get(1)) {
        let more = plan.left_out(holdout);
        columns_left_out.extend(
            more.into_iter()
                .filter(|name| !sources[0].columns.contains(name)),
        );
    }
    let tables: Vec<&TextTable> = sources.iter().collect();
    refuse_other_tables(&out, &tables, &files.tables[0].1)?;
    let noticed = Noticed::of(&tables, plans.iter().map(|(plan, _)| plan));
    let (text, more) = description::write(args, &tables, &plans[0].0, &noticed)?;
    files.session_toml = text;
    let own = files.tables.len();
    files.tables.extend(more);
    // Every check on a copy first; what it says of a table of the session is said of the one that
    // this was made of.
    let trial = tempfile::tempdir().context("making a folder to check the session in")?;
    let source = |file: &str| {
        (0..own)
            .find(|&k| files.tables[k].0 == file)
            .map(|k| (&sources[k], &plans[k]))
    };
    let session =
        write_session(&trial.path().join("session"), &files).map_err(|error| match error {
            SessionError::Content(error) => match source(&error.file) {
                Some((table, (plan, points))) => SessionError::Content(error.of_source(
                    &table.file,
                    |line| points.line(table, line),
                    |name| plan.source_of(table, name),
                )),
                None => SessionError::Content(error),
            },
            other => other,
        });
    let session =
        session.with_context(|| format!("importing {} as a session", args.file.display()))?;
    let warnings = session
        .warnings
        .into_iter()
        .map(|warning| match source(&warning.file) {
            Some((table, (_, points))) => {
                warning.of_source(&table.file, |line| points.line(table, line))
            }
            None => warning,
        });
    let warnings = noticed
        .warnings
        .iter()
        .cloned()
        .chain(warnings.map(|w| w.to_string()))
        .collect();
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
        rows: plans[0].1.rows.len(),
        holdout_rows: plans.get(1).map_or(0, |(_, points)| points.rows.len()),
        columns_left_out,
        remarks: noticed.remarks,
        warnings,
        inputs: session.inputs,
    };
    say(args, &document, &tables)
}
