//! Every number of a document in turn as -1, 0, 1e9, 1e308 and NaN: an error that names the key, or
//! a good run where a bench can have the number. A key sees two or three of the values, its
//! neighbour the others; all of them where WCAL_ALL_NUMBERS is set.
//!
//! Of an array the first entry stands for all: they have one range.

use super::limits::{in_parallel, limited, sound};
use super::*;
use crate::support::copy::copy_folder;
use crate::support::repository;
use serde_json::Value;

/// What is put in place of a number. A whole number where one is wanted: otherwise the type alone
/// would be refused.
const VALUES: [&str; 5] = ["-1", "0", "1000000000", "1e308", "NaN"];
/// Stands for it until the document is text.
const HERE: &str = "number under test";

/// Keys whose number is judged with that of another one, which the error may name in their place.
const BESIDE: [(&str, &str); 7] = [
    ("trajectory/0/origin_mm/0", "trajectory 1"),
    ("stage/zero_mm", "retract_mm"),
    ("trajectory/0/id", "trajectory 1"),
    ("declared/polynomial", "coefficients"),
    ("inverse/tilts", "network: expected"),
    ("network/nodes", "head.weight"),
    ("distortion/coefficients/0", "stereo-shape: 00001 rejected"),
];

/// A document, the file it stands in, and a command that reads it.
pub(super) struct Document {
    pub(super) name: &'static str,
    pub(super) file: &'static str,
    pub(super) content: Value,
    pub(super) arguments: Vec<&'static str>,
    /// Sealed by a hash over its content.
    pub(super) sealed: bool,
}

/// Keys whose quantity is more than nothing: sizes, rates, moduli.
const POSITIVE: [&str; 23] = [
    "diameter_mm",
    "whisker/length_mm",
    "arc_radius_mm",
    "youngs_gpa",
    "shear_gpa",
    "microstep_um",
    "travel_mm",
    "rate_hz",
    "window_nm",
    "nominal_nm",
    "reference_nominal_nm",
    "baud",
    "size_px",
    "image_size_px",
    "replicates",
    "max_speed_mm_s",
    "unit/acceleration_mm_s2",
    "limit_steps",
    "scale_pm",
    "averaging/samples",
    "clock_scale",
    "board_square_mm",
    "tags/size_mm",
];
/// Keys whose quantity is nothing at least: spreads, times to wait, counts.
const NOT_NEGATIVE: [&str; 20] = [
    "variance",
    "variance_nmm2",
    "noise_sd_pm",
    "noise_pm",
    "averaging/common",
    "nugget",
    "inflation",
    "dof",
    "covariance",
    "dwell_s",
    "average_s",
    "window_s",
    "timeout_s",
    "soak_s",
    "straight_mm",
    "density_kg_m3",
    "friction",
    "damping_s",
    "armature_s2",
    "creep_s",
];

/// Whether no bench has this number under this key. A document that takes it is read without its
/// ranges: the exit code alone said nothing.
pub(super) fn impossible(way: &str, value: &str) -> bool {
    let key: Vec<&str> = way
        .split('/')
        .filter(|part| part.parse::<usize>().is_err())
        .collect();
    let key = key.join("/");
    let is = |names: &[&str]| {
        names
            .iter()
            .any(|name| key == *name || key.ends_with(&format!("/{name}")))
    };
    match value {
        "NaN" | "1e308" => true,
        "0" => is(&POSITIVE),
        "-1" => is(&POSITIVE) || is(&NOT_NEGATIVE),
        _ => false,
    }
}

