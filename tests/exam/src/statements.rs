//! The audit of statements: sessions whose truth is known, and how often each kind of number that a
//! user reads holds. SIMULATED.
//!
//! ```text
//! interval, prediction: the truth lies inside;   p value: it lies below the level where nothing acts;
//! detectable size: with the effect at just that size, another recording of the instrument is not called adequate
//! ```

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::goal::clopper_pearson;
use anyhow::Context;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use serde_json::Value;
use wcal_plant::scalar::{
    self, EffectSize, Layout, ScalarCase, ScalarEffect, ScalarNoise, ScalarRequest, StatedLaw,
};

/// How often one kind of number held under one kind of noise and layout.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StatementRow {
    /// The number.
    pub statement: String,
    /// Share of cases in which it says that it holds; none where nothing is said of it.
    pub says: Option<f64>,
    /// Kind of noise.
    pub noise: &'static str,
    /// Sweeps of points.csv and readings of each.
    pub layout: [usize; 2],
    /// Cases in which it held, and cases.
    pub holds: (usize, usize),
}

/// The program under audit.
#[derive(Debug, Clone)]
pub struct Auditor {
    /// The program, `wcal`.
    pub program: PathBuf,
    /// Where sessions and results go.
    pub folder: PathBuf,
    /// Sessions at a time.
    pub jobs: usize,
    /// Stated half widths of predictions are multiplied by it before they are counted: 1, and
    /// another number for a control.
    pub widened: f64,
}

impl StatementRow {
    /// 95 % interval of the share (Clopper and Pearson).
    pub fn bounds(&self) -> (f64, f64) {
        clopper_pearson(self.holds.0, self.holds.1)
    }

    /// Whether the counts agree with what the number says, if anything.
    pub fn agrees(&self) -> bool {
        let (low, high) = self.bounds();
        self.says.is_none_or(|says| (low..=high).contains(&says))
    }
}

/// Kinds of noise that are drawn.
pub const NOISES: [ScalarNoise; 4] = [
    ScalarNoise::White,
    ScalarNoise::StudentT,
    ScalarNoise::Correlated,
    ScalarNoise::Rounded,
];
/// Few readings, some, many.
pub const LAYOUTS: [Layout; 3] = [
    Layout {
        sweeps: 3,
        places: 6,
    },
    Layout {
        sweeps: 4,
        places: 11,
    },
    Layout {
        sweeps: 6,
        places: 40,
    },
];
/// Size at which the parameters' intervals are counted, in noises.
const CLEAR: f64 = 20.0;
/// Level at which p values are counted.
const LEVEL: f64 = 0.05;

