//! The exam of `wcal verify` on what the program records itself: scenarios drawn by seed, served by the virtual bench, swept, verified (SIMULATED).
//!
//! `cargo run --example bench_exam -- [--draws N] [--seed S] [--plan rich|paper-27|both] [--speed X] [--wcal PATH] [--keep DIR] [--json FILE]`
//!
//! One draw in six is without an effect, one has two, one has a drift that sets in halfway, which no catalogue has; the others have one effect.
//! Rates are drawn from 200 to 2,000 Hz. The table gives shares with exact 95 % bounds (Clopper-Pearson); a goal is met by its bound.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "an example talks to its user")]

use anyhow::{Context, bail, ensure};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Instant;
use wcal_exam::clopper_pearson;

struct Options {
    draws: u64,
    seed: u64,
    plan: String,
    speed: f64,
    wcal: PathBuf,
    keep: Option<PathBuf>,
    json: Option<PathBuf>,
}

fn options() -> anyhow::Result<Options> {
    // The program lies beside the folder of the examples.
    let beside = std::env::current_exe()?.parent().and_then(Path::parent).map(|p| p.join("wcal"));
    let wcal = beside.context("no folder beside the example")?;
    let mut o =
        Options { draws: 24, seed: 1, plan: "both".into(), speed: 16.0, wcal, keep: None, json: None };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().with_context(|| format!("{word}: expected a value, found the end"));
        match word.as_str() {
            "--draws" => o.draws = value()?.parse().context("--draws: expected a number")?,
            "--seed" => o.seed = value()?.parse().context("--seed: expected a number")?,
            "--plan" => o.plan = value()?,
            "--speed" => o.speed = value()?.parse().context("--speed: expected a number")?,
            "--wcal" => o.wcal = value()?.into(),
            "--keep" => o.keep = Some(value()?.into()),
            "--json" => o.json = Some(value()?.into()),
            other => bail!("unknown option {other}; see the head of rigs/exam/examples/bench_exam.rs"),
        }
    }
    ensure!(
        ["rich", "paper-27", "both"].contains(&o.plan.as_str()),
        "--plan: expected rich, paper-27 or both, found {}",
        o.plan
    );
    Ok(o)
}

/// An effect that the bench can have: its name in the catalogue, its key in a scenario, the range of its size by plan (none: the plan does not
/// show it), and the parameter of verify.json that stands for it, in units of the key.
struct Effect {
    id: &'static str,
    key: &'static str,
    rich: [f64; 2],
    paper: Option<[f64; 2]>,
    parameter: &'static str,
    per_key: f64,
}

/// Sizes from some five to some forty standard deviations of a session at 500 Hz; a lag stays beyond what stamps of the stage leave open.
const EFFECTS: [Effect; 6] = [
    Effect {
        id: "stage-backlash",
        key: "backlash_um",
        rich: [4.0, 40.0],
        paper: None,
        parameter: "backlash_mm",
        per_key: 1e-3,
    },
    Effect {
        id: "time-lag",
        key: "lag_ms",
        rich: [8.0, 80.0],
        paper: None,
        parameter: "lag_s",
        per_key: 1e-3,
    },
    Effect {
        id: "zero-drift",
        key: "zero_drift_pm_per_min",
        rich: [0.02, 0.3],
        paper: Some([0.2, 2.0]),
        parameter: "drift_pm_per_min_1",
        per_key: 1.0,
    },
    Effect {
        id: "creep",
        key: "creep_fraction",
        rich: [0.005, 0.05],
        paper: None,
        parameter: "creep_fraction",
        per_key: 1.0,
    },
    Effect {
        id: "fbg-nonlinearity",
        key: "quadratic_fraction",
        rich: [0.002, 0.02],
        paper: Some([0.004, 0.04]),
        parameter: "",
        per_key: 1.0,
    },
    Effect {
        id: "base-compliance",
        key: "root_turn_rad_per_nmm",
        rich: [1e-3, 1e-2],
        paper: Some([2e-3, 2e-2]),
        parameter: "",
        per_key: 1.0,
    },
];

