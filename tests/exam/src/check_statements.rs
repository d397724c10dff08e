//! How often `wcal check` says of a whisker what happened to it since its calibration. SIMULATED.
//!
//! Each whisker is calibrated by a session in which nothing acts. Ten readings of another day then
//! show it unchanged, or with one change of so many of the standard deviations that the check states
//! of that change. Bench and change are of the plant, not of the program.
//!
//! ```text
//! named            the first change that is named is the one that was made, alone or in a class that cannot be told apart
//! named otherwise  the first one that is named is another, and the one that was made is not among those that could be
//! ```

use crate::statements::{Auditor, Counted, Labelled, StatementRow, tallied};
use anyhow::Context;
use nalgebra::{Rotation3, Vector3};
use serde_json::Value;
use std::path::Path;
use wcal_plant::case::{Case, CaseKind, Make, Request};
use wcal_plant::layout::Design;
use wcal_plant::session::{Day, draw_under, quick_look};
use wcal_plant::{Effect, Kind, Noise};

/// Sizes of the changes in standard deviations.
const SIZES: [f64; 2] = [4.0, 8.0];
/// Days on which nothing changed, of each whisker.
const UNCHANGED: u64 = 4;

impl Auditor {
    /// Calibrates so many whiskers and looks at each again, unchanged and with each change.
    ///
    /// # Errors
    /// Where a session cannot be drawn or written, or an answer cannot be read.
    pub fn audit_checks(&self, draws: usize, seed: u64) -> anyhow::Result<Vec<StatementRow>> {
        let seeds: Vec<u64> = (0..draws as u64)
            .map(|k| seed.wrapping_mul(1_000_003).wrapping_add(k))
            .collect();
        let label = |c| (c, "white", [draws, 0]);
        let counted = self.each(&seeds, |seed| -> anyhow::Result<Vec<Labelled>> {
            Ok(self.checked(*seed)?.into_iter().map(label).collect())
        })?;
        Ok(tallied(counted))
    }

    fn checked(&self, seed: u64) -> anyhow::Result<Vec<Counted>> {
        let folder = self.folder.join(format!("check-{seed}"));
        let designs = [Design::Rich, Design::Paper, Design::Repeats];
        let request = Request {
            seed,
            design: designs[seed as usize % 3],
            want: CaseKind::Null,
            target_sigma: 0.0,
            rivals: false,
        };
        let make = if seed.is_multiple_of(2) {
            Make::Thin
        } else {
            Make::Usual
        };
        let case = draw_under(&request, Noise::Gaussian, make)?;
        case.write(&folder)?;
        let out = folder.join("verified");
        let (verify, out_at) = ("verify".as_ref(), "--out".as_ref());
        self.run(&[verify, folder.as_ref(), out_at, out.as_ref()])?;
        let calibration = out.join("calibration.json");
        if !calibration.exists() {
            return Ok(Vec::new());
        }
        let look = |day: &Day, k: u64| {
            let session = folder.join(format!("later-{k}"));
            quick_look(&case, day, seed.wrapping_mul(977) ^ (k + 1))?.write(&session)?;
            self.answer(&session, &calibration)
        };
        let mut counted = Vec::new();
        let mut sds = Vec::new();
        for k in 0..UNCHANGED {
            let answer = look(&Day::unchanged(&case), k)?;
            let holds = answer["answer"] == "ok";
            counted.push(Counted::new("check, nothing changed: OK", 0.95, holds));
            sds = stated_sds(&answer);
        }
        let places = sds.iter().flat_map(|sd| SIZES.map(|size| (sd, size)));
        for (k, ((name, sd), size)) in (UNCHANGED..).zip(places) {
            let sign = if (seed ^ k).is_multiple_of(2) {
                1.0
            } else {
                -1.0
            };
            let Some(day) = changed(&case, name, size * sd, sign) else {
                continue;
            };
            let answer = look(&day, k)?;
            let said = said(&answer);
            let first = said.first().map_or(&[][..], |names| names);
            let among = first.contains(name);
            let alone = said.len() == 1 && first.len() == 1 && among;
            let mut add = |what: &str, holds| {
                let what = format!("check, {name} by {size} sd: {what}");
                counted.push(Counted::new(what, 0.9, holds).unsaid());
            };
            add("not OK", answer["answer"] != "ok");
            add("named, alone or in a class", among);
            add("named alone", alone);
            add("named otherwise", !first.is_empty() && !among);
        }
        Ok(counted)
    }

