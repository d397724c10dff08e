//! README's table of results, row by row from what makes it: commands that are run here, records that the exam wrote, and dated lab notes.
//!
//! `make results` writes the table (`WCAL_WRITE_DOCS=1 cargo test --workspace --test contracts results::`); without it the test compares.

use crate::support::{program, repository};
use serde_json::Value;
use std::fs;
use std::path::Path;
use wcal_exam::clopper_pearson;

const BEGIN: &str = "<!-- results: written by `make results` -->\n";
const END: &str = "<!-- end of results -->\n";
const RECORDS: &str = "docs/src/lab-notes/exam";
const TRACKING: &str = "docs/src/lab-notes/tracking.md";

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
    rmse["response_rmse"].as_f64().or_else(|| rmse["wavelength_rmse_pm"].as_f64()).unwrap()
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
            format!("ambiguous between {} explanations", document["alternatives"].as_array().unwrap().len())
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

/// Error of the declared model where our rod takes the place of the released labels: one of the answer's notes.
fn declared_by_our_rod(document: &Value) -> f64 {
    const SAYS: &str = "declared model, labels repaired by the rod: ";
    let mut notes = document["notes"].as_array().unwrap().iter().filter_map(Value::as_str);
    let said = notes.find_map(|n| Some(n.split_once(SAYS)?.1)).unwrap();
    said.split(' ').next().unwrap().parse().unwrap()
}

fn whisker() -> Row {
    let v = fixture("whiskerfbg");
    let [session, sweep] = ["fixtures/whiskerfbg", "fixtures/whiskerfbg_bottle"].map(repository);
    let swept = verified(&session, Some(&sweep));
    let explanations = swept["sweep"]["explanations"].as_array().unwrap();
    let refuted = explanations.iter().filter(|e| e["refuted"] == true).count();
    let faults = v["twin"]["faults"].as_array().unwrap();
    let branch = faults.iter().find(|f| f["kind"] == "branch").unwrap();
    let faulty = branch["points"].as_array().unwrap().len();
    [
        "whisker of the paper: wavelengths of trajectories left out in turn".to_owned(),
        format!("measured, one whisker, {} poses, no replicates", left_out(&v)),
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
        format!("{}; the sweep refutes {refuted} of them, {} is left", verdict(&v), verdict(&swept)),
    ]
}

/// A record of the exam.
struct Record(Value);

impl Record {
    fn read(mix: &str) -> Self {
        let record: Value = serde_json::from_str(&read(&format!("{RECORDS}/{mix}.json"))).unwrap();
        assert_eq!(
            (record["format"].as_str(), record["mix"].as_str()),
            (Some("wcal-exam-record/1"), Some(mix))
        );
        Self(record)
    }

    /// Hits and trials of a score.
    fn counts(&self, score: &str) -> [u64; 2] {
        let row = self.0["rows"].as_array().unwrap().iter().find(|r| r["score"] == score);
        let row = row.unwrap_or_else(|| unreachable!("{score}"));
        ["hits", "trials"].map(|key| row[key].as_u64().unwrap())
    }

    fn said(&self) -> String {
        let of = |key: &str| self.0[key].as_str().unwrap_or_default().to_owned();
        let changed = if self.0["changed_since_commit"] == true { " with changes" } else { "" };
        format!("`{}`, seed {}, {}, commit {}{changed}", of("mix"), self.0["seed"], of("date"), of("commit"))
    }

    fn noises(&self) -> usize {
        self.0["noises"].as_array().unwrap().len()
    }
}

/// Hits of trials with the 95 % interval of their share.
fn share(hits: u64, trials: u64) -> String {
    let (low, high) = clopper_pearson(hits as usize, trials as usize);
    format!("{hits} of {trials} [{:.1} to {:.1} %]", 100.0 * low, 100.0 * high)
}

const EXAM: &str = "[the exam](docs/src/exam.md)";

fn nulls() -> Row {
    let (whisker, lines) = (Record::read("noise-null"), Record::read("scalar-null"));
    let both = |what: &str| {
        let [a, b] =
            [whisker.counts(&format!("every noise: {what}")), lines.counts(&format!("lines: {what}"))];
        [a[0] + b[0], a[1] + b[1]]
    };
    let ([named, of], [unknown, _]) = (both("false names on nulls"), both("nulls called unknown-effect"));
    [
        "`verify` where nothing is wrong: sessions in which it says that something is".to_owned(),
        format!(
            "SIMULATED, {of} draws, {} kinds of noise, every layout ({}; {})",
            whisker.noises() + lines.noises(),
            whisker.said(),
            lines.said()
        ),
        String::new(),
        format!(
            "{} with a false name; {unknown} called unknown-effect, with a name or without",
            share(named, of)
        ),
        EXAM.to_owned(),
    ]
}

fn singles() -> Row {
    let record = Record::read("noise-single");
    let [right, of] = record.counts("every noise: singles >= 8 sigma right");
    let [wrong, _] = record.counts("every noise: singles >= 8 sigma, wrong name");
    [
        "`verify` with one effect of 8 sigma or more: the right class named".to_owned(),
        format!(
            "SIMULATED, {} draws, {} kinds of noise, every layout ({})",
            record.0["drawn"],
            record.noises(),
            record.said()
        ),
        String::new(),
        format!("{}; a wrong name in {wrong}", share(right, of)),
        EXAM.to_owned(),
    ]
}

/// Cells of the rows of a table in the lab notes, below a heading and under a head.
fn noted(heading: &str, head: &str) -> Vec<Vec<String>> {
    let notes = read(TRACKING);
    let section =
        notes.split("\n## ").find(|s| s.starts_with(heading)).unwrap_or_else(|| unreachable!("{heading}"));
    let table = section.split_once(head).unwrap_or_else(|| unreachable!("{head}")).1;
    let rows = table.lines().skip(2).take_while(|l| l.starts_with('|'));
    rows.map(|l| l.trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()).collect()
}