/// A drawn session.
struct Draw {
    seed: u64,
    plan: &'static str,
    rate_hz: f64,
    /// Effect and its size.
    acts: Vec<(&'static Effect, f64)>,
    /// A drift that sets in at this time, s, and its rate, pm/s.
    outside: Option<[f64; 2]>,
}

fn draw(seed: u64, k: u64, plan: &str) -> Draw {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(k));
    let plan = match plan {
        "rich" => "rich",
        "paper-27" => "paper-27",
        _ if k.is_multiple_of(2) => "rich",
        _ => "paper-27",
    };
    let rate_hz = [200.0, 500.0, 1000.0, 2000.0][rng.random_range(0..4)];
    let shown: Vec<&Effect> = EFFECTS.iter().filter(|e| plan == "rich" || e.paper.is_some()).collect();
    let mut act = |avoid: Option<&str>| {
        let open: Vec<&&Effect> = shown.iter().filter(|e| Some(e.id) != avoid).collect();
        let e = *open[rng.random_range(0..open.len())];
        let [low, high] = if plan == "rich" { e.rich } else { e.paper.unwrap_or(e.rich) };
        (e, low * (high / low).powf(rng.random::<f64>()))
    };
    let (mut acts, mut outside) = (Vec::new(), None);
    match (k / 2) % 6 {
        0 => {}
        1 => {
            let first = act(None);
            let second = act(Some(first.0.id));
            acts = vec![first, second];
        }
        2 => outside = Some(if plan == "rich" { [1000.0, 2e-3] } else { [55.0, 4e-2] }),
        _ => acts = vec![act(None)],
    }
    Draw { seed: seed + k, plan, rate_hz, acts, outside }
}

impl Draw {
    fn scenario(&self, speed: f64) -> String {
        let effects: Vec<String> = self
            .acts
            .iter()
            .map(|(e, size)| match e.key {
                "creep_fraction" => format!("creep_fraction = {size}\ncreep_s = 30.0"),
                key => format!("{key} = {size}"),
            })
            .collect();
        let fault = self.outside.map_or_else(String::new, |[at_s, pm_per_s]| {
            format!("[[fault]]\nat_s = {at_s}\nkind = \"signal-drift\"\npm_per_s = {pm_per_s}\n")
        });
        format!(
            "format = \"wcal-scenario/1\"\nseed = {}\nspeed = {speed}\n[interrogator]\nrate_hz = {}\nnoise_pm = 1.0\n[temperature]\n\
             drift_degc_per_h = 0.3\nswing_degc = 0.05\nswing_period_s = 600.0\n[cameras]\ncount = 0\n[effects]\n{}\n{fault}",
            self.seed,
            self.rate_hz,
            effects.join("\n")
        )
    }

    fn names(&self) -> Vec<&'static str> {
        let mut names: Vec<&str> = self.acts.iter().map(|a| a.0.id).collect();
        names.sort_unstable();
        names
    }
}

/// A bench that ends when it is dropped.
struct Bench(Child);

impl Drop for Bench {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let _ = self.0.wait();
    }
}

