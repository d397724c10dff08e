//! A trained tracker beside the baselines, on sweeps that it did not see. All of it is SIMULATED.
//!
//! [`evaluate`] scores every method on the sweeps of a dataset, times one sample, and makes the tables that draw their
//! own sweeps: the virtual bench (`virtual_bench`, `tables`) and the objects set aside for tests (`test_objects`). The caller reads model and
//! sweeps, calibrates the bench's session as a user would ([`Surroundings::calibrate`]) and writes the [`EvaluationDocument`].

pub mod document;
mod tables;
mod test_objects;
mod virtual_bench;
mod work;

pub use document::{EvaluationDocument, FORMAT};
pub use tables::slope_s;

use crate::LabError;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::model_file::Card;
use crate::sweep_series::SweepSeries;
use document::{Bootstrap, Means, MethodRow, Simulation, Streaming};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::time::Instant;
use wcal_calibration::CalibrationModel;
use wcal_core::provenance::Provenance;
use wcal_core::verify_document::{GrooveTracking, Verdict};
use wcal_sim::{Mesh, objects};
use wcal_track::filter::{BayesSettings, FilterBank};
use wcal_track::{InverseGrid, Sample, StaticInverse, Tracker};
use work::{EvaluationProgress, STREAMING, cost};

/// The best method, whose errors stand for the tracker.
const BEST: &str = "network, speed known";

/// What is evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Model<'a> {
    /// Network.
    pub tracker: &'a Tracker,
    /// Its card.
    pub card: &'a Card,
}

/// Series of the objects that were trained on (sweeps that were kept back) and of those that were not.
#[derive(Debug, Clone)]
pub struct Sets {
    /// Seen objects.
    pub seen: BTreeMap<String, Vec<SweepSeries>>,
    /// Unseen objects.
    pub unseen: BTreeMap<String, Vec<SweepSeries>>,
}

impl Sets {
    fn named(&self) -> [(&'static str, &BTreeMap<String, Vec<SweepSeries>>); 2] {
        [("seen", &self.seen), ("unseen", &self.unseen)]
    }

    fn series(&self) -> [Vec<&SweepSeries>; 2] {
        [&self.seen, &self.unseen].map(|set| set.values().flatten().collect())
    }
}

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Order<'a> {
    /// Folder of the objects' STL files; built-in objects need none.
    pub meshes: Option<&'a Path>,
    /// Objects of each kind at most.
    pub objects: usize,
    /// Sweeps over each object at most.
    pub sweeps_each: usize,
    /// Seed of the virtual bench and of the sweeps that are drawn on the spot.
    pub seed: u64,
    /// No tables over speed, medium and noise.
    pub quick: bool,
    /// No tables that draw sweeps.
    pub simulation_only: bool,
}

/// From the folder of the virtual bench's session to its calibration.
pub type Calibrate<'a> = dyn Fn(&Path) -> Result<BenchCalibration, Box<dyn Error + Send + Sync>> + 'a;

/// What the caller supplies: the commands that an evaluation uses, and where it speaks.
pub struct Surroundings<'a> {
    /// The virtual bench's session calibrated by `fit-gpr` and `verify`.
    pub calibrate: &'a Calibrate<'a>,
    /// Filters that know the noise of moments through a calibration.
    pub filters_for: fn(FilterBank, &CalibrationModel) -> FilterBank,
    /// Stage, and share of the work that is done.
    pub progress: &'a dyn Fn(&str, f64),
    /// Remarks.
    pub note: &'a dyn Fn(&str),
    /// Inputs and program.
    pub provenance: Provenance,
}

