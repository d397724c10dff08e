//! Transducer and axis sessions through the program, end to end: measured data with certified
//! answers, negative controls, broken input.

mod applied;
mod measured;
mod plausible;
mod refusals;
mod wording;

use crate::support::{fixture, wcal};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

fn nist(name: &str) -> PathBuf {
    fixture("nist").join(name)
}

/// A session with the points table of a fixture rewritten line by line (header left out).
fn disturbed(name: &str, change: impl Fn(usize, &[&str]) -> String) -> tempfile::TempDir {
    let text = fs::read_to_string(nist(name).join("points.csv")).unwrap();
    let mut lines = text.lines();
    let header = lines.next().unwrap().to_owned();
    let rows = lines
        .enumerate()
        .map(|(k, line)| change(k, &line.split(',').collect::<Vec<_>>()));
    let table: Vec<String> = std::iter::once(header).chain(rows).collect();
    let toml = fs::read_to_string(nist(name).join("session.toml")).unwrap();
    session(&toml, &table.join("\n"))
}

fn session(toml: &str, points: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("session.toml"), toml).unwrap();
    fs::write(folder.path().join("points.csv"), format!("{points}\n")).unwrap();
    folder
}

const TRANSDUCER: &str = "format = \"wcal-session/1\"\nid = \"made\"\nkind = \"transducer\"\nmedium = \"air\"\ncreated = \"2026-01-01T00:00:00Z\"\n[files]\npoints = \"points.csv\"\n[transducer]\nmodel = \"linear\"\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\n";
const AXIS: &str = "format = \"wcal-session/1\"\nid = \"made\"\nkind = \"axis\"\nmedium = \"air\"\ncreated = \"2026-01-01T00:00:00Z\"\n[files]\npoints = \"points.csv\"\n";

/// Exit code, verify.json, calibration.json where one was written, all results in a folder of their
/// own.
struct Run {
    code: i32,
    verify: Value,
    calibration: Option<Value>,
    out: tempfile::TempDir,
}

fn verify(folder: &Path) -> Run {
    let out = tempfile::tempdir().unwrap();
    let run = wcal(&[
        "verify",
        folder.to_str().unwrap(),
        "--out",
        out.path().to_str().unwrap(),
        "--json",
    ]);
    let stderr = String::from_utf8_lossy(&run.stderr).into_owned();
    let verify: Value =
        serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {stderr}"));
    let written: Value =
        serde_json::from_slice(&fs::read(out.path().join("verify.json")).unwrap()).unwrap();
    assert_eq!(verify, written, "--json prints what is written");
    assert!(
        fs::read_to_string(out.path().join("report.html"))
            .unwrap()
            .contains("What was found")
    );
    let calibration = fs::read(out.path().join("calibration.json")).ok();
    let calibration = calibration.map(|bytes| serde_json::from_slice(&bytes).unwrap());
    Run {
        code: run.status.code().unwrap(),
        verify,
        calibration,
        out,
    }
}

impl Run {
    fn verdict(&self) -> &str {
        self.verify["verdict"].as_str().unwrap()
    }
    fn effects(&self) -> Vec<&str> {
        self.verify["effects"]
            .as_array()
            .unwrap()
            .iter()
            .map(|e| e["id"].as_str().unwrap())
            .collect()
    }
    fn rmse(&self, when: &str, key: &str) -> f64 {
        self.verify[when][key].as_f64().unwrap()
    }
    fn polynomial(&self, field: &str) -> Vec<f64> {
        let values = &self.calibration.as_ref().unwrap()["model"]["polynomial"][field];
        values
            .as_array()
            .unwrap()
            .iter()
            .map(|v| v.as_f64().unwrap())
            .collect()
    }
    fn lack_of_fit(&self, model: usize, field: &str) -> f64 {
        self.calibration.as_ref().unwrap()["model"]["lack_of_fit"][model][field]
            .as_f64()
            .unwrap()
    }
}

/// A fair, repeatable sequence between -1 and 1 (made data).
fn scatter(k: usize) -> f64 {
    let h = (k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((h >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
}

/// `n` readings of an axis running to and fro over 10 mm; `error_um` beyond the scatter of 1 um.
fn axis_table(n: usize, error_um: impl Fn(f64, f64) -> f64) -> String {
    let rows: Vec<String> = (0..n)
        .map(|k| {
            let place = k % 40;
            let (x, way) = if place < 20 {
                (0.5 * place as f64, 1.0)
            } else {
                (0.5 * (40 - place) as f64, -1.0)
            };
            let measured = x + 1e-3 * (4.0 + error_um(x, way) + scatter(k));
            format!("{k},calibration,{x},{measured},{},{way}", 2 * k)
        })
        .collect();
    format!(
        "point,role,commanded_mm,measured_mm,t_s,direction\n{}",
        rows.join("\n")
    )
}

fn line_table(n: usize, header: &str, row: impl Fn(usize, f64, f64) -> String) -> String {
    let rows: Vec<String> = (0..n)
        .map(|k| {
            let x = 1.0 + (k % 10) as f64;
            row(k, x, 0.1 + 0.2 * x + 0.01 * scatter(k))
        })
        .collect();
    format!("{header}\n{}", rows.join("\n"))
}

/// A table whose response bends, so that an effect is found and a calibration is verified.
fn bent_table(rows: usize) -> String {
    line_table(rows, "point,role,stimulus,response", |k, x, y| {
        format!("{k},calibration,{x},{}", y + 0.02 * x * x)
    })
}

/// Columns of a table by name.
fn column(csv: &str, name: &str) -> Vec<f64> {
    let header: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
    let index = header
        .iter()
        .position(|h| *h == name)
        .unwrap_or_else(|| panic!("{name} in {header:?}"));
    csv.lines()
        .skip(1)
        .map(|l| l.split(',').nth(index).unwrap().parse().unwrap_or(f64::NAN))
        .collect()
}
