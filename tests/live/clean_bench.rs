//! Clean sessions of the virtual bench with pictures, from the sweep to the verdict, through the
//! program alone (SIMULATED).
//!
//! `WCAL_DRAWS=20 cargo test --workspace --test live clean_bench:: -- --nocapture` prints the rate
//! over more of them.

use crate::support::board_pictures::board_pictures;
use crate::support::virtual_bench::VirtualBench;
use crate::support::{code_and_messages, fixture};
use serde_json::Value;
use std::path::Path;

/// Verdict on one session of twelve poses under the bench's `effects`.
fn verdict(seed: u64, effects: &str) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let scenario = format!(
        "format = \"wcal-scenario/1\"\nseed = {seed}\nspeed = 3.0\n[interrogator]\nrate_hz = 500\n[cameras]\nrate_hz = 5\n{effects}"
    );
    let bench = VirtualBench::serve(folder.path(), "", &scenario);
    let addresses: Value =
        serde_json::from_slice(&std::fs::read(&bench.addresses).unwrap()).unwrap();
    let board = folder.path().join("board");
    board_pictures(
        [0, 1].map(|k| addresses["cameras"][k].as_str().unwrap()),
        &board,
        12,
    )
    .unwrap();
    let [rig, plan] =
        ["rig.toml", "plan.toml"].map(|name| fixture("pictured").join(name).display().to_string());
    let (session, cameras, out) = (at("session"), at("cameras"), at("verify"));
    let bench_file = at("bench.json");
    let sweep = [
        "--rig",
        &rig,
        "--plan",
        &plan,
        "--bench",
        &bench_file,
        "--out",
        &session,
    ];
    let (code, text) = code_and_messages(&[&["stage-sweep", "--home"][..], &sweep].concat());
    assert!(code == 0 || code == 3, "{text}");
    drop(bench);
    let [left, right] = ["left", "right"].map(|side| board.join(side).display().to_string());
    let board = ["--board", "9x6", "--square-mm", "6", "--out", &cameras];
    let (code, text) =
        code_and_messages(&[&["stereo-calibrate", &left, &right][..], &board].concat());
    assert!(code == 0 || code == 3, "{text}");
    let (code, text) = code_and_messages(&[
        "stereo-shape",
        &session,
        "--cameras",
        &format!("{cameras}/stereo.json"),
    ]);
    assert!(code == 0 || code == 3, "{text}");
    let (_, text) = code_and_messages(&["verify", &session, "--out", &out]);
    let document = std::fs::read(Path::new(&out).join("verify.json"));
    serde_json::from_slice(&document.unwrap_or_else(|e| unreachable!("{e}: {text}"))).unwrap()
}

/// Of three sessions none may name an effect (of the exam's 48 with pictures and without an effect
/// none has a name), and at most one may be called anything but adequate (1 of 48: 0.1 % for two of
/// three). Their held-out readings together are as wrong as the model expects.
#[test]
fn clean_sessions_are_adequate() {
    let _turn = crate::beside_others();
    let draws: u64 = std::env::var("WCAL_DRAWS")
        .ok()
        .and_then(|d| d.parse().ok())
        .unwrap_or(3);
    let all: Vec<Value> = (0..draws).map(|seed| verdict(201 + seed, "")).collect();
    for v in &all {
        println!(
            "{} {}; pictures scatter {} of what they state; after / expected {:.2}",
            v["verdict"],
            v["effects"],
            v["tests"][0]["magnitude"],
            over_expected(v, "after")
        );
    }
    let adequate = all.iter().filter(|v| v["verdict"] == "adequate").count() as u64;
    println!("{adequate} of {draws} adequate (SIMULATED)");
    assert_eq!(faults(&all), Vec::<String>::new());
    // Controls: a groove that sits elsewhere is found, and would not pass as clean in one of the
    // three; nor would its error without the name.
    let v = verdict(200, "[effects]\ngroove_offset_mm = [0.0, 0.12, 0.16]\n");
    assert!(
        v["verdict"] == "effect" && v["effects"][0]["id"] == "contact-offset",
        "{}",
        v["effects"]
    );
    assert!(!faults(&[all[0].clone(), all[1].clone(), v.clone()]).is_empty());
    let unnamed = [
        over_expected(&all[0], "after"),
        over_expected(&all[1], "after"),
        over_expected(&v, "before"),
    ];
    assert!(pooled(&unnamed) > AS_EXPECTED, "{unnamed:?}");
}

/// Held-out error of the accepted model ("after") or the declared one ("before") over what the
/// accepted one expects of the same readings.
fn over_expected(v: &Value, which: &str) -> f64 {
    let of = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    of(&v[which]["wavelength_rmse_pm"]) / of(&v["after"]["expected"]["wavelength_rmse_pm"])
}

/// Root of the mean square.
fn pooled(ratios: &[f64]) -> f64 {
    (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt()
}

/// Held-out error of three sessions over what is expected from which they are not as expected. Of
/// one alone, with two sealed trajectories, it scatters from 0.7 to 1.5.
const AS_EXPECTED: f64 = 1.6;

/// What speaks against these being sessions without an effect.
fn faults(all: &[Value]) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let named = all
        .iter()
        .enumerate()
        .filter(|(_, v)| v["verdict"] == "effect");
    out.extend(named.map(|(k, v)| format!("session {k} names {}", v["effects"])));
    let ratio = pooled(
        &all.iter()
            .map(|v| over_expected(v, "after"))
            .collect::<Vec<_>>(),
    );
    if !(ratio < AS_EXPECTED) {
        out.push(format!("{ratio:.2} times what is expected"));
    }
    let other = all.iter().filter(|v| v["verdict"] != "adequate").count();
    // One in twenty is expected; more than twice as many and one more are not.
    if 10 * other > all.len() + 10 {
        out.push(format!("{other} of {} are not adequate", all.len()));
    }
    out
}
