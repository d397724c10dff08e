//! The folder of an imported session: what may be replaced in it, and what is said of it.

use super::arguments::ImportArgs;
use super::units::is_uncertainty;
use crate::column_words::{option_of, quoted};
use crate::output::{OutputFolder, ResultKind, first_line};
use crate::simulated::word;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use wcal_core::InputFile;
use wcal_core::text::{brief, printable};
use wcal_session::TextTable;

/// Name of the object's mesh in the folder.
pub(crate) const OBJECT: &str = "object.stl";

/// An imported session: its description says which command made it.
pub(super) const RESULT: ResultKind<'_> = ResultKind {
    kept: &["unsealed.json"],
    made_of,
    ..ResultKind::new(
        "import",
        "session.toml",
        "command = [\"import\"",
        &["points.csv", "holdout.csv", "rest_shape.csv", OBJECT],
    )
};

/// The option that takes a further column.
const WAY_IN: &str =
    "; --covariate COLUMN takes one, --covariate NAME=COLUMN under its name in the session";

/// The tables that an imported session was made of, and its columns.
fn made_of(folder: &Path) -> Option<String> {
    let names = earlier_inputs(folder)?
        .into_iter()
        .map(|(name, _)| name)
        .collect::<Vec<_>>()
        .join(", ");
    let columns = first_line(&folder.join("points.csv")).unwrap_or_default();
    Some(described(&names, &columns))
}

fn described(tables: &str, columns: &str) -> String {
    format!("{tables} with the columns {columns}")
}

/// Name and hash of each table that an imported session was made of.
fn earlier_inputs(folder: &Path) -> Option<Vec<(String, String)>> {
    let text = wcal_core::files::read_text(folder.join("session.toml")).ok()?;
    let table = wcal_core::document::toml(&text).ok()?;
    let inputs = table.get("provenance")?.get("inputs")?.as_array()?;
    let text = |input: &toml::Value, key: &str| Some(input.get(key)?.as_str()?.to_owned());
    inputs
        .iter()
        .map(|input| Some((text(input, "path")?, text(input, "sha256")?)))
        .collect()
}

/// Refuses to replace the session of other tables. The same table may be imported again with other
/// options, and a later state of it with the same columns.
pub(super) fn refuse_other_tables(
    out: &OutputFolder<'_>,
    tables: &[TextTable],
    points: &str,
) -> anyhow::Result<()> {
    let earlier = earlier_inputs(out.folder()).unwrap_or_default();
    // The first is the table of the points; a holdout may be added or left out.
    if earlier
        .first()
        .zip(tables.first())
        .is_some_and(|((_, sha256), table)| *sha256 == table.sha256)
    {
        return Ok(());
    }
    let names: Vec<String> = tables.iter().map(|table| file_name(&table.file)).collect();
    let columns = points.lines().next().unwrap_or_default();
    out.refuse_other(&described(&names.join(", "), columns))
}

/// Name of a file without its folders.
pub(super) fn file_name(path: &str) -> String {
    let name = Path::new(path).file_name();
    name.map_or_else(|| path.to_owned(), |n| n.to_string_lossy().into_owned())
}

/// Says what was imported, and what was odd about it; exit code 3 where the new session carries
/// warnings.
pub(super) fn say(
    args: &ImportArgs,
    document: &ImportDocument<'_>,
    sources: &[TextTable],
) -> anyhow::Result<ExitCode> {
    let ImportDocument {
        session,
        kind,
        rows,
        warnings,
        columns_left_out,
        ..
    } = document;
    if args.json {
        println!("{}", serde_json::to_string_pretty(document)?);
    } else {
        let what = if kind == "sweep" { "sweep" } else { "session" };
        let folder = printable(&args.out.display().to_string());
        println!(
            "{folder}: {rows} rows, {what} {session:?}{}",
            word(document.simulated)
        );
    }
    // Of the tables that were given: those of the session end as they should.
    for remark in sources.iter().filter_map(|table| table.warning()) {
        eprintln!("{remark}");
    }
    for remark in &document.remarks {
        eprintln!("{}", brief(remark));
    }
    for (source, encoding) in sources.iter().filter_map(|s| Some((s, s.encoding?))) {
        eprintln!("{}: read as {encoding}", brief(&source.file));
    }
    let (uncertain, others): (Vec<&str>, Vec<&str>) = columns_left_out
        .iter()
        .map(String::as_str)
        .partition(|name| is_uncertainty(name));
    if !others.is_empty() {
        let way_in = if kind == "sweep" { "" } else { WAY_IN };
        let shown = |name: &&str| {
            let option = option_of(name).filter(|_| kind != "sweep");
            option.map_or((*name).to_owned(), |option| {
                format!("{name} ({option} {})", quoted(name))
            })
        };
        let shown: Vec<String> = others.iter().map(shown).collect();
        eprintln!(
            "columns not imported: {}{way_in}",
            printable(&shown.join(", "))
        );
    }
    for name in uncertain.into_iter().map(printable) {
        eprintln!(
            "column not imported: {name} looks like an uncertainty; --stimulus-sd {name} takes the stimulus' standard one, which weighs the fit. \
             What all readings share of it, as the reference's own error, comes on top of the stated uncertainties. As a covariate it would count as a cause"
        );
    }
    for warning in warnings {
        eprintln!("warning: {}", printable(warning));
    }
    Ok(crate::printing::exit_code(warnings.is_empty()))
}

/// A table that became a session.
#[derive(Serialize, JsonSchema)]
pub(crate) struct ImportDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-import/1"))]
    pub(super) format: &'static str,
    /// Identifier.
    pub(super) session: String,
    /// Kind.
    #[schemars(extend("enum" = ["whisker", "transducer", "axis", "sweep"]))]
    pub(super) kind: String,
    /// Folder.
    pub(super) folder: &'a Path,
    /// Marked as simulated.
    pub(super) simulated: bool,
    /// Rows.
    pub(super) rows: usize,
    /// Sealed rows.
    pub(super) holdout_rows: usize,
    /// Columns of the table that the session does not have.
    pub(super) columns_left_out: Vec<String>,
    /// How the tables were read.
    pub(super) remarks: Vec<String>,
    /// What is odd about them.
    pub(super) warnings: Vec<String>,
    /// Files written; none of a sweep.
    pub(super) inputs: Vec<InputFile>,
}
