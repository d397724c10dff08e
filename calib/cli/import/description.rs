//! `session.toml` of an imported session.

use super::{Declared, ImportArgs, Kind, Model, name_of};
use crate::simulated::is_simulated;
use anyhow::{Context, bail, ensure};
use std::path::Path;
use toml::{Table, Value};
use wcal_session::{SESSION_FORMAT, TextTable};

/// Tables of a whisker's description that are taken over.
const TAKEN_OVER: &[&str] =
    &["medium", "whisker", "moments", "fbg", "trajectory", "devices", "note", "whisker_id"];

/// Files beside `session.toml`: name and content.
type Tables = Vec<(String, Vec<u8>)>;

/// Surrounding medium of an imported session; session.toml is where another one is stated.
pub(super) const MEDIUM: &str = "air";

/// The folder's name.
pub(super) fn identifier(args: &ImportArgs) -> anyhow::Result<String> {
    let folder = args.out.file_name().map(|n| n.to_string_lossy().into_owned());
    folder.context("--out: expected the name of a new folder")
}

/// Text of `session.toml`, and further files that it names.
pub(super) fn write(args: &ImportArgs, sources: &[&TextTable]) -> anyhow::Result<(String, Tables)> {
    let id = identifier(args)?;
    let mut more = Vec::new();
    let mut top = Table::new();
    let mut text = |key: &str, value: &str| top.insert(key.to_owned(), Value::from(value));
    text("format", SESSION_FORMAT);
    text("id", &id);
    text("kind", &name_of(args.kind));
    text("medium", MEDIUM);
    text("created", &created()?);
    let mut files = Table::new();
    files.insert("points".to_owned(), Value::from("points.csv"));
    if sources.len() > 1 {
        files.insert("holdout".to_owned(), Value::from("holdout.csv"));
    }
    let whisker = match &args.model {
        Some(Declared::Whisker(file)) if args.kind == Kind::Whisker => Some(file),
        Some(Declared::Law(_)) if args.kind == Kind::Transducer => None,
        None => None,
        Some(_) => bail!(
            "--model: expected a law for a transducer, a file WHISKER.toml for a whisker, found the other"
        ),
    };
    if let Some(file) = whisker {
        take_over(file, &mut top, &mut files, &mut more)?;
    }
    top.insert("files".to_owned(), Value::Table(files));
    if args.kind == Kind::Transducer {
        top.insert("transducer".to_owned(), Value::Table(transducer(args)));
    }
    let mut provenance = provenance(sources);
    // A table out of a simulated session stays simulated.
    if whisker.into_iter().chain([&args.file]).any(|path| is_simulated(path)) {
        provenance.insert("simulated".to_owned(), Value::Boolean(true));
    }
    top.insert("provenance".to_owned(), Value::Table(provenance));
    Ok((toml::to_string(&top)?, more))
}

/// Now, or the time in SOURCE_DATE_EPOCH, so that an import can be repeated to the byte.
pub(super) fn created() -> anyhow::Result<String> {
    let stamp = match std::env::var("SOURCE_DATE_EPOCH") {
        Ok(seconds) => {
            let seconds = seconds
                .parse()
                .with_context(|| format!("SOURCE_DATE_EPOCH: expected seconds, found {seconds:?}"))?;
            jiff::Timestamp::from_second(seconds)?
        }
        Err(_) => jiff::Timestamp::now(),
    };
    Ok(stamp.strftime("%Y-%m-%dT%H:%M:%SZ").to_string())
}

fn transducer(args: &ImportArgs) -> Table {
    let counted = args.stimulus.is_none();
    let stimulus_unit = if counted { "observation" } else { args.stimulus_unit.as_str() };
    let model = match args.model {
        Some(Declared::Law(law)) => name_of(law),
        _ => name_of(Model::Linear),
    };
    [("stimulus_unit", stimulus_unit), ("response_unit", &args.response_unit), ("model", &model)]
        .into_iter()
        .map(|(key, value)| (key.to_owned(), Value::from(value)))
        .collect()
}

pub(super) fn provenance(sources: &[&TextTable]) -> Table {
    let short = |path: &str| {
        Path::new(path).file_name().map_or(path.to_owned(), |n| n.to_string_lossy().into_owned())
    };
    let inputs = sources.iter().map(|source| {
        let entry = [("path", short(&source.file)), ("sha256", source.sha256.clone())];
        Value::Table(entry.into_iter().map(|(key, value)| (key.to_owned(), Value::from(value))).collect())
    });
    let mut table = Table::new();
    table.insert("program".to_owned(), Value::from(format!("wcal {}", env!("CARGO_PKG_VERSION"))));
    table.insert("command".to_owned(), std::env::args().skip(1).collect::<Vec<_>>().into());
    table.insert("inputs".to_owned(), Value::Array(inputs.collect()));
    table
}

/// Takes the whisker's tables from another description, its rest shape with it.
fn take_over(path: &Path, top: &mut Table, files: &mut Table, more: &mut Tables) -> anyhow::Result<()> {
    let text = wcal_core::files::read_text(path).with_context(|| format!("reading {}", path.display()))?;
    let meta = wcal_core::document::toml(&text)
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
    let shape = meta.get("files").and_then(|f| f.get("rest_shape")).and_then(Value::as_str);
    if let Some(name) = shape {
        let source = path.parent().unwrap_or(Path::new(".")).join(name);
        let bytes =
            wcal_core::files::read(&source).with_context(|| format!("reading {}", source.display()))?;
        files.insert("rest_shape".to_owned(), Value::from("rest_shape.csv"));
        more.push(("rest_shape.csv".to_owned(), bytes));
    }
    Ok(())
}
