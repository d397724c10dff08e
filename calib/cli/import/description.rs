//! `session.toml` of an imported session.

use super::arguments::{Declared, ImportArgs, Kind, name_of};
use super::columns::Plan;
use super::imported::Noticed;
use crate::column_words::is_deviation;
use crate::input::{read, read_text};
use crate::simulated::is_simulated;
use anyhow::{Context, bail, ensure};
use std::path::Path;
use toml::{Table, Value};
use wcal_core::TransducerModel;
use wcal_session::{SESSION_FORMAT, TextTable};

/// Tables of a whisker's description that are taken over.
const TAKEN_OVER: &[&str] = &[
    "medium",
    "whisker",
    "moments",
    "fbg",
    "trajectory",
    "devices",
    "note",
    "whisker_id",
];

/// Files beside `session.toml`: name and content.
type Tables = Vec<(String, Vec<u8>)>;

/// The folder's name.
pub(super) fn identifier(args: &ImportArgs) -> anyhow::Result<String> {
    let folder = args
        .out
        .file_name()
        .map(|n| n.to_string_lossy().into_owned());
    folder.context("--out: expected the name of a new folder")
}

/// What every imported session states, its tables of points and of the holdout by their names. The
/// medium is air; session.toml is where another one is stated.
pub(super) fn header(
    args: &ImportArgs,
    kind: &str,
    files: &[(&str, &str)],
) -> anyhow::Result<Table> {
    let text = |(key, value): (&str, &str)| (key.to_owned(), Value::from(value));
    let (id, created) = (identifier(args)?, created()?);
    let stated = [
        ("format", SESSION_FORMAT),
        ("id", &id),
        ("kind", kind),
        ("medium", "air"),
        ("created", &created),
    ];
    let files: Table = files.iter().copied().map(text).collect();
    Ok(stated
        .map(text)
        .into_iter()
        .chain([("files".to_owned(), Value::Table(files))])
        .collect())
}

/// Text of `session.toml`, and further files that it names.
pub(super) fn write(
    args: &ImportArgs,
    sources: &[&TextTable],
    plan: &Plan,
    noticed: &Noticed,
) -> anyhow::Result<(String, Tables)> {
    let mut more = Vec::new();
    let tables = [("points", "points.csv"), ("holdout", "holdout.csv")];
    let mut top = header(args, &name_of(args.kind), &tables[..sources.len()])?;
    let whisker = match &args.model {
        Some(Declared::Whisker(file)) if args.kind == Kind::Whisker => Some(file),
        Some(Declared::Law(_)) if args.kind == Kind::Transducer => None,
        None => None,
        Some(_) => bail!(
            "--model: expected a law for a transducer, a file WHISKER.toml for a whisker, found the other"
        ),
    };
    if let Some(file) = whisker {
        take_over(file, &mut top, &mut more)?;
    }
    if args.kind == Kind::Transducer {
        top.insert(
            "transducer".to_owned(),
            Value::Table(transducer(args, &plan.units)),
        );
    }
    // A table out of a simulated session stays simulated.
    let simulated = whisker
        .into_iter()
        .chain([&args.file])
        .any(|path| is_simulated(path));
    let mut provenance = provenance(sources, simulated, noticed);
    // A later table of the same instrument has the same columns.
    let renamed = plan.renamed(sources[0]);
    provenance.extend((!renamed.is_empty()).then(|| ("columns".to_owned(), Value::Table(renamed))));
    top.insert("provenance".to_owned(), Value::Table(provenance));
    Ok((toml::to_string(&top)?, more))
}

/// Now, or the time in SOURCE_DATE_EPOCH, so that an import can be repeated to the byte.
fn created() -> anyhow::Result<String> {
    let stamp = match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(seconds) => {
            let seconds = seconds.parse().with_context(|| {
                format!("SOURCE_DATE_EPOCH: expected seconds, found {seconds:?}")
            })?;
            jiff::Timestamp::from_second(seconds)?
        }
        Err(_) => jiff::Timestamp::now(),
    };
    Ok(stamp.strftime("%Y-%m-%dT%H:%M:%SZ").to_string())
}

fn transducer(args: &ImportArgs, [stimulus_unit, response_unit]: &[String; 2]) -> Table {
    let counted = args.stimulus.is_none();
    let stimulus_unit = if counted {
        "observation"
    } else {
        stimulus_unit.as_str()
    };
    let law = match args.model {
        Some(Declared::Law(law)) => law,
        _ => TransducerModel::Linear,
    };
    let model = match law {
        TransducerModel::Constant => "constant",
        TransducerModel::Linear => "linear",
        TransducerModel::Quadratic => "quadratic",
    };
    let text = [
        ("stimulus_unit", stimulus_unit),
        ("response_unit", response_unit),
        ("model", model),
    ];
    let mut table: Table = text
        .into_iter()
        .map(|(key, value)| (key.to_owned(), Value::from(value)))
        .collect();
    let deviation = args.response.as_deref().is_some_and(is_deviation);
    table.extend(deviation.then(|| ("deviation".to_owned(), Value::from(true))));
    table
}

pub(super) fn provenance(sources: &[&TextTable], simulated: bool, noticed: &Noticed) -> Table {
    let short = |path: &str| {
        Path::new(path)
            .file_name()
            .map_or(path.to_owned(), |n| n.to_string_lossy().into_owned())
    };
    let inputs = sources.iter().map(|source| {
        let entry = [
            ("path", short(&source.file)),
            ("sha256", source.sha256.clone()),
        ];
        Value::Table(
            entry
                .into_iter()
                .map(|(key, value)| (key.to_owned(), Value::from(value)))
                .collect(),
        )
    });
    let mut table = Table::new();
    table.insert(
        "program".to_owned(),
        Value::from(format!("wcal {}", env!("CARGO_PKG_VERSION"))),
    );
    table.insert(
        "command".to_owned(),
        std::env::args().skip(1).collect::<Vec<_>>().into(),
    );
    table.insert("inputs".to_owned(), Value::Array(inputs.collect()));
    let read: Vec<String> = noticed
        .remarks
        .iter()
        .chain(&noticed.warnings)
        .cloned()
        .collect();
    table.extend((!read.is_empty()).then(|| ("read".to_owned(), Value::from(read))));
    table.extend(simulated.then(|| ("simulated".to_owned(), Value::Boolean(true))));
    table
}

/// Takes the whisker's tables from another description, its rest shape with it.
fn take_over(path: &Path, top: &mut Table, more: &mut Tables) -> anyhow::Result<()> {
    let meta = wcal_core::document::toml(&read_text(path)?)
        .with_context(|| format!("{}: expected valid TOML", path.display()))?;
    for key in TAKEN_OVER {
        if let Some(value) = meta.get(*key) {
            top.insert((*key).to_owned(), value.clone());
        }
    }
    ensure!(
        top.contains_key("whisker") && top.contains_key("trajectory"),
        "{}: expected [whisker] and [[trajectory]], found neither or only one",
        path.display()
    );
    let shape = meta
        .get("files")
        .and_then(|f| f.get("rest_shape"))
        .and_then(Value::as_str);
    if let Some(name) = shape {
        let source = path.parent().unwrap_or(Path::new(".")).join(name);
        let bytes = read(&source)?;
        let files = top.get_mut("files").and_then(Value::as_table_mut);
        files.map(|files| files.insert("rest_shape".to_owned(), Value::from("rest_shape.csv")));
        more.push(("rest_shape.csv".to_owned(), bytes));
    }
    Ok(())
}
