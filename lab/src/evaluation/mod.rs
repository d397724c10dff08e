//! A trained tracker beside the baselines, on sweeps that it did not see. All of it is SIMULATED.
//!
//! [`evaluate`] scores every method on the sweeps of a dataset, and on sweeps that are drawn on the spot: on the virtual bench
//! (`virtual_bench`, `on_bench`) and over the objects set aside for tests (`test_objects`). The caller reads model and
//! sweeps, calibrates the bench's session as a user would ([`Surroundings::calibrate`]) and writes the [`EvaluationDocument`].

pub mod document;
mod on_bench;
mod test_objects;
mod virtual_bench;

pub use document::{EvaluationDocument, FORMAT};

use crate::LabError;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::model_file::Card;
use crate::sweep_series::SweepSeries;
use document::{Bootstrap, Means, MethodRow, Simulation};
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use wcal_calibration::CalibrationModel;
use wcal_core::provenance::Provenance;
use wcal_core::verify_document::{GrooveTracking, Verdict};
use wcal_lab_sweeps::objects;
use wcal_sim::Mesh;
use wcal_track::filter::{BayesSettings, FilterBank};
use wcal_track::{InverseGrid, StaticInverse, Tracker};

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
    /// Stages.
    pub progress: &'a dyn Fn(&str),
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
    let mut scores = Vec::new();
    for (set, all_series) in sets.named() {
        let meshes = meshes(all_series.keys(), order.meshes, around.note)?;
        for (name, method) in &methods {
            (around.progress)(&format!("{name}, {set} objects"));
            let objects = score_objects(&|c: &SweepSeries| method.run(c), all_series, &meshes)?;
            scores.push(MethodScores { set, method: name, objects });
        }
    }
    let mut document = simulation(&scores, card, around);
    if !order.simulation_only {
        let (real, known_motion) = on_bench::on_bench(model, order, around)?;
        (document.virtual_real, document.known_motion) = (Some(real), known_motion);
        document.test_objects = Some(test_objects::table((tracker, &card.whisker), order, around.progress)?);
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
fn simulation(scores: &[MethodScores], card: &Card, around: &Surroundings<'_>) -> EvaluationDocument {
    let of = |set: &str| {
        scores.iter().find(|s| s.set == set && s.method == BEST).map_or(&[][..], |s| &s.objects[..])
    };
    let means = Means::of(of("seen"), of("unseen"));
    let scored = scores.iter().filter(|s| !s.objects.is_empty());
    EvaluationDocument {
        format: FORMAT,
        simulated: true,
        model: card.weights_sha256.clone(),
        calibration: None,
        simulation: Simulation { method: BEST, means },
        bootstrap: Bootstrap::default(),
        methods: scored.map(|s| MethodRow::of(s.set, s.method, &s.objects)).collect(),
        provenance: around.provenance.clone(),
        known_motion: None,
        virtual_real: None,
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