/// Serves, sweeps and verifies; verify.json.
fn sit(o: &Options, d: &Draw, folder: &Path) -> anyhow::Result<Value> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::write(folder.join("scenario.toml"), d.scenario(o.speed))?;
    let rig = std::fs::read_to_string(root.join("rigs/virtual/rig.toml"))?;
    // The cameras stand at the end of the file; this exam has none.
    let rig = rig.split("[[camera]]").next().unwrap_or_default();
    std::fs::write(
        folder.join("rig.toml"),
        rig.replace("rate_hz = 2000.0", &format!("rate_hz = {:.1}", d.rate_hz)),
    )?;
    let mut child = Command::new(&o.wcal)
        .args(["virtual-bench", "--scenario", "scenario.toml"])
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("starting {}", o.wcal.display()))?;
    let mut line = String::new();
    BufReader::new(child.stdout.take().context("no output of the bench")?).read_line(&mut line)?;
    let bench = Bench(child);
    std::fs::write(folder.join("bench.json"), line)?;
    let plan = root.join("rigs/plans").join(format!("{}.toml", d.plan));
    let run = |arguments: &[&str]| -> anyhow::Result<Option<i32>> {
        let mut command = Command::new(&o.wcal);
        command.args(arguments).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::null());
        Ok(command.status()?.code())
    };
    let plan = plan.display().to_string();
    let swept = run(&[
        "stage-sweep",
        "--rig",
        "rig.toml",
        "--plan",
        &plan,
        "--bench",
        "bench.json",
        "--home",
        "--out",
        "session",
    ])?;
    drop(bench);
    ensure!(matches!(swept, Some(0 | 3)), "the sweep ended with {swept:?}");
    run(&["verify", "session", "--out", "verify"])?;
    Ok(serde_json::from_slice(&std::fs::read(folder.join("verify/verify.json"))?)?)
}

/// What one answer is worth.
#[derive(Default)]
struct Score {
    kind: &'static str,
    right: bool,
    wrong_name: bool,
    covered: Vec<bool>,
    floors: Vec<f64>,
    line: String,
}

fn score(d: &Draw, v: &Value, seconds: f64) -> Score {
    let verdict = v["verdict"].as_str().unwrap_or("none");
    let list = |x: &Value| -> Vec<String> {
        x.as_array().into_iter().flatten().filter_map(|s| Some(s.as_str()?.to_owned())).collect()
    };
    let effects = v["effects"].as_array().cloned().unwrap_or_default();
    let mut named: Vec<String> = effects.iter().filter_map(|e| Some(e["id"].as_str()?.to_owned())).collect();
    named.sort_unstable();
    let truth = d.names();
    let is_truth = |names: &[String]| {
        let mut names = names.to_vec();
        names.sort_unstable();
        names == truth
    };
    let in_set = v["alternatives"].as_array().into_iter().flatten().any(|a| is_truth(&list(a)));
    let kind = match (&d.outside, d.acts.len()) {
        (Some(_), _) => "outside the catalogue",
        (None, 0) => "none",
        (None, 1) => "single",
        _ => "pair",
    };
    let right = match kind {
        "none" => verdict == "adequate",
        "outside the catalogue" => verdict == "unknown-effect",
        _ => (verdict == "effect" && is_truth(&named)) || (verdict == "ambiguous" && in_set),
    };
    let wrong_name = verdict == "effect" && named.iter().any(|n| !truth.contains(&n.as_str()));
    let covered = d.acts.iter().filter(|a| !a.0.parameter.is_empty()).filter_map(|(e, size)| {
        let effect = effects.iter().find(|x| x["id"] == e.id)?;
        let own = effect["parameters"].as_array()?.iter().find(|p| p["name"] == e.parameter)?;
        let end = |k: usize| own["interval95"][k].as_f64();
        Some((end(0)?..=end(1)?).contains(&(size * e.per_key)))
    });
    // A compensated shift has the noise of two gratings: settled rows average one second, rows in motion 20 ms.
    let truth_pm = |samples: f64| (2.0 / samples).sqrt();
    let floors = [
        v["noise_floor"]["wavelength_pm"].as_f64().map(|f| f / truth_pm(d.rate_hz)),
        v["noise_floor"]["moving_wavelength_pm"].as_f64().map(|f| f / truth_pm((0.02 * d.rate_hz).max(2.0))),
    ];
    let sizes: Vec<String> = d.acts.iter().map(|(e, size)| format!("{} {size:.4}", e.id)).collect();
    let put_in = if sizes.is_empty() { kind.to_owned() } else { sizes.join(", ") };
    Score {
        kind,
        right,
        wrong_name,
        covered: covered.collect(),
        floors: floors.into_iter().flatten().collect(),
        line: format!(
            "{} {} {:4.0} Hz | {put_in} | {verdict}: {} | {} | {seconds:.0} s",
            d.seed,
            d.plan,
            d.rate_hz,
            named.join(", "),
            if right { "right" } else { "NOT RIGHT" }
        ),
    }
}

