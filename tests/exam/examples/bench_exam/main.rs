//! The exam of `wcal verify` on what the program records itself: scenarios drawn by seed, served by
//! the virtual bench, swept, verified (SIMULATED).
//!
//! `cargo run --example bench_exam -- [--draws N] [--seed S] [--plan rich|paper-27|both] [--benches N] [--wcal PATH] [--keep DIR] [--json FILE]`
//!
//! First a session of each plan without an effect tells the smallest detectable sizes; the others
//! are drawn by them (draw.rs). `--benches` run beside each other. Sessions that `--keep` holds
//! already are verified anew, not recorded again.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "an example talks to its user"
)]

#[path = "../../../support/board_pictures.rs"]
mod board_pictures;
mod draw;
mod score;
mod sit;

use anyhow::{Context, bail, ensure};
use draw::{Draw, Smallest, draw, reference, smallest};
use score::{Score, score, table};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// What is asked for.
struct Options {
    draws: u64,
    seed: u64,
    plans: Vec<&'static str>,
    benches: usize,
    wcal: PathBuf,
    keep: Option<PathBuf>,
    json: Option<PathBuf>,
}

fn options() -> anyhow::Result<Options> {
    // The program lies beside the folder of the examples.
    let beside = std::env::current_exe()?
        .parent()
        .and_then(Path::parent)
        .map(|p| p.join("wcal"));
    let mut o = Options {
        draws: 40,
        seed: 1,
        plans: vec!["rich", "paper-27"],
        benches: 2,
        wcal: beside.context("no folder beside the example")?,
        keep: None,
        json: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || {
            words
                .next()
                .with_context(|| format!("{word}: expected a value, found the end"))
        };
        match word.as_str() {
            "--draws" => o.draws = value()?.parse().context("--draws: expected a number")?,
            "--seed" => o.seed = value()?.parse().context("--seed: expected a number")?,
            "--plan" => match value()?.as_str() {
                "both" => {}
                asked => {
                    o.plans.retain(|p| *p == asked);
                    ensure!(
                        !o.plans.is_empty(),
                        "--plan: expected rich, paper-27 or both, found {asked}"
                    );
                }
            },
            "--benches" => o.benches = value()?.parse().context("--benches: expected a number")?,
            "--wcal" => o.wcal = value()?.into(),
            "--keep" => o.keep = Some(value()?.into()),
            "--json" => o.json = Some(value()?.into()),
            other => bail!(
                "unknown option {other}; see the head of tests/exam/examples/bench_exam/main.rs"
            ),
        }
    }
    Ok(o)
}

/// An answer: verify.json and the time it took, s.
type Answer = anyhow::Result<(Value, f64)>;

/// Sits all `draws`, some of them at a time, in folders of `place`; answers in their order.
fn sit_all(o: &Options, draws: &[Draw], place: &Path, prefix: &str) -> Vec<Answer> {
    let next = AtomicUsize::new(0);
    let answers: Mutex<BTreeMap<usize, Answer>> = Mutex::default();
    let work = || {
        loop {
            let i = next.fetch_add(1, Ordering::Relaxed);
            let Some(d) = draws.get(i) else { return };
            let begun = Instant::now();
            let answer = sit::sit(o, d, &place.join(format!("{prefix}{:03}", d.k)));
            let answer = answer.map(|v| (v, begun.elapsed().as_secs_f64()));
            match &answer {
                Ok((v, seconds)) => println!("{}", score(d, v, *seconds).line),
                Err(why) => println!("{:3} no answer: {why:#}", d.k),
            }
            if let Ok(mut all) = answers.lock() {
                all.insert(i, answer);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..o.benches.min(draws.len()) {
            scope.spawn(work);
        }
    });
    answers
        .into_inner()
        .map(|all| all.into_values().collect())
        .unwrap_or_default()
}

fn main() -> anyhow::Result<ExitCode> {
    let o = options()?;
    let start = Instant::now();
    let temporary = tempfile::tempdir()?;
    let place = o
        .keep
        .clone()
        .unwrap_or_else(|| temporary.path().to_owned());
    let references: Vec<Draw> = o
        .plans
        .iter()
        .zip(0..)
        .map(|(plan, k)| Draw {
            k,
            ..reference(o.seed, plan)
        })
        .collect();
    let told = sit_all(&o, &references, &place, "reference-");
    let mut sizes: Vec<Smallest> = Vec::new();
    for answer in &told {
        let (v, _) = answer
            .as_ref()
            .map_err(|e| anyhow::anyhow!("a session without an effect: {e:#}"))?;
        sizes.push(smallest(v));
    }
    let plans = o.plans.len() as u64;
    let of = |k: u64| {
        let plan = (k % plans) as usize;
        draw(o.seed, k, o.plans[plan], k / plans, &sizes[plan])
    };
    let draws: Vec<Draw> = (0..o.draws).map(of).collect();
    let answers = sit_all(&o, &draws, &place, "");
    let all = references
        .iter()
        .zip(&told)
        .chain(draws.iter().zip(&answers));
    let scores: Vec<Score> = all
        .filter_map(|(d, a)| a.as_ref().ok().map(|(v, seconds)| score(d, v, *seconds)))
        .collect();
    let (asked, seconds) = (
        references.len() + draws.len(),
        start.elapsed().as_secs_f64(),
    );
    println!(
        "\nSIMULATED, {} answers of {asked} sessions, seed {}, {seconds:.0} s",
        scores.len(),
        o.seed
    );
    println!(
        "smallest detectable sizes at {} Hz: {}",
        draw::REFERENCE_HZ,
        serde_json::to_string(&sizes)?
    );
    let rows = table(&scores);
    if let Some(path) = &o.json {
        let lines: Vec<&String> = scores.iter().map(|s| &s.line).collect();
        let record = json!({
            "simulated": true, "seed": o.seed, "sessions": asked, "answers": scores.len(), "seconds": seconds, "smallest": sizes,
            "rows": rows, "lines": lines,
        });
        std::fs::write(path, serde_json::to_vec_pretty(&record)?)?;
    }
    Ok(ExitCode::SUCCESS)
}