type Key = (String, &'static str, [usize; 2]);
type Tally = BTreeMap<Key, (Option<f64>, usize, usize)>;

/// One session and what is counted on it.
struct Draw {
    name: String,
    request: ScalarRequest,
    layout: Layout,
}

impl Auditor {
    /// Draws `draws` sessions of each noise and layout, half of them axes, and counts.
    ///
    /// # Errors
    /// Where a session cannot be written or the program cannot be started.
    pub fn audit(
        &self,
        noises: &[ScalarNoise],
        layouts: &[Layout],
        draws: usize,
        seed: u64,
    ) -> anyhow::Result<Vec<StatementRow>> {
        let counted = self.each(&orders(noises, layouts, draws, seed), |draw| {
            let layout = [draw.layout.sweeps, draw.layout.places];
            Ok(self
                .one(draw)?
                .into_iter()
                .map(|c| (c, draw.request.noise.name(), layout))
                .collect())
        })?;
        Ok(tallied(counted))
    }

    /// What is counted on each of these, some at a time.
    pub(crate) fn each<T: Sync>(
        &self,
        orders: &[T],
        one: impl Fn(&T) -> anyhow::Result<Vec<Labelled>> + Sync,
    ) -> anyhow::Result<Vec<Labelled>> {
        let (next, all, failed) = (
            AtomicUsize::new(0),
            Mutex::new(Vec::new()),
            Mutex::new(None),
        );
        std::thread::scope(|scope| {
            for _ in 0..self.jobs.max(1) {
                scope.spawn(|| {
                    while let Some(order) = orders.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let counted = one(order);
                        let (Ok(mut all), Ok(mut failed)) = (all.lock(), failed.lock()) else {
                            return;
                        };
                        match counted {
                            Ok(counted) => all.extend(counted),
                            Err(error) => *failed = Some(error),
                        }
                    }
                });
            }
        });
        match failed.into_inner().unwrap_or_default() {
            Some(error) => Err(error),
            None => Ok(all.into_inner().unwrap_or_default()),
        }
    }

    fn one(&self, draw: &Draw) -> anyhow::Result<Vec<Counted>> {
        let (case, verify) = self.verify(&draw.name, &draw.request)?;
        if draw.request.effect.is_some() {
            return Ok(parameters(&case, &verify));
        }
        let mut out = of_noise(&case, &verify);
        out.extend(of_null(&verify));
        if !case.axis
            && self
                .folder
                .join(&draw.name)
                .join("verify/calibration.json")
                .exists()
        {
            out.extend(self.predictions(draw, &case, &verify)?);
        }
        out.extend(self.detectable(draw, &verify)?);
        Ok(out)
    }

    /// Draws a session, and has the program verify it.
    fn verify(&self, name: &str, request: &ScalarRequest) -> anyhow::Result<(ScalarCase, Value)> {
        let (case, folder) = (scalar::draw(request), self.folder.join(name));
        case.write(&folder)?;
        let out = folder.join("verify");
        self.run(&[
            "verify".as_ref(),
            folder.as_ref(),
            "--out".as_ref(),
            out.as_ref(),
            "--force".as_ref(),
        ])?;
        let text = std::fs::read_to_string(out.join("verify.json"))
            .with_context(|| format!("reading what verify says of {name}"))?;
        Ok((case, serde_json::from_str(&text)?))
    }

    pub(crate) fn run(&self, arguments: &[&std::ffi::OsStr]) -> anyhow::Result<()> {
        let status = Command::new(&self.program)
            .args(arguments)
            .args(["--json"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        status
            .map(|_| ())
            .with_context(|| format!("starting {}", self.program.display()))
    }

    /// Readings of another sweep inside their stated half widths, and the error that the first page
    /// states.
    fn predictions(
        &self,
        draw: &Draw,
        case: &ScalarCase,
        verify: &Value,
    ) -> anyhow::Result<Vec<Counted>> {
        let folder = self.folder.join(&draw.name);
        let (table, out) = (folder.join("another.csv"), folder.join("predicted.csv"));
        let calibration = folder.join("verify/calibration.json");
        let n = draw.layout.places;
        let step = 1.0 / (n - 1) as f64;
        // At the places of the session, and between them; the ends are places, too.
        let parts: Vec<f64> = (0..n)
            .map(|k| k as f64 * step)
            .chain((0..n - 1).map(|k| (k as f64 + 0.5) * step))
            .collect();
        let sweep = case.another_sweep(&parts, draw.request.seed);
        let rows: String = sweep.iter().map(|r| format!("{:.9}\n", r.x)).collect();
        std::fs::write(&table, format!("stimulus\n{rows}"))?;
        self.run(&[
            "predict".as_ref(),
            table.as_ref(),
            "--calibration".as_ref(),
            calibration.as_ref(),
            "--out".as_ref(),
            out.as_ref(),
            "--force".as_ref(),
        ])?;
        let mut reader = csv::Reader::from_path(&out)?;
        let mut counted = Vec::new();
        let mut squares = 0.0;
        for (k, record) in reader.deserialize::<BTreeMap<String, f64>>().enumerate() {
            let record = record?;
            let (value, half) = (record["response"], self.widened * record["response_half95"]);
            let place = match k {
                _ if k == 0 || k == n - 1 => "at the ends",
                _ if k < n => "at places",
                _ => "between places",
            };
            counted.push(Counted::new(
                format!("prediction {place}: new reading inside half95"),
                0.95,
                (sweep[k].y - value).abs() <= half,
            ));
            squares += if k < n {
                (sweep[k].clean - value).powi(2)
            } else {
                0.0
            };
        }
        // What a new sweep over the same places is off by, in the mean over its noise.
        let error = (case.reading_sd().powi(2) + squares / n as f64).sqrt();
        counted.extend(holds(
            "after.interval95: error of a new sweep",
            &verify["after"]["interval95"]["response_rmse"],
            error,
        ));
        Ok(counted)
    }

    /// Each effect acts at just the size that the clean session says it would find.
    fn detectable(&self, draw: &Draw, verify: &Value) -> anyhow::Result<Vec<Counted>> {
        let mut out = Vec::new();
        for effect in ScalarEffect::ALL {
            let stated = verify["detectable"]
                .as_array()
                .into_iter()
                .flatten()
                .find(|d| d["id"] == effect.name());
            let Some((smallest, law)) =
                stated.and_then(|d| Some((d["smallest"].as_f64()?, stated_law(d)?)))
            else {
                continue;
            };
            let request = ScalarRequest {
                effect: Some(effect),
                size: EffectSize::Stated(smallest, law),
                noise_seed: Some(draw.request.seed ^ 0x0dec_7ab1),
                ..draw.request
            };
            let (_, planted) =
                self.verify(&format!("{}-{}", draw.name, effect.name()), &request)?;
            let said: Vec<&str> = planted["effects"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(|e| e["id"].as_str())
                .collect();
            let among = |list: &Value| {
                list.as_array()
                    .into_iter()
                    .flatten()
                    .any(|c| c == effect.name())
            };
            let found = said.contains(&effect.name())
                || planted["effects"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .any(|e| among(&e["class"]))
                || planted["alternatives"]
                    .as_array()
                    .into_iter()
                    .flatten()
                    .any(among);
            let name = effect.name();
            let shows = planted["verdict"] != "adequate";
            out.push(Counted::new(
                format!("detectable.smallest: {name} not called adequate"),
                0.9,
                shows,
            ));
            let named = format!("at that size {name} is named, alone or among others");
            out.push(Counted::new(named, 0.0, found).unsaid());
        }
        Ok(out)
    }
}

/// One number that was stated and whether it held.
pub(crate) struct Counted {
    statement: String,
    says: Option<f64>,
    held: bool,
}

/// With its kind of noise and its layout.
pub(crate) type Labelled = (Counted, &'static str, [usize; 2]);

impl Counted {
    pub(crate) fn new(statement: impl Into<String>, says: f64, held: bool) -> Self {
        Self {
            statement: statement.into(),
            says: Some(says),
            held,
        }
    }

    /// Counted, though the program does not say that it holds.
    pub(crate) fn unsaid(self) -> Self {
        Self { says: None, ..self }
    }

    /// The same of a kind of instrument.
    pub(crate) fn of(self, kind: &str) -> Self {
        Self {
            statement: format!("{kind}, {}", self.statement),
            ..self
        }
    }
}

/// 95 % quantile of chi2 with three degrees of freedom.
const CHI2_95: f64 = 7.815;

/// Whether the 95 % ellipsoid of a covariance holds an error.
pub(crate) fn in_ellipsoid(off: &Vector3<f64>, covariance: Matrix3<f64>) -> bool {
    let root = covariance.cholesky();
    root.is_some_and(|c| off.dot(&c.solve(off)) <= CHI2_95)
}

/// One row a statement, noise and layout.
pub(crate) fn tallied(counted: Vec<Labelled>) -> Vec<StatementRow> {
    let mut tally = Tally::new();
    for (counted, noise, layout) in counted {
        let entry = tally
            .entry((counted.statement, noise, layout))
            .or_insert((counted.says, 0, 0));
        entry.1 += usize::from(counted.held);
        entry.2 += 1;
    }
    let row = |((statement, noise, layout), (says, k, n))| StatementRow {
        statement,
        says,
        noise,
        layout,
        holds: (k, n),
    };
    tally.into_iter().map(row).collect()
}

/// The law of a stated size; none where the plant does not have it.
fn stated_law(d: &Value) -> Option<StatedLaw> {
    let of = |name: &str| d["shape"][name].as_f64();
    Some(match d["law"].as_str()? {
        "play" => StatedLaw::Play,
        "over-time" => StatedLaw::WaveOverTime(of("period")?),
        "over-stimulus" | "over-position" => StatedLaw::WaveOverStimulus(of("period")?),
        "once" => StatedLaw::From(of("place")?),
        "linear" | "power-2" => StatedLaw::Only,
        _ => return None,
    })
}

/// Whether a stated 95 % interval holds the truth; none where none is stated.
pub(crate) fn holds(statement: &str, interval: &Value, truth: f64) -> Option<Counted> {
    let end = |k: usize| interval[k].as_f64();
    let inside = (end(0)?..=end(1)?).contains(&truth);
    Some(Counted::new(statement, 0.95, inside))
}

fn of_noise(case: &ScalarCase, verify: &Value) -> Vec<Counted> {
    let noise = &verify["noise"];
    let white = case.truth.rho == 0.0;
    let repeat = holds(
        "noise.repeat.interval95: sd of a reading",
        &noise["repeat"]["interval95"],
        case.reading_sd(),
    );
    let correlated = holds(
        "noise.correlated.interval95: its sd",
        &noise["correlated"]["interval95"],
        case.truth.noise_sd,
    );
    repeat
        .filter(|_| white)
        .into_iter()
        .chain(correlated.filter(|_| !white))
        .collect()
}

/// Where nothing acts: p values, the verdict, and the error that is expected beside the one that is
/// stated.
pub(crate) fn of_null(verify: &Value) -> Vec<Counted> {
    let omnibus = verify["reason"].as_str().and_then(|r| {
        r.split_once("omnibus p = ")?
            .1
            .split(')')
            .next()?
            .parse::<f64>()
            .ok()
    });
    let replicates = verify["tests"]
        .as_array()
        .into_iter()
        .flatten()
        .filter_map(|t| t["p"].as_f64())
        .next();
    let below =
        |statement: &str, p: Option<f64>| p.map(|p| Counted::new(statement, LEVEL, p < LEVEL));
    let named = Counted::new(
        "a session in which nothing acts is not called adequate",
        0.025,
        verify["verdict"] != "adequate",
    );
    let listed = [
        below("omnibus p below .05 where nothing acts", omnibus),
        below("replicates p below .05 where nothing acts", replicates),
        below(
            "holdout.p below .05 where nothing acts",
            verify["holdout"]["p"].as_f64(),
        ),
    ];
    let after = &verify["after"];
    let key = ["wavelength_rmse_pm", "response_rmse", "error_rmse_um"];
    let expected = key.iter().find_map(|key| {
        holds(
            "after.expected inside after.interval95",
            &after["interval95"][key],
            after["expected"][key].as_f64()?,
        )
    });
    listed
        .into_iter()
        .flatten()
        .chain([named])
        .chain(expected)
        .collect()
}

fn parameters(case: &ScalarCase, verify: &Value) -> Vec<Counted> {
    let mut out = Vec::new();
    for effect in verify["effects"]
        .as_array()
        .into_iter()
        .flatten()
        .filter(|e| e["id"] == case.truth.label)
    {
        for p in effect["parameters"].as_array().into_iter().flatten() {
            let Some(truth) = p["name"]
                .as_str()
                .and_then(|n| case.truth.parameters.get(n))
            else {
                continue;
            };
            let statement = format!(
                "parameter of {}: {}",
                case.truth.label,
                p["name"].as_str().unwrap_or_default()
            );
            // Signs are a matter of direction.
            let ends: Vec<f64> = p["interval95"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(Value::as_f64)
                .collect();
            let [low, high] = ends[..] else { continue };
            let held = (low..=high).contains(truth) || (low..=high).contains(&-truth);
            out.push(Counted::new(statement, 0.95, held));
        }
    }
    out
}

/// Of each noise and layout: clean sessions, and as many with an effect that is clear.
fn orders(noises: &[ScalarNoise], layouts: &[Layout], draws: usize, seed: u64) -> Vec<Draw> {
    let mut out = Vec::new();
    for &noise in noises {
        for &layout in layouts {
            for k in 0..2 * draws {
                let effect = (k >= draws).then(|| ScalarEffect::ALL[k % ScalarEffect::ALL.len()]);
                let number = out.len();
                let request = ScalarRequest {
                    seed: seed.wrapping_mul(1_000_003).wrapping_add(number as u64),
                    axis: k % 2 == 1,
                    noise,
                    effect,
                    size: EffectSize::Noises(CLEAR),
                    layout: Some(layout),
                    noise_seed: None,
                };
                out.push(Draw {
                    name: format!("draw-{number:05}"),
                    request,
                    layout,
                });
            }
        }
    }
    out
}

/// Rows of the same statement and noise over all layouts, and over everything, before the rows
/// themselves.
pub fn pooled(rows: &[StatementRow]) -> Vec<StatementRow> {
    let mut of: BTreeMap<&str, StatementRow> = BTreeMap::new();
    for row in rows {
        let all = of.entry(&row.statement).or_insert_with(|| StatementRow {
            noise: "all",
            layout: [0, 0],
            holds: (0, 0),
            ..row.clone()
        });
        all.holds = (all.holds.0 + row.holds.0, all.holds.1 + row.holds.1);
    }
    of.into_values().collect()
}
