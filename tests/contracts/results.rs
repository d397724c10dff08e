//! README's table of results, row by row from the commands that make it, which are run here.
//!
//! `make results` writes the table
//! (`WCAL_WRITE_DOCS=1 cargo test --workspace --test contracts results::`); without it the test
//! compares.

use crate::support::{program, repository};
use serde_json::Value;
use std::fs;
use std::path::Path;

const BEGIN: &str = "<!-- results: written by `make results` -->\n";
const END: &str = "<!-- end of results -->\n";

fn read(name: &str) -> String {
    fs::read_to_string(repository(name)).unwrap_or_else(|e| unreachable!("{name}: {e}"))
}

/// A row: what, on which data, before, after, verdict.
type Row = [String; 5];

/// `wcal verify` on a session, beside a sweep where there is one: its document.
fn verified(session: &Path, sweep: Option<&Path>) -> Value {
    let out = tempfile::tempdir().unwrap();
    let place = out.path().join("out");
    let mut command = program();
    command.arg("verify").arg(session).arg("--out").arg(&place);
    sweep.map(|sweep| command.arg("--sweep").arg(sweep));
    let said = String::from_utf8_lossy(&command.output().unwrap().stderr).into_owned();
    let document = fs::read(place.join("verify.json"));
    serde_json::from_slice(&document.unwrap_or_else(|e| unreachable!("{e}: {said}"))).unwrap()
}

fn fixture(name: &str) -> Value {
    verified(&repository("fixtures").join(name), None)
}

/// Held-out error of the answer on one side.
fn rmse(document: &Value, side: &str) -> f64 {
    let rmse = &document[side];
    rmse["response_rmse"]
        .as_f64()
        .or_else(|| rmse["wavelength_rmse_pm"].as_f64())
        .unwrap()
}

fn verdict(document: &Value) -> String {
    let effects: Vec<String> = document["effects"]
        .as_array()
        .unwrap()
        .iter()
        .map(|e| format!("`{}`", e["id"].as_str().unwrap()))
        .collect();
    let word = document["verdict"].as_str().unwrap();
    match (word, effects.is_empty()) {
        ("ambiguous", _) => {
            format!(
                "ambiguous between {} explanations",
                document["alternatives"].as_array().unwrap().len()
            )
        }
        (_, true) => word.to_owned(),
        ("effect", false) => format!("effect: {}", effects.join(", ")),
        (_, false) => format!("{word}, after {}", effects.join(", ")),
    }
}

/// Readings that were left out in turn.
fn left_out(document: &Value) -> u64 {
    document["after"]["points"].as_u64().unwrap()
}

fn load_cell(v: &Value) -> Row {
    let floor = v["noise_floor"]["response"].as_f64().unwrap();
    let [before, after] = ["before", "after"].map(|side| rmse(v, side));
    [
        "load cell (NIST Pontius), declared as a straight line: error of readings left out in turn"
            .to_owned(),
        format!("measured, one cell, {} readings", left_out(v)),
        format!("{before:.1e}"),
        format!("{after:.1e}, the noise floor is {floor:.1e}"),
        verdict(v),
    ]
}

fn actuator() -> Row {
    let v = fixture("pneumatic/pk-7bar");
    let [before, after] = ["before", "after"].map(|side| rmse(&v, side));
    [
        "strokes of a pneumatic actuator, declared as a straight line: error of readings left out in turn"
            .to_owned(),
        format!("measured, one actuator at 7 bar, {} readings", left_out(&v)),
        format!("{before:.1} N"),
        format!("{after:.2} N"),
        verdict(&v),
    ]
}

