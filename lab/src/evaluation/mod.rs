//! A trained tracker beside the baselines, on sweeps that it did not see. All of it is SIMULATED.
//!
//! [`evaluate`] scores every method on the sweeps of a dataset, and on sweeps that are drawn on the
//! spot: on the virtual bench (`virtual_bench`, `on_bench`) and over the objects set aside for
//! tests (`test_objects`). The caller reads model and sweeps, calibrates the bench's session as a
//! user would ([`Surroundings::calibrate`]) and writes the [`EvaluationDocument`].

pub mod document;
mod on_bench;
mod request;
mod test_objects;
mod virtual_bench;

pub use document::{EvaluationDocument, FORMAT};
pub use request::{BenchCalibration, Calibrate, Model, Order, Sets, Surroundings};

use crate::LabError;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::model_file::Card;
use crate::sweep_series::SweepSeries;
use document::{Bootstrap, Means, MethodRow, Simulation};
use request::meshes;
use wcal_network::filter::BayesSettings;
use wcal_network::{InverseGrid, StaticInverse};

/// The best method, whose errors stand for the tracker.
const BEST: &str = "network, speed known";

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
            scores.push(MethodScores {
                set,
                method: name,
                objects,
            });
        }
    }
    let mut document = simulation(&scores, card, around);
    if !order.simulation_only {
        let (real, known_motion) = on_bench::on_bench(model, order, around)?;
        (document.virtual_real, document.known_motion) = (Some(real), known_motion);
        document.test_objects = Some(test_objects::table(
            (tracker, &card.whisker),
            order,
            around.progress,
        )?);
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
    card: &Card,
    around: &Surroundings<'_>,
) -> EvaluationDocument {
    let of = |set: &str| {
        scores
            .iter()
            .find(|s| s.set == set && s.method == BEST)
            .map_or(&[][..], |s| &s.objects[..])
    };
    let means = Means::of(of("seen"), of("unseen"));
    let scored = scores.iter().filter(|s| !s.objects.is_empty());
    EvaluationDocument {
        format: FORMAT,
        simulated: true,
        model: card.weights_sha256.clone(),
        calibration: None,
        simulation: Simulation {
            method: BEST,
            means,
        },
        bootstrap: Bootstrap::default(),
        methods: scored
            .map(|s| MethodRow::of(s.set, s.method, &s.objects))
            .collect(),
        provenance: around.provenance.clone(),
        known_motion: None,
        virtual_real: None,
        test_objects: None,
    }
}
