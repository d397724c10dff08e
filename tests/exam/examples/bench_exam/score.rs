//! What one answer is worth, and the table over all.

use crate::draw::{Act, Draw};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use wcal_exam::clopper_pearson;

/// What one answer is worth.
pub(crate) struct Score {
    kind: &'static str,
    right: bool,
    /// An effect with confidence that was not put in.
    wrong_name: bool,
    /// Anything named where nothing was put in.
    named: bool,
    covered: Vec<bool>,
    /// Stated over true floor, settled and in motion.
    floors: [Option<f64>; 2],
    /// One line for the reader.
    pub line: String,
}

type Names = BTreeSet<String>;

fn names(list: &Value) -> Names {
    list.as_array()
        .into_iter()
        .flatten()
        .filter_map(|s| Some(s.as_str()?.to_owned()))
        .collect()
}

/// Whether the stated intervals hold what was put in; none where the answer is another law of the
/// effect, with other parameters.
fn covers(effect: &Value, act: &Act) -> Option<Vec<bool>> {
    let inside = |(name, truth): (&str, f64)| {
        let own = effect["parameters"]
            .as_array()?
            .iter()
            .find(|p| p["name"] == name)?;
        let end = |k: usize| own["interval95"][k].as_f64();
        Some((end(0)?..=end(1)?).contains(&truth))
    };
    act.truths().into_iter().map(inside).collect()
}

/// Scores verify.json of a draw.
pub(crate) fn score(d: &Draw, v: &Value, seconds: f64) -> Score {
    let verdict = v["verdict"].as_str().unwrap_or("no verdict");
    let effects = v["effects"].as_array().cloned().unwrap_or_default();
    // Members of a class cannot be told apart on the session, which the answer says.
    let classes: Vec<Names> = effects
        .iter()
        .map(|e| {
            let mut class = names(&e["class"]);
            class.extend(e["id"].as_str().map(str::to_owned));
            class
        })
        .collect();
    let truth: Names = d.names().into_iter().map(str::to_owned).collect();
    let all_in =
        truth.iter().all(|t| classes.iter().any(|c| c.contains(t))) && classes.len() == truth.len();
    let in_set = v["alternatives"]
        .as_array()
        .into_iter()
        .flatten()
        .any(|a| names(a) == truth);
    let right = match d.kind() {
        "none" | "not shown by the plan" => verdict == "adequate",
        "outside the catalogue" => verdict == "unknown-effect",
        _ => (verdict == "effect" && all_in) || (verdict == "ambiguous" && in_set),
    };
    // What the plan does not show may still be named rightly.
    let put_in: Names = d.acts.iter().map(|a| a.effect.id.to_owned()).collect();
    let wrong_name = verdict == "effect" && classes.iter().any(|c| c.is_disjoint(&put_in));
    let may_be = v["alternatives"]
        .as_array()
        .into_iter()
        .flatten()
        .any(|a| names(a) == put_in);
    let right = right
        || (d.kind() == "not shown by the plan"
            && ((verdict == "effect" && !wrong_name) || (verdict == "ambiguous" && may_be)));
    let named = |a: &Act| {
        effects
            .iter()
            .find(|e| e["id"] == a.effect.id)
            .filter(|_| verdict == "effect")
    };
    let covered: Vec<bool> = d
        .acts
        .iter()
        .filter_map(|a| covers(named(a)?, a))
        .flatten()
        .collect();
    let missed = covered.iter().filter(|c| !**c).count();
    // A compensated shift has the noise of two gratings: settled rows average one second, rows in
    // motion 20 ms.
    let truth_pm = |samples: f64| (2.0 / samples).sqrt();
    let floor = |key: &str, samples: f64| Some(v["noise_floor"][key].as_f64()? / truth_pm(samples));
    let floors = [
        floor("wavelength_pm", d.rate_hz),
        floor("moving_wavelength_pm", (0.02 * d.rate_hz).max(2.0)),
    ];
    let ids: Vec<&str> = effects.iter().filter_map(|e| e["id"].as_str()).collect();
    Score {
        kind: d.kind(),
        right,
        wrong_name,
        named: !effects.is_empty() || verdict == "ambiguous",
        line: format!(
            "{:3} seed {} {}{} {:4.0} Hz | {} | {verdict}: {} | floors {} | {}{} | {seconds:.0} s",
            d.k,
            d.seed,
            d.plan,
            if d.pictures { " + pictures" } else { "" },
            d.rate_hz,
            d.words(),
            ids.join(", "),
            floors
                .iter()
                .flatten()
                .map(|f| format!("{f:.2}"))
                .collect::<Vec<_>>()
                .join(" "),
            if right { "right" } else { "NOT RIGHT" },
            if missed > 0 {
                format!(", {missed} intervals miss")
            } else {
                String::new()
            },
        ),
        covered,
        floors,
    }
}

