//! Small damage to every kind of file: a refusal names its own file, is one line, and repeats no
//! more of the file than a person reads.

use super::limits::{in_parallel, limited, sound};
use super::*;
use crate::support::copy::copy_folder;
use crate::support::{fixture, repository};

/// Longest refusal, characters.
const LONGEST: usize = 1600;

/// A file, a command that reads it, and the name by which a refusal calls it.
struct Read {
    file: &'static str,
    arguments: &'static str,
}

/// Ways to damage a text, by number; each changes it in a place that the number chooses.
fn damaged(text: &[u8], which: usize) -> Vec<u8> {
    let lines: Vec<&[u8]> = text.split_inclusive(|byte| *byte == b'\n').collect();
    let line = which / 8 * 7 % lines.len().max(1);
    let at = which / 8 * 131 % text.len().max(1);
    let long = |letter: &str| letter.repeat(3_000_000).into_bytes();
    let with = |replaced: Vec<u8>| {
        let mut all: Vec<Vec<u8>> = lines.iter().map(|l| l.to_vec()).collect();
        all[line] = replaced;
        all.concat()
    };
    let own = String::from_utf8_lossy(lines[line]).into_owned();
    let value = |new: &str| match own.split_once([':', '=']) {
        Some((key, _)) => format!(
            "{key}{}{new}{}\n",
            if own.contains(" = ") { "= " } else { ": " },
            if own.trim_end().ends_with(',') {
                ","
            } else {
                ""
            }
        ),
        None => format!("{new}\n"),
    };
    match which % 8 {
        0 => text[..at].to_vec(),
        1 => [&text[..at], b"\x00", &text[at..]].concat(),
        2 => with(Vec::new()),
        3 => with(value(&format!("\"{}\"", String::from_utf8_lossy(&long("x")))).into_bytes()),
        4 => with(value("{}").into_bytes()),
        5 => with([lines[line], lines[line]].concat()),
        6 => with(value("-7.5e300").into_bytes()),
        _ => [&text[..at], &long("\u{e9}\n")[..], &text[at..]].concat(),
    }
}

/// A place with good files of every kind.
fn place() -> (tempfile::TempDir, Vec<Read>) {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    for (base, folder) in [
        (Base::Whisker, "w"),
        (Base::Transducer, "t"),
        (Base::Axis, "a"),
    ] {
        fs::create_dir(at(folder)).unwrap();
        base.write(&at(folder));
    }
    let copy = |from: &Path, to: &str| {
        fs::create_dir_all(at(to).parent().unwrap()).unwrap();
        fs::copy(from, at(to)).unwrap();
    };
    copy(&repository("rigs/virtual/rig.toml"), "rig.toml");
    copy(&repository("rigs/plans/paper-27.toml"), "plan.toml");
    copy(&repository("rigs/virtual/scenario.toml"), "scenario.toml");
    copy(&fixture("tracker_small/model.json"), "model/model.json");
    copy(
        &fixture("tracker_small/model.safetensors"),
        "model/model.safetensors",
    );
    copy(&fixture("pictured/stereo.json"), "stereo.json");
    copy(&fixture("pictured/rig.toml"), "seen.toml");
    for name in ["rig.toml", "run.json"] {
        copy(&fixture("pictured").join(name), &format!("recorded/{name}"));
    }
    let pretty = |value: &serde_json::Value| serde_json::to_string_pretty(value).unwrap();
    let [physical, _, scalar] = calibrations::models();
    fs::write(at("c.json"), pretty(&calibrations::calibration(scalar))).unwrap();
    fs::write(at("p.json"), pretty(&calibrations::calibration(physical))).unwrap();
    fs::write(at("cell.csv"), "point,response\n1,2.5\n2,4.5\n").unwrap();
    fs::write(
        at("wire.csv"),
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n2,1,1541.4,1535.9\n",
    )
    .unwrap();
    fs::write(
        at("sweeps.toml"),
        "rate_hz = 5.0\nspeed_mm_s = [3.0, 7.0]\nmost_mm = 30.0\n",
    )
    .unwrap();
    fs::write(
        at("shapes.json"),
        "{\n \"format\": \"wcal-shapes/1\",\n \"pairs\": []\n}\n",
    )
    .unwrap();
    let read = |file: &'static str, arguments: &'static str| Read { file, arguments };
    let all = vec![
        read("w/session.toml", "verify w --check"),
        read("w/points.csv", "verify w --check"),
        read("w/twin.csv", "verify w --check"),
        read("t/session.toml", "verify t --out o"),
        read("t/points.csv", "verify t --out o"),
        read("a/points.csv", "verify a --check"),
        read(
            "rig.toml",
            "stage-sweep --rig rig.toml --plan plan.toml --dry-run",
        ),
        read(
            "plan.toml",
            "stage-sweep --rig rig.toml --plan plan.toml --dry-run",
        ),
        read("scenario.toml", "virtual-bench --scenario scenario.toml"),
        read(
            "stereo.json",
            "stereo-shape left right --cameras stereo.json --rig seen.toml --out o",
        ),
        read(
            "seen.toml",
            "stereo-shape left right --cameras stereo.json --rig seen.toml --out o",
        ),
        read("recorded/rig.toml", "reduce recorded"),
        read("recorded/run.json", "reduce recorded"),
        read(
            "c.json",
            "predict cell.csv --calibration c.json --out o.csv",
        ),
        read(
            "cell.csv",
            "predict cell.csv --calibration c.json --out o.csv",
        ),
        read(
            "p.json",
            "predict wire.csv --calibration p.json --out o.csv",
        ),
        read(
            "wire.csv",
            "predict wire.csv --calibration p.json --out o.csv",
        ),
        read(
            "shapes.json",
            "fit-whisker shapes.json --rig seen.toml --out o",
        ),
        read(
            "t/points.csv",
            "import t/points.csv --kind transducer --stimulus stimulus --response response --model linear --out i",
        ),
    ];
    (place, all)
}