/// Ways to the numbers below a value; of arrays the first entry.
fn numbers(value: &Value, way: &str, all: &mut Vec<String>) {
    match value {
        Value::Number(_) => all.push(way.to_owned()),
        Value::Array(entries) => {
            entries
                .iter()
                .take(1)
                .for_each(|entry| numbers(entry, &format!("{way}/0"), all));
        }
        Value::Object(map) => map.iter().for_each(|(key, entry)| {
            numbers(
                entry,
                &format!("{way}/{}", key.replace('~', "~0").replace('/', "~1")),
                all,
            );
        }),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

impl Document {
    pub(super) fn new(
        name: &'static str,
        file: &'static str,
        content: Value,
        arguments: &'static str,
    ) -> Self {
        let arguments = arguments.split(' ').collect();
        Self {
            name,
            file,
            content,
            arguments,
            sealed: false,
        }
    }

    fn is_toml(&self) -> bool {
        self.file.ends_with(".toml")
    }

    /// The text with one number replaced.
    fn with(&self, way: &str, value: &str) -> String {
        let mut content = self.content.clone();
        *content.pointer_mut(way).unwrap() = HERE.into();
        let quoted = format!("\"{HERE}\"");
        if self.is_toml() {
            let value = if value == "NaN" { "nan" } else { value };
            return toml::to_string(&content).unwrap().replace(&quoted, value);
        }
        let text = content.to_string().replace(&quoted, value);
        // A sealed document is sealed anew, as a program would that writes such a number.
        match serde_json::from_str::<Value>(&text) {
            Ok(changed) if self.sealed => {
                calibrations::calibration(changed["model"].clone()).to_string()
            }
            _ => text,
        }
    }
}

/// Runs the command on the document with every number replaced in turn; what a user may not meet.
fn walk(place: &Path, document: &Document) -> Vec<String> {
    let mut ways = Vec::new();
    numbers(&document.content, "", &mut ways);
    // Sealing anew keeps the model alone.
    ways.retain(|way| !document.sealed || way.starts_with("/model/"));
    assert!(!ways.is_empty(), "{}: numbers", document.name);
    // Half of the pairs, by turns.
    let all = std::env::var_os("WCAL_ALL_NUMBERS").is_some();
    let pairs = ways.iter().enumerate().flat_map(|(k, way)| {
        VALUES
            .into_iter()
            .enumerate()
            .map(move |(v, value)| (k + v, way, value))
    });
    let cases: Vec<(&String, &str)> = pairs
        .filter(|(n, _, _)| all || n % 2 == 0)
        .map(|(_, way, value)| (way, value))
        .collect();
    in_parallel(&cases, |(way, value)| {
        let own = tempfile::tempdir().unwrap();
        copy_folder(place, own.path());
        fs::write(own.path().join(document.file), document.with(way, value)).unwrap();
        let output = limited(own.path(), &document.arguments);
        let shown = format!("{}: {way} = {value}", document.name);
        let text = sound(&output).map_err(|why| format!("{shown}: {why}"))?;
        if output.status.code() != Some(1) {
            if impossible(way, value) {
                return Err(format!("{shown}: taken, which no bench can have"));
            }
            let table = fs::read_to_string(own.path().join("o.csv")).unwrap_or_default();
            let odd = table
                .lines()
                .find(|line| line.contains("NaN") || line.contains("inf"));
            return odd.map_or(Ok(()), |line| {
                Err(format!("{shown}: no numbers in the result: {line}"))
            });
        }
        let key = way
            .rsplit('/')
            .find(|part| part.parse::<usize>().is_err())
            .unwrap();
        // A number that is good alone and not beside another one: the error names that.
        let beside = BESIDE
            .iter()
            .any(|(end, name)| way.ends_with(end) && text.contains(name));
        // JSON has no NaN: the error is one of syntax, by its line.
        if text.contains(key)
            || beside
            || (*value == "NaN" && !document.is_toml() && text.contains("line"))
        {
            return Ok(());
        }
        Err(format!("{shown}: the error does not name the key: {text}"))
    })
}

pub(super) fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

pub(super) fn toml(text: &str) -> Value {
    serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap()
}

pub(super) fn read(name: &str) -> String {
    fs::read_to_string(repository(name)).unwrap()
}

/// Writes the documents as they are, and holds every change of them against the rule.
pub(super) fn judge_all(place: &Path, documents: &[Document]) {
    let mut wrong = Vec::new();
    for document in documents {
        let text = if document.is_toml() {
            toml::to_string(&document.content).unwrap()
        } else {
            document.content.to_string()
        };
        fs::write(place.join(document.file), text).unwrap();
    }
    for document in documents {
        // Control: as it is, the command takes it.
        let own = tempfile::tempdir().unwrap();
        copy_folder(place, own.path());
        let output = limited(own.path(), &document.arguments);
        let text = sound(&output).unwrap_or_else(|why| panic!("{}: {why}", document.name));
        assert_ne!(output.status.code(), Some(1), "{}: {text}", document.name);
        wrong.extend(walk(place, document));
    }
    assert!(
        wrong.is_empty(),
        "{} faults\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}
