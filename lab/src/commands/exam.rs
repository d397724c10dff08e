//! `wcal-lab exam`: draws sessions from an independent plant, has `wcal verify` judge them, scores
//! the verdicts, prints the goals. SIMULATED.

use anyhow::Context;
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use wcal_exam::orders::MIXES;
use wcal_exam::statements::{Auditor, LAYOUTS, NOISES, StatementRow, pooled};
use wcal_exam::stereo_statements::PAIRS;
use wcal_exam::tracked_statements::TRACK_REGIMES;
use wcal_exam::{
    Examiner, Goal, NoiseRow, Order, Outcome, by_noise, clopper_pearson, orders, summarise,
};
use wcal_plant::Make;

/// Arguments of `wcal-lab exam`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal-lab exam --draws 100
  wcal-lab exam --mix noise-null --draws 60 --seed 8112 --record noise-null.json

Mixes: null, single, pair, unknown, paper, confounded, adversarial (white normal noise, layouts of the practice sessions); noise-null, noise-single
(every kind of noise, every layout, two wires); scalar-null, scalar-single (transducers and axes); pictures, pictures-null, without-pictures, nominals
(27 approach-only poses that cameras look at, the same without, and with a wire that is not as declared); all.

The table of goals has the rows for which there are data; below it stands one row a kind of noise. A goal is met or missed where the 95 %
interval lies on one side of it, else open. Everything here is SIMULATED.")]
pub struct ExamArgs {
    /// Sessions to draw, of each mix
    #[arg(long, default_value_t = 40)]
    pub draws: usize,
    /// Seed of all draws
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Sessions that are judged side by side
    #[arg(long, default_value_t = 2)]
    pub jobs: usize,
    /// Longest time of one judgement, s
    #[arg(long, value_name = "S", default_value_t = 240.0)]
    pub timeout: f64,
    /// What is drawn
    #[arg(long, default_value = "all", value_parser = MIXES)]
    pub mix: String,
    /// Sessions with this effect alone
    #[arg(long, value_name = "EFFECT")]
    pub only: Option<String>,
    /// Draw no sessions in which another effect would explain as much
    #[arg(long)]
    pub no_rivals: bool,
    /// Make the measurement that an ambiguous answer asks for, and judge the second answer
    #[arg(long)]
    pub follow_up: bool,
    /// The program that is examined; the one beside this program without it
    #[arg(long, value_name = "PROGRAM")]
    pub wcal: Option<PathBuf>,
    /// Write every session's outcome
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write what a table quotes: date, commit, command, seed, and the counts of each row
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// Keep sessions and results in this folder
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Count how often each number that a user reads holds, in place of the mixes
    ///
    /// `scalars`: `--draws` clean sessions of each noise and layout, and as many with an effect;
    /// `whiskers`: as many whiskers without and with an effect; `tracks`: as many records of each
    /// regime; `stereo`: as many calibrated pairs of cameras, each with eight pairs of pictures;
    /// `map`: as many whiskers, each with its map; `checks`: as many whiskers, each looked at again
    /// unchanged and with each change; `all`.
    #[arg(long, value_name = "PART", num_args = 0..=1, default_missing_value = "all", value_parser = ["all", "scalars", "whiskers", "tracks", "stereo", "map", "checks"],
        conflicts_with_all = ["mix", "only", "no_rivals", "follow_up", "record", "write"])]
    pub statements: Option<String>,
    /// Only write the sessions and truth.json
    #[arg(long, value_name = "DIR", conflicts_with_all = ["keep", "json", "record"])]
    pub write: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// Where a folder cannot be written, or this program's own place is not known.