/// What is wrong with a refusal, if anything. What is the same with the good file is no matter of
/// the damage.
fn judge_refusal(read: &Read, output: &Output, usual: &str) -> Result<(), String> {
    let text = sound(output)?;
    if output.status.code() != Some(1) || text == usual {
        return Ok(());
    }
    // `verify --check` says it as a finding, `verify` of data that decide nothing as its verdict.
    let Some(at) = ["wcal: ", "error  files", "verdict", ": refused"]
        .iter()
        .find_map(|start| text.find(start))
    else {
        return Err(format!(
            "no refusal: {}",
            text.chars().take(300).collect::<String>()
        ));
    };
    let of_data = read.arguments.starts_with("verify") && text.contains(": refused");
    let whole = if of_data || text[at..].starts_with("error") {
        text[at..].lines().next().unwrap_or_default()
    } else {
        &text[at..]
    };
    let refusal = whole.trim_end();
    if of_data {
        return Ok(());
    }
    let head: String = refusal.chars().take(400).collect();
    let name = read.file.rsplit('/').next().unwrap();
    if refusal.lines().count() != 1 {
        return Err(format!("{} lines: {head}", refusal.lines().count()));
    }
    if refusal.chars().count() > LONGEST {
        return Err(format!("{} characters: {head}", refusal.chars().count()));
    }
    // A label of a point that is no longer there is the label's fault.
    let of_label =
        name == "points.csv" && refusal.contains("twin.csv") && refusal.contains("points table");
    if !refusal.contains(name) && !of_label {
        return Err(format!("{name} is not named: {head}"));
    }
    Ok(())
}

#[test]
fn a_refusal_names_its_own_file_and_is_one_line() {
    let (place, all) = place();
    let damages: usize = std::env::var("WCAL_DAMAGES")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(8);
    let run = |folder: &Path, read: &Read| {
        limited(folder, &read.arguments.split(' ').collect::<Vec<_>>())
    };
    let usual: Vec<String> = all
        .iter()
        .map(|read| {
            let own = tempfile::tempdir().unwrap();
            copy_folder(place.path(), own.path());
            sound(&run(own.path(), read)).unwrap_or_else(|why| panic!("{}: {why}", read.arguments))
        })
        .collect();
    // Each kind of damage at another place of the file.
    let cases: Vec<(usize, usize)> = (0..all.len())
        .flat_map(|k| (0..damages).map(move |d| (k, 9 * d)))
        .collect();
    let refused = std::sync::atomic::AtomicUsize::new(0);
    let wrong = in_parallel(&cases, |(k, damage)| {
        let read = &all[*k];
        let own = tempfile::tempdir().unwrap();
        copy_folder(place.path(), own.path());
        let path = own.path().join(read.file);
        let good = fs::read(&path).unwrap();
        fs::write(&path, damaged(&good, *damage)).unwrap();
        let output = run(own.path(), read);
        refused.fetch_add(
            usize::from(output.status.code() == Some(1)),
            std::sync::atomic::Ordering::Relaxed,
        );
        judge_refusal(read, &output, &usual[*k])
            .map_err(|why| format!("{} damage {damage}: {why}", read.arguments))
    });
    assert!(
        wrong.is_empty(),
        "{} of {} faults\n{}",
        wrong.len(),
        cases.len(),
        wrong.join("\n")
    );
    // Negative control: damage is noticed, or nothing was judged.
    let refused = refused.into_inner();
    assert!(
        2 * refused > cases.len(),
        "{refused} of {} refused",
        cases.len()
    );
}