fn date(heading: &str) -> &str {
    heading.split(' ').find(|w| w.starts_with("20")).unwrap()
}

const LAB_NOTES: &str = "[lab notes](docs/src/lab-notes/tracking.md)";

fn groove() -> Row {
    let heading = "Noise as instruments make it, on the groove, 2026-11-25";
    let rows = noted(heading, "| noise | before: error / bound, mm | ratio | held | after: ratio | held |");
    // Where the later tracker was not run, the row of the earlier one stands.
    let newest = |r: &Vec<String>| {
        if r[4] == "not run" { [r[2].clone(), r[3].clone()] } else { [r[4].clone(), r[5].clone()] }
    };
    let newest: Vec<[String; 2]> = rows.iter().map(newest).collect();
    let earlier = rows.iter().filter(|r| r[4] == "not run").count();
    let mut ratios: Vec<f64> = newest.iter().map(|r| r[0].parse().unwrap()).collect();
    ratios.sort_by(f64::total_cmp);
    let held = |r: &[String; 2]| -> (u64, u64) {
        let (k, n) = r[1].split(' ').next().unwrap().split_once('/').unwrap();
        (k.parse().unwrap(), n.parse().unwrap())
    };
    let counts: Vec<(u64, u64)> = newest.iter().map(held).collect();
    let mut shares: Vec<f64> = counts.iter().map(|(k, n)| 100.0 * *k as f64 / *n as f64).collect();
    shares.sort_by(f64::total_cmp);
    let (least, most) =
        (counts.iter().map(|c| c.1).min().unwrap(), counts.iter().map(|c| c.1).max().unwrap());
    [
        "contact on the groove, motion known: error / Cramer-Rao bound; trajectories whose 95 % regions hold it".to_owned(),
        format!(
            "SIMULATED, calibrations of 27 poses, {} kinds of noise ({earlier} by the tracker before), {least} to {most} trajectories each, {}",
            rows.len(),
            date(heading)
        ),
        String::new(),
        format!("{:.2} to {:.2}; {:.0} to {:.0} %", ratios[0], ratios[ratios.len() - 1], shares[0], shares[shares.len() - 1]),
        LAB_NOTES.to_owned(),
    ]
}

fn tracker() -> Row {
    let heading = "The shipped model, 2026-11-23";
    let rows = noted(heading, "| RMSE from the surface | seen | unseen |");
    let bench = rows.iter().find(|r| r[0].starts_with("VIRTUAL real bench")).unwrap();
    [
        "contact tracking by the network: distance from the surface only, objects seen / unseen in training"
            .to_owned(),
        format!("SIMULATED, virtual bench, twelve sweeps a scan, {}", date(heading)),
        String::new(),
        format!("{} / {} mm", bench[1], bench[2]),
        LAB_NOTES.to_owned(),
    ]
}

fn table(rows: &[Row]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | ")).replace("|  |", "| |");
    let head = ["what", "scope", "before", "after", "verdict, or where it stands"].map(str::to_owned);
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
    let rows = [load_cell(&pontius), actuator(), whisker(), nulls(), singles(), groove(), tracker()];
    let found = table(&rows);
    let readme = read("README.md");
    let stands = between(&readme).unwrap();
    if std::env::var_os("WCAL_WRITE_DOCS").is_some() {
        let (head, tail) = (readme.split_once(BEGIN).unwrap().0, readme.split_once(END).unwrap().1);
        fs::write(repository("README.md"), format!("{head}{BEGIN}{found}{END}{tail}")).unwrap();
    } else {
        assert_eq!(stands, found, "README.md: make results writes the table");
    }
    // Each row says what its data are, and those that are not run here of which day they are.
    let dated = |r: &Row| r[1].contains(", 20");
    assert!(
        rows.iter().all(|r| r[1].starts_with("measured, ") != (r[1].starts_with("SIMULATED, ") && dated(r))),
        "{rows:?}"
    );
    // Negative control: another result is another table.
    pontius["after"]["response_rmse"] = 3.0e-4.into();
    assert_ne!(table(&[load_cell(&pontius)]), table(&rows[..1]));
}

/// A row of a printed exam: its word, and what its interval says of its goal; none where nothing is to be said.
fn judged(line: &str) -> Option<(String, &'static str)> {
    let (row, goal) = line.rsplit_once(" goal ")?;
    let word = ["met ", "MISS", "open", "    "].into_iter().find(|w| line.starts_with(w))?;
    let (hits, trials) = row.split_whitespace().last()?.split_once('/')?;
    let (hits, trials): (u64, u64) = (hits.parse().ok()?, trials.parse().ok()?);
    let bounds =
        row.rsplit_once('[').and_then(|(_, b)| b.split_once(']')).and_then(|(b, _)| b.split_once(", "));
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
    let page = read("docs/src/exam.md");
    let rows: Vec<_> = page.lines().filter_map(|l| Some((judged(l)?, l))).collect();
    assert!(rows.len() > 100, "{}", rows.len());
    let wrong: Vec<&str> =
        rows.iter().filter(|((word, expected), _)| word != expected).map(|r| r.1).collect();
    assert_eq!(wrong, Vec::<&str>::new());
    assert!(rows.iter().any(|r| r.0.0 == "met") && rows.iter().any(|r| r.0.0 == "MISS"));
    // Negative control: one of one.
    let line = "met  right class, rich single >= 8 sigma, no rival within 3        1.000 [0.025, 1.000]       1/1     goal >= 93 %";
    assert_eq!(judged(line), Some(("met".to_owned(), "open")));
}