/// Error of the declared model where our rod takes the place of the released labels: one of the
/// answer's notes.
fn declared_by_our_rod(document: &Value) -> f64 {
    const SAYS: &str = "declared model, labels repaired by the rod: ";
    let mut notes = document["notes"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(Value::as_str);
    let said = notes.find_map(|n| Some(n.split_once(SAYS)?.1)).unwrap();
    said.split(' ').next().unwrap().parse().unwrap()
}

fn whisker() -> Row {
    let v = fixture("whiskerfbg");
    let [session, sweep] = ["fixtures/whiskerfbg", "fixtures/whiskerfbg_bottle"].map(repository);
    let swept = verified(&session, Some(&sweep));
    let tests = swept["tests"].as_array().unwrap();
    let refuted = tests.iter().filter(|e| e["refuted"] == true).count();
    let faults = v["twin"]["faults"].as_array().unwrap();
    let branch = faults.iter().find(|f| f["kind"] == "branch").unwrap();
    let faulty = branch["points"].as_array().unwrap().len();
    [
        "whisker of the paper: wavelengths of trajectories left out in turn".to_owned(),
        format!(
            "measured, one whisker, {} poses, no replicates",
            left_out(&v)
        ),
        format!(
            "{:.1} pm by the released labels, {faulty} of them on another branch; {:.1} pm by the declared model with our rod",
            rmse(&v, "before"),
            declared_by_our_rod(&v)
        ),
        format!(
            "{:.1} pm by the best of them; {:.1} pm by what its measured sweep over a bottle leaves",
            rmse(&v, "after"),
            rmse(&swept, "after")
        ),
        format!(
            "{}; the sweep refutes {refuted} of them, {} remains",
            verdict(&v),
            verdict(&swept)
        ),
    ]
}

fn table(rows: &[Row]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | ")).replace("|  |", "| |");
    let head = ["what", "scope", "before", "after", "verdict"].map(str::to_owned);
    let mut out = line(&head) + "|---|---|---|---|---|\n";
    rows.iter().for_each(|row| out += &line(row));
    out
}

fn between(page: &str) -> Option<&str> {
    page.split_once(BEGIN)?.1.split_once(END).map(|s| s.0)
}

#[test]
fn the_table_of_results_is_what_its_script_writes() {
    let mut pontius = fixture("nist/pontius");
    let rows = [load_cell(&pontius), actuator(), whisker()];
    let found = table(&rows);
    let readme = read("README.md");
    let stands = between(&readme).unwrap();
    if std::env::var_os("WCAL_WRITE_DOCS").is_some() {
        let (head, tail) = (
            readme.split_once(BEGIN).unwrap().0,
            readme.split_once(END).unwrap().1,
        );
        fs::write(
            repository("README.md"),
            format!("{head}{BEGIN}{found}{END}{tail}"),
        )
        .unwrap();
    } else {
        assert_eq!(stands, found, "README.md: make results writes the table");
    }
    // Each row says what its data are.
    assert!(
        rows.iter().all(|r| r[1].starts_with("measured, ")),
        "{rows:?}"
    );
    // Negative control: another result is another table.
    pontius["after"]["response_rmse"] = 3.0e-4.into();
    assert_ne!(table(&[load_cell(&pontius)]), table(&rows[..1]));
}

/// A row of a printed exam: its word, and what its interval says of its goal; none where nothing is
/// to be said.
fn judged(line: &str) -> Option<(String, &'static str)> {
    let (row, goal) = line.rsplit_once(" goal ")?;
    let word = ["met ", "MISS", "open", "    "]
        .into_iter()
        .find(|w| line.starts_with(w))?;
    let (hits, trials) = row.split_whitespace().last()?.split_once('/')?;
    let (hits, trials): (u64, u64) = (hits.parse().ok()?, trials.parse().ok()?);
    let bounds = row
        .rsplit_once('[')
        .and_then(|(_, b)| b.split_once(']'))
        .and_then(|(b, _)| b.split_once(", "));
    let goal = goal.trim().trim_start_matches("upper bound ");
    let decided = |met: bool, missed: bool| {
        if met {
            "met"
        } else if missed {
            "MISS"
        } else {
            "open"
        }
    };
    let expected = match (goal, bounds) {
        ("-", _) => "",
        ("0", _) => decided(hits == 0, hits > 0),
        ("100 %", _) => decided(hits == trials, hits < trials),
        (_, None) if row.contains("slowest") => return None,
        (_, None) => "open",
        (goal, Some((low, high))) => {
            let (low, high): (f64, f64) = (low.parse().ok()?, high.parse().ok()?);
            let share = |sign: &str| -> Option<f64> {
                let percent = goal.strip_prefix(sign)?.trim().strip_suffix(" %")?;
                percent.parse::<f64>().ok().map(|p| p / 100.0)
            };
            match (share(">="), share("<=")) {
                (Some(g), _) => decided(low >= g, high < g),
                (_, Some(g)) => decided(high <= g, low > g),
                _ => decided(low <= 0.95 && 0.95 <= high, true),
            }
        }
    };
    Some((word.trim().to_owned(), expected))
}

#[test]
fn a_goal_on_the_page_of_the_exam_is_met_by_its_interval() {
    let page = read("docs/src/lab-notes/exam-tables.md");
    let rows: Vec<_> = page.lines().filter_map(|l| Some((judged(l)?, l))).collect();
    assert!(rows.len() > 100, "{}", rows.len());
    let wrong: Vec<&str> = rows
        .iter()
        .filter(|((word, expected), _)| word != expected)
        .map(|r| r.1)
        .collect();
    assert_eq!(wrong, Vec::<&str>::new());
    assert!(rows.iter().any(|r| r.0.0 == "met") && rows.iter().any(|r| r.0.0 == "MISS"));
    // Negative control: one of one.
    let line = "met  right class, rich single >= 8 sigma, no rival within 3        1.000 [0.025, 1.000]       1/1     goal >= 93 %";
    assert_eq!(judged(line), Some(("met".to_owned(), "open")));
}