/// Calibrations of one session of the virtual bench.
#[derive(Debug, Clone)]
pub struct BenchCalibration {
    /// The map of `fit-gpr`, as if no effect had been found.
    pub map: CalibrationModel,
    /// The maps of each kind that `fit-gpr` can choose from, by name.
    pub maps: Vec<(&'static str, CalibrationModel)>,
    /// The sensitivity with the effects that `verify` accepted, where it vouches for one.
    pub verified: Option<CalibrationModel>,
    /// What `verify` said.
    pub verdict: Verdict,
    /// Effects that it accepted.
    pub accepted: Vec<String>,
    /// The tracker on the groove of the session, whose motion is known, beside its bound.
    pub groove: Option<GrooveTracking>,
}

impl BenchCalibration {
    /// The one that a user would take.
    fn best(&self) -> &CalibrationModel {
        self.verified.as_ref().unwrap_or(&self.map)
    }
}

/// Scores of a method on a set, object by object.
#[derive(Debug, Clone)]
pub struct MethodScores {
    /// Set.
    pub set: &'static str,
    /// Method.
    pub method: &'static str,
    /// By object.
    pub objects: Vec<ObjectScores>,
}

/// Evaluates a model: the document, and the scores of its methods.
///
/// # Errors
/// Where meshes are missing, or the virtual bench cannot be drawn, calibrated or tracked.
pub fn evaluate(
    model: &Model<'_>,
    sets: &Sets,
    order: &Order<'_>,
    around: &Surroundings<'_>,
) -> Result<(EvaluationDocument, Vec<MethodScores>), LabError> {
    let (tracker, card) = (model.tracker, model.card);
    let fine = StaticInverse::new(&card.whisker, InverseGrid::default())?;
    let multi_mu = BayesSettings::multi_mu();
    let methods = methods(model, &fine, &multi_mu);
    let count = sets.series().map(|set| set.len() as f64);
    let tables = tables::cost(card, order) + test_objects::cost(order);
    let each = methods.iter().map(|m| cost(&m.1)).sum();
    let work = EvaluationProgress::new(around.progress, count.iter().sum(), each, tables);

    let mut scores = Vec::new();
    for (k, (set, all_series)) in sets.named().into_iter().enumerate() {
        let meshes = meshes(all_series.keys(), order.meshes, around.note)?;
        for (name, method) in &methods {
            work.next(&format!("{name}, {set} objects"), count[k] * cost(method));
            let objects = score_objects(&|c: &SweepSeries| method.run(c), all_series, &meshes)?;
            scores.push(MethodScores { set, method: name, objects });
        }
    }
    work.next("time of one sample", STREAMING);
    let streaming = streaming(tracker, sets.series().into_iter().flatten());
    let mut document = simulation(&scores, streaming, order, card, around);
    if !order.simulation_only {
        let folder =
            tempfile::tempdir().map_err(LabError::file("making a folder in", &std::env::temp_dir()))?;
        let maker = tables::BenchEvaluator {
            tracker,
            card,
            order,
            around,
            folder: folder.path(),
            work: &work,
            curve: &fine,
        };
        document.tables = Some(maker.tables()?);
        document.test_objects = Some(test_objects::table((tracker, &card.whisker), order, &work)?);
    }
    Ok((document, scores))
}

/// The network, and what it is measured against.
fn methods<'a>(
    model: &Model<'a>,
    fine: &'a StaticInverse,
    multi_mu: &'a BayesSettings,
) -> Vec<(&'static str, Method<'a>)> {
    // Two thirds out: the middle of what sweeps touch.
    let middle = fine.nodes.last().map_or(40.0, |n| n.arclength_mm) * 2.0 / 3.0;
    vec![
        (BEST, Method::Network(model.tracker, true)),
        ("network", Method::Network(model.tracker, false)),
        ("bayes, speed known", Method::Bayes(fine, true, multi_mu)),
        ("bayes", Method::Bayes(fine, false, multi_mu)),
        ("static inverse", Method::Static(fine, middle)),
        ("constant", Method::Constant([middle, 0.0, 0.0].into())),
    ]
}

/// The document with what is known of the sweeps of the dataset.
fn simulation(
    scores: &[MethodScores],
    streaming: Streaming,
    order: &Order<'_>,
    card: &Card,
    around: &Surroundings<'_>,
) -> EvaluationDocument {
    let of = |set: &str| {
        scores.iter().find(|s| s.set == set && s.method == BEST).map_or(&[][..], |s| &s.objects[..])
    };
    let means = Means::of(of("seen"), of("unseen"));
    let scored = scores.iter().filter(|s| !s.objects.is_empty());
    EvaluationDocument {
        format: FORMAT,
        simulated: true,
        quick: order.quick,
        model: card.weights_sha256.clone(),
        calibration: None,
        simulation: Simulation { method: BEST, means },
        bootstrap: Bootstrap::default(),
        methods: scored.map(|s| MethodRow::of(s.set, s.method, &s.objects)).collect(),
        streaming,
        provenance: around.provenance.clone(),
        tables: None,
        test_objects: None,
    }
}

/// The meshes of objects; remarks on them go to `note`.
fn meshes<'a>(
    names: impl Iterator<Item = &'a String>,
    folder: Option<&Path>,
    note: &dyn Fn(&str),
) -> Result<BTreeMap<String, Mesh>, LabError> {
    names
        .map(|name| {
            let mesh = objects::named(name, folder)
                .map_err(|source| LabError::Mesh { name: name.clone(), source })?;
            for remark in &mesh.notes {
                note(&format!("warning: object {name}: {remark}"));
            }
            Ok((name.clone(), mesh))
        })
        .collect()
}

/// Samples a second on one core, one by one, and the slowest of a hundred.
fn streaming<'a>(tracker: &Tracker, all_series: impl Iterator<Item = &'a SweepSeries>) -> Streaming {
    const SAMPLES: usize = 1000;
    let mut times_us: Vec<f64> = Vec::new();
    for series in all_series {
        let mut stream = tracker.stream();
        for i in &series.samples {
            let sample = Sample { t_s: i.t_s, moment_nmm: i.moment_nmm, base_mm_s: Some(i.speed_mm_s) };
            let begin = Instant::now();
            std::hint::black_box(stream.push(&sample));
            times_us.push(begin.elapsed().as_secs_f64() * 1e6);
        }
        if times_us.len() > SAMPLES {
            break;
        }
    }
    times_us.sort_by(f64::total_cmp);
    let total: f64 = times_us.iter().sum();
    let p99 = times_us.get(times_us.len() * 99 / 100).copied().unwrap_or(0.0);
    Streaming { samples_per_s: (times_us.len() as f64 / total * 1e6).round(), p99_us: p99.round() }
}
