//! `session.toml` of an imported session.

use super::arguments::{Declared, ImportArgs, Kind, name_of};
use super::columns::Plan;
use super::imported::file_name;
use super::noticed::Noticed;
use crate::column_words::is_deviation;
use crate::simulated::is_simulated;
use anyhow::{Context, Result, bail, ensure};
use std::path::Path;
use toml::{Table, Value};
use wcal_core::TransducerModel;
use wcal_core::files::{read, read_text};
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
pub(super) fn identifier(args: &ImportArgs) -> Result<String> {
    let folder = args
        .out
        .file_name()
        .map(|n| n.to_string_lossy().into_owned());
    folder.context("--out: expected the name of a new folder")
}

/// What every imported session states, its tables of points and of the holdout by their names. The
/// medium is air; session.toml is where another one is stated.
pub(super) fn header(args: &ImportArgs, kind: &str, files: &[(&str, &str)]) -> Result<Table> {
    let files = files.iter().map(|(key, file)| (*key, (*file).into()));
    Ok(table([
        ("format", SESSION_FORMAT.into()),
        ("id", identifier(args)?.into()),
        ("kind", kind.into()),
        ("medium", "air".into()),
        ("created", created()?.into()),
        ("files", table(files).into()),
    ]))
}

/// Text of `session.toml`, and further files that it names.
pub(super) fn write(
    args: &ImportArgs,
    sources: &[TextTable],
    plan: &Plan<'_>,
    noticed: &Noticed,
) -> Result<(String, Tables)> {
    let mut more = Vec::new();
    let tables = [("points", "points.csv"), ("holdout", "holdout.csv")];
    let mut top = header(args, &name_of(args.kind), &tables[..sources.len()])?;
    let whisker = match &args.model {
        Some(Declared::Whisker(file)) if args.kind == Kind::Whisker => Some(file),
        Some(Declared::Law(_)) if args.kind == Kind::Transducer => None,
        None => None,
        Some(_) if args.kind == Kind::Axis => bail!("--model: an axis takes none; leave it out"),
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
    let renamed = plan.renamed();
    provenance.extend((!renamed.is_empty()).then(|| ("columns".to_owned(), Value::Table(renamed))));
    top.insert("provenance".to_owned(), Value::Table(provenance));
    Ok((toml::to_string(&top)?, more))
}

/// Now, or the time in SOURCE_DATE_EPOCH, so that an import can be repeated to the byte.
fn created() -> Result<String> {
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
    let model = match args.model {
        Some(Declared::Law(TransducerModel::Constant)) => "constant",
        Some(Declared::Law(TransducerModel::Quadratic)) => "quadratic",
        _ => "linear",
    };
    let deviation = args.response.as_deref().is_some_and(is_deviation);
    let deviation = deviation.then(|| ("deviation", true.into()));
    let stated = [
        ("stimulus_unit", stimulus_unit.into()),
        ("response_unit", response_unit.as_str().into()),
        ("model", model.into()),
    ];
    let reference = args.reference_sd.map(|sd| ("reference_sd", sd.into()));
    table(stated.into_iter().chain(deviation).chain(reference))
}

pub(super) fn provenance(sources: &[TextTable], simulated: bool, noticed: &Noticed) -> Table {
    let inputs = sources.iter().map(|source| {
        let entry = [
            ("path", file_name(&source.file).into()),
            ("sha256", source.sha256.clone().into()),
        ];
        Value::Table(table(entry))
    });
    let command: Vec<String> = crate::kept::command().into_iter().skip(1).collect();
    let read = [&noticed.remarks[..], &noticed.warnings].concat();
    let read = (!read.is_empty()).then(|| ("read", read.into()));
    let simulated = simulated.then(|| ("simulated", true.into()));
    let stated = [
        (
            "program",
            concat!("wcal ", env!("CARGO_PKG_VERSION")).into(),
        ),
        ("command", command.into()),
        ("inputs", Value::Array(inputs.collect())),
    ];
    table(stated.into_iter().chain(read).chain(simulated))
}

/// A table of these entries.
pub(super) fn table<'a>(entries: impl IntoIterator<Item = (&'a str, Value)>) -> Table {
    let owned = |(key, value): (&str, Value)| (key.to_owned(), value);
    entries.into_iter().map(owned).collect()
}

/// Takes the whisker's tables from another description, its rest shape with it.
fn take_over(path: &Path, top: &mut Table, more: &mut Tables) -> Result<()> {
    let meta = wcal_core::document::toml(&read_text(path)?)
        .with_context(|| format!("{}: expected valid TOML", path.display()))?;
    for key in TAKEN_OVER {
        if let Some(value) = meta.get(*key) {
            top.insert((*key).to_owned(), value.clone());
        }
    }
    // A rig has the wavelengths with its gratings, a session with what is made of them.
    let nominal = |name: &str| {
        let gratings = meta.get("interrogator")?.get("grating")?.as_array()?;
        let named = |g: &&Value| g.get("name").and_then(Value::as_str) == Some(name);
        gratings.iter().find(named)?.get("nominal_nm").cloned()
    };
    if let Some(fbg) = top.get_mut("fbg").and_then(Value::as_table_mut) {
        let sensing: Option<Vec<Value>> = ["fbg_1", "fbg_2"].map(nominal).into_iter().collect();
        let both = [
            ("nominal_nm", sensing.map(Value::Array)),
            ("reference_nominal_nm", nominal("fbg_ref")),
        ];
        for (key, value) in both {
            if let Some(value) = value {
                fbg.entry(key).or_insert(value);
            }
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
