//! One answer against one truth, in the notions of the practice scorer.

use std::collections::BTreeSet;

use serde::Serialize;
use serde_json::Value;

use crate::session::{Case, Truth};

/// How an answer counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The right thing was said.
    Right,
    /// Some of the right effects, or with a wrong one beside them.
    Part,
    /// A confident wrong name.
    Wrong,
    /// Ambiguous, with the truth among the alternatives.
    AmbiguousIn,
    /// "Adequate" although an effect was there.
    Missed,
    /// "Unknown effect" although the catalogue has it.
    Unknown,
    /// Something named where nothing was.
    False,
    /// "Refused" or "twin fault" without cause.
    Refused,
    /// No result document.
    Crash,
}

/// A scored session.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// Name of the case.
    pub name: String,
    /// `null`, the effect, `pair`, `unknown` or `adversarial`.
    pub label: String,
    /// Laws put in.
    pub laws: Vec<String>,
    /// `rich` or `paper`.
    pub design: crate::Design,
    /// Size in noises.
    pub delta: f64,
    /// Smallest size of the effects alone.
    pub delta_each: f64,
    /// Distance in noises to the nearest rival of a single effect, where it was computed.
    pub rival_sigma: Option<f64>,
    /// Explanations that the data allow: the effect and its rivals within three noises, where they were computed.
    pub allowed: Option<usize>,
    /// Verdict as written.
    pub verdict: String,
    /// Effects named.
    pub got: Vec<String>,
    /// Mark.
    pub kind: Kind,
    /// Number of alternatives listed.
    pub set_size: usize,
    /// True explanation among the alternatives (or named).
    pub in_set: bool,
    /// Effects named that were not put in, even as class members.
    pub extra: usize,
    /// Driver named right (effects outside the catalogue).
    pub driver_right: Option<bool>,
    /// Held-out moment error over the noise floor, before and after.
    pub before_ratio: Option<f64>,
    /// See `before_ratio`.
    pub after_ratio: Option<f64>,
    /// The same of an oracle that knows the effect exactly and fits K and the zero.
    pub oracle_ratio: f64,
    /// Values inside the stated 95 % interval, and values.
    pub covered: Option<(usize, usize)>,
    /// What the measurement that an ambiguous answer asked for brought, where it was made.
    pub follow_up: Option<FollowUp>,
    /// Seconds.
    pub seconds: f64,
    /// Exit code.
    pub code: Option<i32>,
    /// What went wrong, if anything.
    pub why: String,
}

/// The answer after the measurement that an ambiguous one asked for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FollowUp {
    /// Power that the first answer stated.
    pub expected_power: f64,
    /// Poses that it asked for.
    pub poses: usize,
    /// The second answer names the right effects and nothing else.
    pub resolved: bool,
    /// Its mark.
    pub kind: Kind,
    /// Its verdict.
    pub verdict: String,
    /// Effects it names.
    pub got: Vec<String>,
    /// What went wrong, if anything.
    pub why: String,
}

/// Held-out errors read from predictions.csv.
struct HeldOut {
    before: f64,
    after: f64,
    covered: usize,
    values: usize,
}

fn strings(v: &Value) -> BTreeSet<String> {
    v.as_array().into_iter().flatten().filter_map(Value::as_str).map(str::to_owned).collect()
}

/// Scores `verify.json` and `predictions.csv` (texts) of a case.
pub fn score(
    name: &str,
    case: &Case,
    verify: &Value,
    predictions: &str,
    seconds: f64,
    code: Option<i32>,
) -> Outcome {
    let t = &case.truth;
    let want: BTreeSet<String> = t.names.iter().cloned().collect();
    let effects = verify["effects"].as_array().cloned().unwrap_or_default();
    let got: Vec<String> = effects.iter().filter_map(|e| e["id"].as_str()).map(str::to_owned).collect();
    let classes: Vec<BTreeSet<String>> = effects
        .iter()
        .zip(&got)
        .map(|(e, id)| {
            let mut class = strings(&e["class"]);
            class.insert(id.clone());
            class
        })
        .collect();
    let alternatives: Vec<BTreeSet<String>> =
        verify["alternatives"].as_array().into_iter().flatten().map(strings).collect();
    let verdict = verify["verdict"].as_str().unwrap_or("none").to_owned();

    let named = want.iter().all(|w| classes.iter().any(|c| c.contains(w)));
    let top = named && classes.len() == want.len();
    let part = want.iter().any(|w| classes.iter().any(|c| c.contains(w)));
    let in_set = top
        || alternatives.iter().any(|a| want.is_subset(a))
        || (want.len() == 1 && alternatives.iter().any(|a| !want.is_disjoint(a)));
    let kind = match t.label.as_str() {
        "adversarial" => {
            let said =
                if verdict == "effect" { format!("effect:{}", got.join(",")) } else { verdict.clone() };
            if t.expected.contains(&said) { Kind::Right } else { Kind::Wrong }
        }
        "null" => {
            if verdict == "adequate" {
                Kind::Right
            } else {
                Kind::False
            }
        }
        "unknown" => match verdict.as_str() {
            "unknown-effect" => Kind::Right,
            "adequate" => Kind::Missed,
            "effect" | "ambiguous" => Kind::Wrong,
            _ => Kind::Refused,
        },
        _ => match verdict.as_str() {
            "effect" if top => Kind::Right,
            "effect" if part => Kind::Part,
            "effect" => Kind::Wrong,
            "ambiguous" if in_set => Kind::AmbiguousIn,
            "ambiguous" => Kind::Wrong,
            "adequate" => Kind::Missed,
            "unknown-effect" => Kind::Unknown,
            _ => Kind::Refused,
        },
    };
    let held = held_out(case, predictions);
    let floor = floor_nmm(t);
    Outcome {
        name: name.to_owned(),
        driver_right: (t.label == "unknown").then(|| driver_right(t, verify)),
        before_ratio: held.as_ref().map(|h| h.before / floor),
        after_ratio: held.as_ref().map(|h| h.after / floor),
        covered: held.map(|h| (h.covered, h.values)),
        extra: classes.iter().filter(|c| c.is_disjoint(&want)).count(),
        set_size: alternatives.len().max(usize::from(verdict == "effect")),
        in_set,
        kind,
        verdict,
        got,
        seconds,
        code,
        ..blank(name, case)
    }
}

