//! One answer against one truth, in the notions of the practice scorer.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::Value;

use crate::orders::Drawn;
use wcal_plant::case::{Case, Flag, Make, Truth};
use wcal_plant::noise::Noise;
use wcal_plant::scalar::ScalarCase;

/// How an answer counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
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
    #[default]
    Crash,
}

/// A scored session.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Outcome {
    /// Name of the case.
    pub name: String,
    /// `null`, the effect, `pair`, `unknown` or `adversarial`.
    pub label: String,
    /// Laws put in.
    pub laws: Vec<String>,
    /// Layout, for a whisker.
    pub design: Option<wcal_plant::Design>,
    /// Kind of noise.
    pub noise: String,
    /// Make of the wire.
    pub wire: Option<Make>,
    /// Size in noises.
    pub delta: f64,
    /// Smallest size of the effects alone.
    pub delta_each: f64,
    /// Distance in noises to the nearest rival of a single effect, where it was computed.
    pub rival_sigma: Option<f64>,
    /// Explanations that the data allow: the effect and its rivals within three noises, where they
    /// were computed.
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
    /// What the answer states of the noise's parts.
    pub parts: Vec<Part>,
    /// Stated floor over the true noise of a loaded reading at a new pose; none where the answer
    /// says it is not known.
    pub floor_ratio: Option<f64>,
    /// The readings said to be off are those that are (whiskers, unless slips were put in).
    pub flags_right: Option<bool>,
    /// Driver named right (effects outside the catalogue).
    pub driver_right: Option<bool>,
    /// Held-out moment error over the noise floor, before and after.
    pub before_ratio: Option<f64>,
    /// See `before_ratio`.
    pub after_ratio: Option<f64>,
    /// The session's cameras look on (else they would have); none where nobody asked.
    pub pictures: Option<bool>,
    /// Each effect is clear in the wavelengths or in the contacts (see [`Truth::clear`]).
    pub clear: Option<bool>,
    /// Contact error over what the shapes state, before and after.
    pub contact_before_ratio: Option<f64>,
    /// See `contact_before_ratio`.
    pub contact_after_ratio: Option<f64>,
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

/// A part of the noise as put in and as stated.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Part {
    /// Name within `noise` of verify.json.
    pub name: String,
    /// Put in.
    pub truth: f64,
    /// Stated.
    pub value: Option<f64>,
    /// The truth lies inside the stated 95 % interval.
    pub inside: Option<bool>,
}

impl Part {
    /// Stated within a factor of the truth.
    pub fn within(&self, factor: f64) -> bool {
        self.value
            .is_some_and(|v| v <= factor * self.truth && v * factor >= self.truth)
    }
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
    v.as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .map(str::to_owned)
        .collect()
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
    let mut want: BTreeSet<String> = t.names.iter().cloned().collect();
    let effects = verify["effects"].as_array().cloned().unwrap_or_default();
    let got: Vec<String> = effects
        .iter()
        .filter_map(|e| e["id"].as_str())
        .map(str::to_owned)
        .collect();
    let classes: Vec<BTreeSet<String>> = effects
        .iter()
        .zip(&got)
        .map(|(e, id)| {
            let mut class = strings(&e["class"]);
            class.insert(id.clone());
            class
        })
        .collect();
    let alternatives: Vec<BTreeSet<String>> = verify["alternatives"]
        .as_array()
        .into_iter()
        .flatten()
        .map(strings)
        .collect();
    let verdict = verify["verdict"].as_str().unwrap_or("none").to_owned();
    let said = flags(verify);
    let true_flags: BTreeSet<Flag> = t.flagged.iter().cloned().collect();
    // Gross readings may be named as the effect that they are, or only be marked.
    if !true_flags.is_empty() && got.iter().any(|g| g == OUTLIERS) {
        want.insert(OUTLIERS.into());
    }