pub fn run(o: &ExamArgs) -> anyhow::Result<ExitCode> {
    if let Some(part) = &o.statements {
        return audit(o, part);
    }
    let orders = orders(&o.mix, o.draws, o.seed, o.only.as_deref(), !o.no_rivals);
    if let Some(folder) = &o.write {
        return write_only(folder, &orders);
    }
    let scratch = tempfile::tempdir()?;
    // The program lies beside this one.
    let beside = std::env::current_exe()?.with_file_name("wcal");
    let examiner = Examiner {
        program: o.wcal.clone().unwrap_or(beside),
        folder: o
            .keep
            .clone()
            .unwrap_or_else(|| scratch.path().to_path_buf()),
        jobs: o.jobs,
        timeout_s: o.timeout,
        follow_up: o.follow_up,
    };
    let printed = Mutex::new(());
    let results = examiner.examine(&orders, &|outcome| {
        let _one_line_at_a_time = printed.lock();
        println!("{}", line(outcome));
    });
    let mut outcomes = Vec::new();
    for (order, result) in orders.iter().zip(results) {
        match result {
            Ok(outcome) => outcomes.push(outcome),
            Err(error) => eprintln!("not drawn ({error}): {order:?}"),
        }
    }
    let table = summarise(&outcomes);
    println!();
    table
        .iter()
        .filter(|goal| goal.counts.1 > 0)
        .for_each(|goal| println!("{}", row(goal)));
    let noises = by_noise(&outcomes);
    println!("\n{}", noise_table(&noises));
    if let Some(path) = &o.json {
        let document = serde_json::json!({
            "format": "wcal-exam/1", "draws": o.draws, "seed": o.seed, "mix": o.mix, "only": o.only,
            "summary": table, "by_noise": noises, "cases": outcomes,
        });
        write(path, &document)?;
    }
    if let Some(path) = &o.record {
        write(path, &record(o, outcomes.len(), &table, &noises)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The audit of statements: one line a statement over all draws, and one a noise and layout.
fn audit(o: &ExamArgs, part: &str) -> anyhow::Result<ExitCode> {
    let scratch = tempfile::tempdir()?;
    let auditor = Auditor {
        program: o
            .wcal
            .clone()
            .unwrap_or(std::env::current_exe()?.with_file_name("wcal")),
        folder: o
            .keep
            .clone()
            .unwrap_or_else(|| scratch.path().to_path_buf()),
        jobs: o.jobs,
        widened: 1.0,
    };
    let asked = |name: &str| part == "all" || part == name;
    let of = |name: &str, rows: &dyn Fn() -> anyhow::Result<Vec<StatementRow>>| {
        if asked(name) { rows() } else { Ok(Vec::new()) }
    };
    let (draws, seed) = (o.draws, o.seed);
    let rows = of("scalars", &|| auditor.audit(&NOISES, &LAYOUTS, draws, seed))?;
    let whiskers = of("whiskers", &|| auditor.audit_whiskers(draws, seed))?;
    let tracks = of("tracks", &|| {
        auditor.audit_tracks(&TRACK_REGIMES, draws, seed)
    })?;
    let stereo = of("stereo", &|| auditor.audit_stereo(draws, PAIRS, seed))?;
    let maps = of("map", &|| auditor.audit_maps(draws, seed))?;
    let checks = of("checks", &|| auditor.audit_checks(draws, seed))?;
    println!("statement | noise | sweeps x readings | says | holds | of | 95 %");
    println!("---|---|---|---|---|---|---");
    for row in pooled(&rows)
        .iter()
        .chain(&whiskers)
        .chain(&tracks)
        .chain(&stereo)
        .chain(&maps)
        .chain(&checks)
        .chain(&rows)
    {
        let (k, n) = row.holds;
        let (low, high) = row.bounds();
        let [sweeps, places] = row.layout;
        let says = row
            .says
            .map_or_else(|| "-".to_owned(), |says| says.to_string());
        let layout = match [sweeps, places] {
            [0, _] => "all".to_owned(),
            [records, 0] => format!("{records} records"),
            _ => format!("{sweeps} x {places}"),
        };
        println!(
            "{} | {} | {layout} | {says} | {:.3} | {n} | [{low:.3}, {high:.3}]",
            row.statement,
            row.noise,
            k as f64 / n as f64
        );
    }
    if let Some(path) = &o.json {
        write(
            path,
            &serde_json::json!({"format": "wcal-statements/1", "simulated": true, "draws": o.draws, "seed": o.seed, "rows": rows, "whiskers": whiskers, "tracks": tracks, "stereo": stereo, "map": maps, "checks": checks}),
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn write(path: &Path, document: &serde_json::Value) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(document)? + "\n";
    std::fs::write(path, text).with_context(|| format!("writing {}", path.display()))
}

/// What a table may quote: who drew what when, and hits of trials of each row.
fn record(
    o: &ExamArgs,
    drawn: usize,
    table: &[Goal],
    noises: &[NoiseRow],
) -> anyhow::Result<serde_json::Value> {
    let git = |arguments: &[&str]| -> anyhow::Result<String> {
        let out = std::process::Command::new("git")
            .args(arguments)
            .output()
            .context("asking git for the commit")?;
        Ok(String::from_utf8_lossy(&out.stdout).trim().to_owned())
    };
    let changed = !git(&["status", "--porcelain", "--untracked-files=no"])?.is_empty();
    let rows = table.iter().filter(|g| g.counts.1 > 0);
    Ok(serde_json::json!({
        "format": "wcal-exam-record/1", "simulated": true,
        "date": jiff::Timestamp::now().strftime("%Y-%m-%d").to_string(),
        "commit": git(&["rev-parse", "--short=10", "HEAD"])?, "changed_since_commit": changed,
        "profile": if cfg!(debug_assertions) { "dev" } else { "release" },
        "mix": o.mix, "only": o.only, "rivals": !o.no_rivals, "draws": o.draws, "drawn": drawn, "seed": o.seed,
        "noises": noises.iter().map(|n| &n.noise).collect::<Vec<_>>(),
        "rows": rows.map(|g| serde_json::json!({
            "score": g.score, "goal": g.goal, "value": g.value, "bounds": g.bounds, "hits": g.counts.0, "trials": g.counts.1,
            "met": g.met, "open": g.open(),
        })).collect::<Vec<_>>(),
    }))
}

fn write_only(folder: &Path, orders: &[Order]) -> anyhow::Result<ExitCode> {
    let mut truth = serde_json::Map::new();
    for (i, order) in orders.iter().enumerate() {
        let name = format!("case-{:03}", i + 1);
        let case = order
            .draw()
            .with_context(|| format!("drawing {name}: {order:?}"))?;
        case.write(&folder.join(&name))?;
        let entry = case.truth()?;
        println!(
            "{name} {} {} {} {:.1} sigma",
            entry["design"].as_str().unwrap_or("line"),
            entry["label"],
            entry["noise"],
            entry["projected_size_in_noises"].as_f64().unwrap_or(0.0)
        );
        truth.insert(name, entry);
    }
    std::fs::write(
        folder.join("truth.json"),
        serde_json::to_string_pretty(&truth)?,
    )?;
    Ok(ExitCode::SUCCESS)
}

fn line(o: &Outcome) -> String {
    let number = |v: Option<f64>| v.map_or("-".into(), |v| format!("{v:.2}"));
    let contact = match (o.contact_before_ratio, o.contact_after_ratio) {
        (None, None) => String::new(),
        (before, after) => format!("contact {} {} ", number(before), number(after)),
    };
    let coverage = o.covered.map(|(k, n)| k as f64 / n as f64);
    format!(
        "{} {:9} {:19} {:45} delta {:6.1} rival {:>6} {:12} {:15} [{}] sets {} before {:>6} after {:>5} oracle {} cover {:>4} {contact}{:.1} s {}",
        o.name,
        o.design
            .map_or_else(|| "line".into(), |d| format!("{d:?}").to_lowercase()),
        format!(
            "{}{}",
            o.noise,
            if o.wire == Some(Make::Thin) {
                ", thin"
            } else {
                ""
            }
        ),
        if o.laws.is_empty() {
            o.label.clone()
        } else {
            o.laws.join("+")
        },
        o.delta,
        number(o.rival_sigma),
        format!("{:?}", o.kind),
        o.verdict,
        o.got.join(","),
        o.set_size,
        number(o.before_ratio),
        number(o.after_ratio),
        number(Some(o.oracle_ratio).filter(|v| v.is_finite())),
        number(coverage),
        o.seconds,
        o.follow_up.as_ref().map_or_else(
            || remarks(o),
            |f| format!(
                "later: {} [{}] {:?}, stated power {:.2} {}",
                f.verdict,
                f.got.join(","),
                f.kind,
                f.expected_power,
                f.why
            )
        )
    )
}

/// Flags that are not right, parts of the noise as put in and as stated, and what went wrong.
fn remarks(o: &Outcome) -> String {
    let mut out = o.why.clone();
    if o.flags_right == Some(false) {
        out += " flags wrong";
    }
    for p in o.parts.iter().filter(|p| p.value.is_some()) {
        out += &format!(
            " {} {:.2} of {:.2}",
            p.name,
            p.value.unwrap_or(f64::NAN),
            p.truth
        );
    }
    out
}

/// One row a kind of noise; shares as hits/trials.
fn noise_table(rows: &[NoiseRow]) -> String {
    let of = |c: (usize, usize)| {
        if c.1 == 0 {
            "-".into()
        } else {
            format!("{}/{}", c.0, c.1)
        }
    };
    let number = |v: f64| {
        if v.is_finite() {
            format!("{v:.2}")
        } else {
            "-".into()
        }
    };
    let mut out = format!(
        "{:16} {:>7} {:14} {:>8} {:>7} {:>7} {:>7} {:>6} {:>5} {:13} {:>9} {:>9} {:>18} {:>7} {}\n",
        "noise",
        "false",
        "names 95 %",
        "adequate",
        "unknown",
        "refused",
        "right",
        "wrong",
        "cover",
        "95 %",
        "after",
        "oracle",
        "stated/true floor",
        "flags",
        "parts: within 1.3 | inside interval"
    );
    for r in rows {
        let bounds = r
            .false_names_bounds
            .map_or("-".into(), |(a, b)| format!("[{a:.3}, {b:.3}]"));
        let (k, n) = r.covered;
        let (share, cover) = if n == 0 {
            ("-".into(), "-".into())
        } else {
            let (a, b) = clopper_pearson(k, n);
            (
                format!("{:.3}", k as f64 / n as f64),
                format!("[{a:.3}, {b:.3}]"),
            )
        };
        let parts: Vec<String> = r
            .parts
            .iter()
            .map(|(name, near, inside)| format!("{name} {} | {}", of(*near), of(*inside)))
            .collect();
        out += &format!(
            "{:16} {:>7} {:14} {:>8} {:>7} {:>7} {:>7} {:>6} {:>5} {:13} {:>9} {:>9} {:>18} {:>7} {}\n",
            r.noise,
            of(r.false_names),
            bounds,
            of(r.adequate),
            of(r.unknown),
            of(r.refused),
            of(r.right),
            of(r.wrong),
            share,
            cover,
            r.after_floor.map(number).join(" "),
            r.oracle_floor.map(number).join(" "),
            format!(
                "{} ({})",
                r.stated_floor.map(number).join(" "),
                of(r.states_floor)
            ),
            of(r.flags),
            parts.join("; ")
        );
    }
    out + "after, oracle: held-out error over the true noise of a loaded reading at a new pose, median and 95th percentile\n\
           stated/true floor: 5th percentile, median, 95th percentile (answers that state a floor)"
}

fn row(g: &Goal) -> String {
    let met = match g.met {
        Some(true) => "met ",
        Some(false) => "MISS",
        None if g.open() => "open",
        None => "    ",
    };
    let bounds = g
        .bounds
        .map_or(String::new(), |(a, b)| format!("[{a:.3}, {b:.3}]"));
    let value = format!("{:.3}", g.value);
    format!(
        "{met} {:58} {value:>8} {bounds:16} {:>5}/{:<5} goal {}",
        g.score, g.counts.0, g.counts.1, g.goal
    )
}