/// Farthest ratio of a stated floor to the true one.
const NEAR: f64 = 1.3;

/// Prints the table: shares with exact 95 % bounds (Clopper-Pearson). A goal is met where the share
/// reaches it, shown where its bound does.
pub(crate) fn table(scores: &[Score]) -> Vec<Value> {
    let mut rows = Vec::new();
    let mut row = |name: &str, goal: Option<(bool, f64)>, hits: usize, of: usize| {
        let (low, high) = if of > 0 {
            clopper_pearson(hits, of)
        } else {
            (0.0, 1.0)
        };
        let share = hits as f64 / of.max(1) as f64;
        let (text, word) = match goal {
            None => (String::new(), ""),
            Some((at_least, g)) => {
                let reaches = |low: f64, high: f64| if at_least { low >= g } else { high <= g };
                let word = if reaches(low, high) {
                    "shown"
                } else if reaches(share, share) {
                    "met"
                } else {
                    "MISSED"
                };
                (format!("{} {g}", if at_least { ">=" } else { "<=" }), word)
            }
        };
        println!("{name:<46} {text:<8} {hits:3} of {of:3}  [{low:.2}, {high:.2}]  {word}");
        rows.push(json!({ "score": name, "goal": text, "hits": hits, "of": of, "bounds95": [low, high], "word": word }));
    };
    let count = |of: &dyn Fn(&Score) -> bool, hit: &dyn Fn(&Score) -> bool| {
        let part: Vec<&Score> = scores.iter().filter(|s| of(s)).collect();
        (part.iter().filter(|s| hit(s)).count(), part.len())
    };
    let (hits, of) = count(&|_| true, &|s| s.right);
    row("right", Some((true, 0.93)), hits, of);
    for kind in [
        "none",
        "single",
        "pair",
        "not shown by the plan",
        "outside the catalogue",
    ] {
        let (hits, of) = count(&|s| s.kind == kind, &|s| s.right);
        row(&format!("  of these: {kind}"), None, hits, of);
    }
    let (hits, of) = count(&|s| s.kind != "outside the catalogue", &|s| s.wrong_name);
    row(
        "a wrong or additional name, with confidence",
        Some((false, 0.02)),
        hits,
        of,
    );
    let (hits, of) = count(&|s| s.kind == "outside the catalogue", &|s| s.wrong_name);
    row("a name for what is outside the catalogue", None, hits, of);
    let (hits, of) = count(&|s| s.kind == "none", &|s| s.named);
    row("none: named", Some((false, 0.02)), hits, of);
    let inside: Vec<bool> = scores
        .iter()
        .flat_map(|s| s.covered.iter().copied())
        .collect();
    row(
        "95 % intervals that hold the truth",
        Some((true, 0.92)),
        inside.iter().filter(|i| **i).count(),
        inside.len(),
    );
    for (k, name) in ["floor within 1.3, settled", "floor within 1.3, in motion"]
        .into_iter()
        .enumerate()
    {
        let right = scores
            .iter()
            .filter(|s| s.right && s.kind != "outside the catalogue");
        let floors: Vec<f64> = right.filter_map(|s| s.floors[k]).collect();
        let near = floors
            .iter()
            .filter(|f| (1.0 / NEAR..=NEAR).contains(*f))
            .count();
        row(name, Some((true, 0.93)), near, floors.len());
    }
    rows
}