    fn answer(&self, session: &Path, calibration: &Path) -> anyhow::Result<Value> {
        let said = std::process::Command::new(&self.program)
            .arg("check")
            .arg(session)
            .arg("--calibration")
            .args([calibration.as_os_str(), "--json".as_ref()])
            .output()
            .with_context(|| format!("starting {}", self.program.display()))?;
        let errors = String::from_utf8_lossy(&said.stderr);
        serde_json::from_slice(&said.stdout)
            .with_context(|| format!("reading what check says of {}: {errors}", session.display()))
    }
}

fn list(of: &Value) -> impl Iterator<Item = &Value> {
    of.as_array().into_iter().flatten()
}

/// Standard deviations that a check states of its changes.
fn stated_sds(answer: &Value) -> Vec<(String, f64)> {
    let one = |t: &Value| Some((t["name"].as_str()?.to_owned(), t["sd"].as_f64()?));
    list(&answer["check"]["tested"]).filter_map(one).collect()
}

/// Each change that is named, with those that it could be as well.
fn said(answer: &Value) -> Vec<Vec<String>> {
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let one = |c: &Value| {
        std::iter::once(text(&c["name"]))
            .chain(list(&c["or"]).map(text))
            .collect()
    };
    list(&answer["check"]["changes"]).map(one).collect()
}

/// The whisker with a change; none where the plant has no such change.
fn changed(case: &Case, name: &str, size: f64, sign: f64) -> Option<Day> {
    let mut day = Day::unchanged(case);
    let by = sign * size;
    let (what, grating) = match name.split_once(" of grating ") {
        Some((what, grating)) => (what, grating.parse::<usize>().ok()? - 1),
        None => (name, 0),
    };
    let mut act = |kind, amplitude, shape: &[f64]| {
        day.effects.push(Effect {
            kind,
            amplitude,
            shape: shape.to_vec(),
        });
    };
    let along = Vector3::x();
    match what {
        "temperature coefficient" => {
            let shape = if grating == 0 { [1.0, 0.0] } else { [0.0, 1.0] };
            act(Kind::TemperatureLinear, by, &shape);
            // At the temperature of the calibration it reads what it did.
            let fitted = case.readings.iter().filter(|r| !r.planned.holdout);
            let rises: Vec<f64> = fitted
                .map(|r| case.bench.thermal.at(r.planned.t_s))
                .collect();
            day.bench.zero_pm[grating] -= by * rises.iter().sum::<f64>() / rises.len() as f64;
        }
        "groove-friction" => act(Kind::FrictionCoulomb, size, &[]),
        "stage-backlash" => act(Kind::BacklashApproach, size, &[]),
        "base-compliance" => act(Kind::ComplianceIsotropic, size, &[]),
        "zero" => day.bench.zero_pm[grating] += by,
        "gain" if name == what => day.bench.k = day.bench.k.map(|row| row.map(|v| v * (1.0 + by))),
        "gain" => day.bench.k[grating] = day.bench.k[grating].map(|v| v * (1.0 + by)),
        "groove turn" => {
            let turn = Rotation3::from_axis_angle(&Vector3::x_axis(), by.to_radians());
            for t in &mut day.groove {
                t.path.origin_mm = turn * t.path.origin_mm;
                t.path.direction = turn * t.path.direction;
            }
        }
        "stage zero" => {
            for t in &mut day.groove {
                t.path.origin_mm += t.path.direction * by;
            }
        }
        "groove along the wire" | "groove depth" | "groove sideways" => {
            let used = day.groove.iter().filter(|t| [1, 5, 9].contains(&t.id));
            let sum: Vector3<f64> = used.map(|t| t.path.direction).sum();
            let depth = (sum - along * along.dot(&sum)).normalize();
            let axis = match what {
                "groove along the wire" => along,
                "groove depth" => depth,
                _ => along.cross(&depth),
            };
            for t in &mut day.groove {
                t.path.origin_mm += axis * by;
            }
        }
        _ => return None,
    }
    Some(day)
}