/// An outcome for a program that left no result.
pub fn crash(name: &str, case: &Case, why: String, seconds: f64, code: Option<i32>) -> Outcome {
    Outcome { why, seconds, code, ..blank(name, case) }
}

fn blank(name: &str, case: &Case) -> Outcome {
    let t = &case.truth;
    Outcome {
        name: name.to_owned(),
        label: t.label.clone(),
        laws: t.laws.iter().map(|(id, law)| format!("{id}/{}", law.as_str().unwrap_or(""))).collect(),
        design: t.design,
        delta: t.projected_size_in_noises,
        delta_each: t.sizes_each.values().filter_map(Value::as_f64).fold(f64::INFINITY, f64::min).min(1e9),
        rival_sigma: t.nearest_rival.as_ref().map(|r| r.sigma),
        allowed: t.nearest_rival.as_ref().map(|r| 1 + r.within_three),
        verdict: "none".into(),
        got: Vec::new(),
        kind: Kind::Crash,
        set_size: 0,
        in_set: false,
        extra: 0,
        driver_right: None,
        before_ratio: None,
        after_ratio: None,
        oracle_ratio: t.oracle_after_nmm / floor_nmm(t),
        covered: None,
        follow_up: None,
        seconds: 0.0,
        code: None,
        why: String::new(),
    }
}

/// Moment noise floor in N mm: noise over the geometric mean of K's singular values.
fn floor_nmm(t: &Truth) -> f64 {
    let det = t.k[0][0] * t.k[1][1] - t.k[0][1] * t.k[1][0];
    t.noise_pm / det.abs().sqrt()
}

fn driver_right(t: &Truth, verify: &Value) -> bool {
    let said = verify["unknown"]["driver"].as_str().unwrap_or("");
    t.driver.iter().any(|d| d == said)
}

/// Held-out moment errors against the true moments, over the loaded rows; none where the table lacks a row.
fn held_out(case: &Case, predictions: &str) -> Option<HeldOut> {
    let mut reader = csv::Reader::from_reader(predictions.as_bytes());
    let header = reader.headers().ok()?.clone();
    let column = |name: &str| header.iter().position(|h| h == name);
    let (source, point, role) = (column("source"), column("point")?, column("role")?);
    let numbers: Vec<usize> = [
        "moment_1_nmm_before",
        "moment_2_nmm_before",
        "moment_1_nmm_after",
        "moment_2_nmm_after",
        "moment_1_sd_nmm",
        "moment_2_sd_nmm",
    ]
    .iter()
    .map(|n| column(n))
    .collect::<Option<_>>()?;
    let mut rows = std::collections::BTreeMap::new();
    for record in reader.records() {
        let record = record.ok()?;
        let file = source.and_then(|s| record.get(s)).unwrap_or("holdout.csv");
        if file == "holdout.csv" && record.get(role) == Some("holdout") {
            let values: Option<Vec<f64>> =
                numbers.iter().map(|&n| record.get(n).and_then(|v| v.parse().ok())).collect();
            rows.insert(record.get(point)?.parse::<usize>().ok()?, values);
        }
    }
    let (mut before, mut after, mut covered, mut values) = (0.0, 0.0, 0, 0);
    let holdout = case.readings.iter().filter(|r| r.planned.holdout);
    for (reading, m) in holdout.zip(&case.truth.holdout_moments_nmm) {
        if reading.planned.role != "holdout" || m[0].is_nan() {
            continue;
        }
        let v = rows.get(&reading.point)?.as_ref()?;
        for c in 0..2 {
            before += (v[c] - m[c]).powi(2);
            after += (v[2 + c] - m[c]).powi(2);
            covered += usize::from((v[2 + c] - m[c]).abs() <= 1.96 * v[4 + c]);
            values += 1;
        }
    }
    if values == 0 {
        return None;
    }
    let rms = |s: f64| (s / values as f64).sqrt();
    Some(HeldOut { before: rms(before), after: rms(after), covered, values })
}