    let named = want.iter().all(|w| classes.iter().any(|c| c.contains(w)));
    let top = named && classes.len() == want.len();
    let part = want.iter().any(|w| classes.iter().any(|c| c.contains(w)));
    let in_set = top
        || alternatives.iter().any(|a| want.is_subset(a))
        || (want.len() == 1 && alternatives.iter().any(|a| !want.is_disjoint(a)));
    let kind = match t.label.as_str() {
        "adversarial" => {
            let said = if verdict == "effect" {
                format!("effect:{}", got.join(","))
            } else {
                verdict.clone()
            };
            if t.expected.contains(&said) {
                Kind::Right
            } else {
                Kind::Wrong
            }
        }
        "null" => match verdict.as_str() {
            "adequate" if !true_flags.is_empty() && said.is_empty() => Kind::Missed,
            "adequate" => Kind::Right,
            "effect" if top && !want.is_empty() => Kind::Right,
            _ => Kind::False,
        },
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
    let slips = t.names.iter().any(|n| n == OUTLIERS) || t.label == "adversarial";
    Outcome {
        name: name.to_owned(),
        parts: parts(t, verify),
        floor_ratio: verify["noise_floor"]["wavelength_pm"]
            .as_f64()
            .map(|f| f / t.new_pose_noise_pm),
        // A refused session flags nothing, which says something only where a reading is off.
        flags_right: (!slips && (verdict != "refused" || !true_flags.is_empty()))
            .then(|| said == true_flags),
        driver_right: (t.label == "unknown").then(|| driver_right(t, verify)),
        before_ratio: held.as_ref().map(|h| h.before / floor),
        after_ratio: held.as_ref().map(|h| h.after / floor),
        covered: held.map(|h| (h.covered, h.values)),
        contact_before_ratio: contact_ratio(verify, "before"),
        contact_after_ratio: contact_ratio(verify, "after"),
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

/// Scores the answer on a scalar session.
pub fn score_scalar(
    name: &str,
    case: &ScalarCase,
    verify: &Value,
    predictions: &str,
    seconds: f64,
    code: Option<i32>,
) -> Outcome {
    let t = &case.truth;
    let effects = verify["effects"].as_array().cloned().unwrap_or_default();
    let got: Vec<String> = effects
        .iter()
        .filter_map(|e| e["id"].as_str())
        .map(str::to_owned)
        .collect();
    let alternatives: Vec<BTreeSet<String>> = verify["alternatives"]
        .as_array()
        .into_iter()
        .flatten()
        .map(strings)
        .collect();
    let verdict = verify["verdict"].as_str().unwrap_or("none").to_owned();
    let names_truth = |e: &Value, id: &String| {
        t.names.contains(id) || t.names.iter().any(|n| strings(&e["class"]).contains(n))
    };
    let right = effects
        .iter()
        .zip(&got)
        .filter(|(e, id)| names_truth(e, id))
        .count();
    let in_set = right > 0
        || alternatives
            .iter()
            .any(|a| t.names.iter().any(|n| a.contains(n)));
    let kind = match (t.label.as_str(), verdict.as_str()) {
        ("null", "adequate") => Kind::Right,
        ("null", _) => Kind::False,
        (_, "effect") if right == 1 && got.len() == 1 => Kind::Right,
        (_, "effect") if right > 0 => Kind::Part,
        (_, "effect") => Kind::Wrong,
        (_, "ambiguous") if in_set => Kind::AmbiguousIn,
        (_, "ambiguous") => Kind::Wrong,
        (_, "adequate") => Kind::Missed,
        (_, "unknown-effect") => Kind::Unknown,
        _ => Kind::Refused,
    };
    let key = if case.axis { "error_um" } else { "response" };
    let correlated = |field: &str| part(&verify["noise"]["correlated"][field]);
    let rho_s = -READING_S / t.rho.ln();
    Outcome {
        covered: scalar_cover(case, predictions, key),
        after_ratio: verify["after"][if case.axis {
            "error_rmse_um"
        } else {
            "response_rmse"
        }]
        .as_f64()
        .map(|v| v / t.noise_sd),
        floor_ratio: verify["noise_floor"][key].as_f64().map(|v| v / t.noise_sd),
        parts: if t.rho > 0.0 {
            vec![
                compared("correlated.sd", t.noise_sd, correlated("sd")),
                compared(
                    "correlated.time_constant_s",
                    rho_s,
                    correlated("time_constant_s"),
                ),
            ]
        } else {
            Vec::new()
        },
        extra: got.len() - right,
        set_size: alternatives.len().max(usize::from(verdict == "effect")),
        in_set,
        kind,
        verdict,
        got,
        seconds,
        code,
        ..blank_scalar(name, case)
    }
}

/// Held-out readings inside 1.96 of the stated standard deviations.
fn scalar_cover(case: &ScalarCase, predictions: &str, key: &str) -> Option<(usize, usize)> {
    let mut reader = csv::Reader::from_reader(predictions.as_bytes());
    let header = reader.headers().ok()?.clone();
    let column = |name: &str| header.iter().position(|h| h == name);
    let (source, point) = (column("source")?, column("point")?);
    let (after, sd) = (
        column(&format!("{key}_after"))?,
        column(&format!("{key}_sd"))?,
    );
    let held_out: BTreeMap<usize, f64> = case
        .readings
        .iter()
        .filter(|r| r.holdout)
        .map(|r| (r.point, r.y))
        .collect();
    let (mut inside, mut values) = (0, 0);
    for record in reader
        .records()
        .flatten()
        .filter(|r| r.get(source) == Some("holdout.csv"))
    {
        let number = |k: usize| record.get(k).and_then(|v| v.parse::<f64>().ok());
        let y = held_out.get(&record.get(point)?.parse::<usize>().ok()?)?;
        inside += usize::from((y - number(after)?).abs() <= 1.96 * number(sd)?);
        values += 1;
    }
    (values > 0).then_some((inside, values))
}

/// An outcome for a program that left no result.
pub(crate) fn crash(
    name: &str,
    case: &Drawn,
    why: String,
    seconds: f64,
    code: Option<i32>,
) -> Outcome {
    let blank = match case {
        Drawn::Whisker(case) => blank(name, case),
        Drawn::Scalar(case) => blank_scalar(name, case),
    };
    Outcome {
        why,
        seconds,
        code,
        ..blank
    }
}

/// Effect whose name gross readings may bear.
const OUTLIERS: &str = "slip-outliers";
/// Seconds from reading to reading of a drawn line.
const READING_S: f64 = wcal_plant::scalar::READING_S;

/// Readings that the answer says are off: the list, or the note where there is no list.
fn flags(verify: &Value) -> BTreeSet<Flag> {
    if let Some(list) = verify["flagged"].as_array() {
        return list
            .iter()
            .filter_map(|f| {
                let point = usize::try_from(f["point"].as_u64()?).ok()?;
                Some(Flag {
                    source: f["source"].as_str()?.to_owned(),
                    point,
                })
            })
            .collect();
    }
    let notes = verify["notes"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_str);
    notes
        .filter_map(|n| {
            n.strip_prefix("Readings marked")?
                .split_once("points ")
                .map(|p| p.1)
        })
        .flat_map(|p| p.trim_end_matches('.').split(", "))
        .filter_map(|p| {
            Some(Flag {
                source: "points.csv".into(),
                point: p.parse().ok()?,
            })
        })
        .collect()
}

/// A part of `noise`: an object of a value and its interval, or a bare number.
fn part(v: &Value) -> Option<(f64, Option<[f64; 2]>)> {
    let value = v.as_f64().or_else(|| v["value"].as_f64())?;
    let ends: Vec<f64> = v["interval95"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(Value::as_f64)
        .collect();
    Some((value, <[f64; 2]>::try_from(ends).ok()))
}

fn compared(name: &str, truth: f64, said: Option<(f64, Option<[f64; 2]>)>) -> Part {
    let inside = said
        .and_then(|s| s.1)
        .map(|[low, high]| (low..=high).contains(&truth));
    Part {
        name: name.into(),
        truth,
        value: said.map(|s| s.0),
        inside,
    }
}

/// Parts that were put in beside what the answer says of them. All are standard deviations,
/// rounding too.
fn parts(t: &Truth, verify: &Value) -> Vec<Part> {
    let said = &verify["noise"];
    let n = &t.noise;
    let mut out = Vec::new();
    // What a repeat is where noise depends on the load or on depth is a matter of which reading.
    if !matches!(n.kind, Noise::Loaded | Noise::Depth) && n.rounding.is_none() {
        out.push(compared("repeat", t.repeat_noise_pm, part(&said["repeat"])));
    }
    if n.pose_pm > 0.0 {
        out.push(compared("pose", n.pose_pm, part(&said["pose"])));
    }
    if let Some(d) = n.drift {
        let c = &said["correlated"];
        out.push(compared("correlated.sd", d.sd_pm, part(&c["sd"])));
        out.push(compared(
            "correlated.time_constant_s",
            d.time_constant_s,
            part(&c["time_constant_s"]),
        ));
    }
    if let Some(r) = n.rounding {
        out.push(compared(
            "rounding",
            r.step_pm / 12f64.sqrt(),
            part(&said["rounding"]),
        ));
    }
    if let Some(dof) = n.tails_dof {
        out.push(compared("tails_dof", dof, part(&said["tails_dof"])));
    }
    out
}

fn blank_scalar(name: &str, case: &ScalarCase) -> Outcome {
    let t = &case.truth;
    Outcome {
        name: name.to_owned(),
        label: t.label.clone(),
        laws: t.names.clone(),
        noise: t.noise.name().into(),
        delta: t.projected_size_in_noises,
        delta_each: t.projected_size_in_noises,
        oracle_ratio: f64::NAN,
        verdict: "none".into(),
        ..Outcome::default()
    }
}

fn blank(name: &str, case: &Case) -> Outcome {
    let t = &case.truth;
    Outcome {
        name: name.to_owned(),
        label: t.label.clone(),
        laws: t
            .laws
            .iter()
            .map(|(id, law)| format!("{id}/{}", law.as_str().unwrap_or("")))
            .collect(),
        design: Some(t.design),
        noise: t.noise.kind.name().into(),
        wire: Some(t.wire),
        pictures: case.looked.map(|l| l.pictures),
        clear: t.clear,
        delta: t.projected_size_in_noises,
        delta_each: t
            .sizes_each
            .values()
            .filter_map(Value::as_f64)
            .fold(f64::INFINITY, f64::min)
            .min(1e9),
        rival_sigma: t.nearest_rival.as_ref().map(|r| r.sigma),
        allowed: t.nearest_rival.as_ref().map(|r| 1 + r.within_three),
        oracle_ratio: t.oracle_after_nmm / floor_nmm(t),
        verdict: "none".into(),
        ..Outcome::default()
    }
}

/// Moment noise floor in N mm: noise of a loaded reading at a new pose over the geometric mean of
/// K's singular values.
fn floor_nmm(t: &Truth) -> f64 {
    let det = t.k[0][0] * t.k[1][1] - t.k[0][1] * t.k[1][0];
    t.new_pose_noise_pm / det.abs().sqrt()
}

/// Contact error of a model over what the shapes state; none without pictures.
fn contact_ratio(verify: &Value, model: &str) -> Option<f64> {
    Some(
        verify[model]["contact_rmse_mm"].as_f64()?
            / verify["noise_floor"]["contact_mm"].as_f64()?,
    )
}

fn driver_right(t: &Truth, verify: &Value) -> bool {
    let said = verify["unknown"]["driver"].as_str().unwrap_or("");
    t.driver.iter().any(|d| d == said)
}

/// Held-out moment errors against the true moments, over the loaded rows; none where the table
/// lacks a row.
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
    let mut rows = BTreeMap::new();
    for record in reader.records() {
        let record = record.ok()?;
        let file = source.and_then(|s| record.get(s)).unwrap_or("holdout.csv");
        if file == "holdout.csv" && record.get(role) == Some("holdout") {
            let values: Option<Vec<f64>> = numbers
                .iter()
                .map(|&n| record.get(n).and_then(|v| v.parse().ok()))
                .collect();
            rows.insert(record.get(point)?.parse::<usize>().ok()?, values);
        }
    }
    let (mut before, mut after, mut covered, mut values) = (0.0, 0.0, 0, 0);
    let holdout = case.readings.iter().filter(|r| r.planned.holdout);
    for (reading, m) in holdout.zip(&case.truth.holdout_moments_nmm) {
        let off = case
            .truth
            .flagged
            .iter()
            .any(|f| f.source == "holdout.csv" && f.point == reading.point);
        if reading.planned.role != "holdout" || m[0].is_nan() || off {
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
    Some(HeldOut {
        before: rms(before),
        after: rms(after),
        covered,
        values,
    })
}