/// A row of the table: hits of trials with exact bounds, and whether the bound meets the goal.
fn row(name: &str, goal: &str, hits: usize, trials: usize, met: impl Fn(f64, f64) -> bool) -> Value {
    let (low, high) = if trials > 0 { clopper_pearson(hits, trials) } else { (0.0, 1.0) };
    let word = if trials > 0 && met(low, high) { "met" } else { "not shown" };
    println!("{name:<44} {goal:<10} {hits:3} of {trials:3}  [{low:.2}, {high:.2}]  {word}");
    json!({ "score": name, "goal": goal, "hits": hits, "of": trials, "bounds95": [low, high], "met": word == "met" })
}

fn main() -> anyhow::Result<ExitCode> {
    let o = options()?;
    let start = Instant::now();
    let mut scores = Vec::new();
    for k in 0..o.draws {
        let d = draw(o.seed, k, &o.plan);
        let temporary = tempfile::tempdir()?;
        let folder = match &o.keep {
            Some(keep) => keep.join(format!("{k:03}")),
            None => temporary.path().to_owned(),
        };
        std::fs::create_dir_all(&folder)?;
        let begun = Instant::now();
        match sit(&o, &d, &folder) {
            Ok(v) => {
                let s = score(&d, &v, begun.elapsed().as_secs_f64());
                println!("{}", s.line);
                scores.push(s);
            }
            Err(why) => eprintln!("{k}: no answer: {why:#}"),
        }
    }
    println!(
        "\nSIMULATED, {} answers of {} draws, seed {}, {:.0} s",
        scores.len(),
        o.draws,
        o.seed,
        start.elapsed().as_secs_f64()
    );
    let mut rows = Vec::new();
    let share = |of: &dyn Fn(&&Score) -> bool, hit: &dyn Fn(&&Score) -> bool| {
        let part: Vec<&Score> = scores.iter().filter(|s| of(s)).collect();
        (part.iter().filter(|s| hit(s)).count(), part.len())
    };
    let (hits, of) = share(&|_| true, &|s| s.right);
    rows.push(row("right", ">= 0.93", hits, of, |low, _| low >= 0.93));
    for kind in ["none", "single", "pair", "outside the catalogue"] {
        let (hits, of) = share(&|s| s.kind == kind, &|s| s.right);
        rows.push(row(&format!("  of these: {kind}"), "", hits, of, |_, _| false));
    }
    let (hits, of) = share(&|_| true, &|s| s.wrong_name);
    rows.push(row("a wrong or additional name, with confidence", "<= 0.02", hits, of, |_, high| {
        high <= 0.02
    }));
    let inside: Vec<bool> = scores.iter().flat_map(|s| s.covered.iter().copied()).collect();
    rows.push(row(
        "95 % intervals that hold the truth",
        ">= 0.92",
        inside.iter().filter(|i| **i).count(),
        inside.len(),
        |low, _| low >= 0.92,
    ));
    let floors: Vec<f64> = scores.iter().flat_map(|s| s.floors.iter().copied()).collect();
    let near = floors.iter().filter(|f| (1.0 / 1.3..=1.3).contains(*f)).count();
    rows.push(row("floors within 1.3 of the truth", "all", near, floors.len(), |low, _| low >= 0.93));
    if let Some(path) = &o.json {
        std::fs::write(
            path,
            serde_json::to_vec_pretty(&json!({ "seed": o.seed, "draws": o.draws, "rows": rows }))?,
        )?;
    }
    Ok(ExitCode::SUCCESS)
}
