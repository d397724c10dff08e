//! Trackers over series: the network and the baselines, object by object. All of it is SIMULATED.

use crate::LabError;
use crate::score::{Detection, EstimateError, Scores, SweepSums, detection, scores};
use crate::sweep_series::SweepSeries;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use wcal_mesh::Mesh;
use wcal_network::filter::{BayesFilter, BayesSettings, FilterBank};
use wcal_network::inverse::StaticInverse;
use wcal_network::network::Prediction;
use wcal_network::tracker::{Sample, Tracker};

/// An estimate at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Whether there is a contact.
    pub contact: bool,
    /// Where it is, or would be, mm.
    pub point_mm: Vector3<f64>,
    /// Covariance, mm^2.
    pub covariance_mm2: Option<Matrix3<f64>>,
}

/// Who estimates.
#[derive(Debug, Clone, Copy)]
pub enum Method<'a> {
    /// The network; `true`: the base's speed is known to it.
    Network(&'a Tracker, bool),
    /// The Bayes filter; `true`: the base's speed is known to it.
    Bayes(&'a StaticInverse, bool, &'a BayesSettings),
    /// The static inverse at one arc length, mm.
    Static(&'a StaticInverse, f64),
    /// One place, mm.
    Constant(Vector3<f64>),
}

/// Probability from which on a contact is called.
const CONTACT_PROBABILITY: f32 = 0.5;
/// Moment from which on the methods without a probability call a contact, N mm.
const CONTACT_NMM: f64 = 0.01;

impl Method<'_> {
    /// Whether the base's speed is known to it.
    pub fn speed_known(&self) -> bool {
        matches!(self, Self::Network(_, true) | Self::Bayes(_, true, _))
    }

    /// Estimates at all instants of a series, made from what came before each.
    pub fn run(&self, series: &SweepSeries) -> Vec<Estimate> {
        let size = |m: [f64; 2]| m[0].hypot(m[1]);
        match self {
            Self::Network(tracker, known) => {
                network_estimates(tracker, tracker.filters, series, *known)
            }
            Self::Bayes(inverse, known, settings) => {
                let mut filter = BayesFilter::new(inverse, **settings);
                let mut last_s = 0.0;
                let mut last = static_point(inverse, [0.0; 2], 40.0);
                let step = |i: &crate::sweep_series::SweepSample| {
                    let dt = i.t_s - std::mem::replace(&mut last_s, i.t_s);
                    filter.step(dt, i.moment_nmm, known.then_some(i.speed_mm_s), None);
                    let belief = belief(&filter, settings.constraint_sd_mm);
                    last = belief.map_or(last, |b| b.0);
                    Estimate {
                        contact: belief.is_some(),
                        point_mm: last,
                        covariance_mm2: belief.map(|b| b.1),
                    }
                };
                series.samples.iter().map(step).collect()
            }
            Self::Static(inverse, arclength_mm) => series
                .samples
                .iter()
                .map(|i| Estimate {
                    contact: size(i.moment_nmm) > CONTACT_NMM,
                    point_mm: static_point(inverse, i.moment_nmm, *arclength_mm),
                    covariance_mm2: None,
                })
                .collect(),
            Self::Constant(point_mm) => series
                .samples
                .iter()
                .map(|i| Estimate {
                    contact: size(i.moment_nmm) > CONTACT_NMM,
                    point_mm: *point_mm,
                    covariance_mm2: None,
                })
                .collect(),
        }
    }
}

/// Posterior mean and covariance of a filter's contact, none where it has none:
/// p = sum w_k p_k, C = sum w_k (p_k - p)(p_k - p)^T + var_c I, sd_c of the constraint.
fn belief(filter: &BayesFilter<'_>, constraint_sd_mm: f64) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let posterior = filter.posterior();
    let total: f64 = posterior.iter().sum();
    if !(total > 0.0) {
        return None;
    }
    let places = || {
        let solutions = filter.solutions().iter().map(|s| s.point_mm);
        posterior.iter().map(|w| w / total).zip(solutions)
    };
    let point: Vector3<f64> = places().map(|(w, p)| p * w).sum();
    let mut covariance = Matrix3::identity() * constraint_sd_mm.powi(2);
    for (w, p) in places() {
        let off = p - point;
        covariance += off * off.transpose() * w;
    }
    Some((point, covariance))
}

fn network_estimates(
    tracker: &Tracker,
    filters: FilterBank,
    series: &SweepSeries,
    known: bool,
) -> Vec<Estimate> {
    let sample = |i: &crate::sweep_series::SweepSample| Sample {
        t_s: i.t_s,
        moment_nmm: i.moment_nmm,
        base_mm_s: known.then_some(i.speed_mm_s),
    };
    let samples: Vec<Sample> = series.samples.iter().map(sample).collect();
    let answer = |p: Prediction| Estimate {
        contact: p.contact >= CONTACT_PROBABILITY,
        point_mm: Vector3::from(p.point_mm.map(f64::from)),
        covariance_mm2: (tracker.config.nodes > 0)
            .then(|| Matrix3::from_fn(|i, j| f64::from(p.covariance_mm2[i][j]))),
    };
    track_series(tracker, filters, &samples)
        .into_iter()
        .map(answer)
        .collect()
}

/// All answers of a series, each from what came before it, through these filters.
pub fn track_series(tracker: &Tracker, filters: FilterBank, samples: &[Sample]) -> Vec<Prediction> {
    let mut stream = tracker.stream_with(filters);
    samples.iter().map(|sample| stream.push(sample)).collect()
}

fn static_point(inverse: &StaticInverse, moment_nmm: [f64; 2], arclength_mm: f64) -> Vector3<f64> {
    let mut solutions = Vec::new();
    inverse.solutions(moment_nmm, &mut solutions);
    let off = |k: &usize| (inverse.nodes[*k].arclength_mm - arclength_mm).abs();
    let nearest = (0..solutions.len())
        .min_by(|a, b| off(a).total_cmp(&off(b)))
        .unwrap_or(0);
    solutions[nearest].point_mm
}

/// What a method gave on the series over one object.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ObjectScores {
    /// Object.
    pub name: String,
    /// All samples with contact.
    pub all: Scores,
    /// Those at least `SETTLING_MM` of the base's travel after an onset, jump or slip.
    pub followed: Scores,
    /// Contact or not.
    pub detection: Detection,
    /// Errors sweep by sweep, for intervals.
    #[serde(skip)]
    pub sweeps: Vec<SweepSums>,
}

/// Travel of the base after which the motion can have determined a new contact, mm.
pub const SETTLING_MM: f64 = 2.0;

/// Contact or not, at every sample: called and true.
pub type Calls = Vec<(bool, bool)>;

/// Errors of a series' estimates where there is contact, and whether the contact has been followed
/// for a while.
pub fn compare_with_truth(
    series: &SweepSeries,
    mesh: &Mesh,
    estimates: &[Estimate],
) -> (Vec<(EstimateError, bool)>, Calls) {
    let (mut compared, mut calls) = (Vec::new(), Vec::new());
    let (mut since_mm, mut before): (f64, Option<Vector3<f64>>) = (0.0, None);
    for (now, estimate) in series.samples.iter().zip(estimates) {
        calls.push((estimate.contact, now.contact.is_some()));
        if ["onset", "jump", "slip"].contains(&now.event.as_str()) {
            since_mm = now.travel_mm;
        }
        let Some(truth) = now.contact else {
            before = None;
            continue;
        };
        let path = before.map_or(Vector3::zeros(), |b| truth.point_mm - b);
        before = Some(truth.point_mm);
        let surface_mm = series.surface_distance_mm(mesh, now.travel_mm, &estimate.point_mm);
        let off = estimate.point_mm - truth.point_mm;
        let error = EstimateError::new(surface_mm, off, &path, estimate.covariance_mm2.as_ref());
        compared.push((error, now.travel_mm - since_mm >= SETTLING_MM));
    }
    (compared, calls)
}

/// Errors of the network's places with their stated spreads where there is contact, with the
/// object's name.
pub fn held_out_regions(
    tracker: &Tracker,
    all_series: &[SweepSeries],
    base_known: bool,
) -> Vec<(String, EstimateError)> {
    let all = all_series
        .par_iter()
        .flat_map_iter(|c| regions(tracker, tracker.filters, c, base_known));
    all.collect()
}

/// The same over one series, with other filters (measurement noise).
pub fn regions(
    tracker: &Tracker,
    filters: FilterBank,
    series: &SweepSeries,
    base_known: bool,
) -> Vec<(String, EstimateError)> {
    let estimates = network_estimates(tracker, filters, series, base_known);
    let both = series.samples.iter().zip(&estimates);
    both.filter_map(|(i, e)| Some((i.contact?, e)))
        .map(|(c, e)| {
            let off = e.point_mm - c.point_mm;
            let one = EstimateError::new(0.0, off, &Vector3::zeros(), e.covariance_mm2.as_ref());
            (series.object.clone(), one)
        })
        .collect()
}

/// Who estimates over objects, from a series to its estimates.
///
/// # Errors
/// Where an object's mesh is missing.
pub fn score_objects(
    run: &(dyn Fn(&SweepSeries) -> Vec<Estimate> + Sync),
    all_series: &BTreeMap<String, Vec<SweepSeries>>,
    meshes: &BTreeMap<String, Mesh>,
) -> Result<Vec<ObjectScores>, LabError> {
    all_series
        .iter()
        .map(|(name, all_series)| {
            let mesh = meshes
                .get(name)
                .ok_or_else(|| LabError::value("meshes", name.clone(), "no such object"))?;
            let one = |series: &SweepSeries| compare_with_truth(series, mesh, &run(series));
            let parts: Vec<_> = all_series.par_iter().map(one).collect();
            let compared = || parts.iter().flat_map(|p| &p.0);
            let calls: Vec<(bool, bool)> = parts.iter().flat_map(|p| p.1.iter().copied()).collect();
            let all: Vec<EstimateError> = compared().map(|c| c.0).collect();
            let followed: Vec<EstimateError> = compared().filter(|c| c.1).map(|c| c.0).collect();
            Ok(ObjectScores {
                name: name.clone(),
                all: scores(&all),
                followed: scores(&followed),
                detection: detection(&calls),
                sweeps: parts
                    .iter()
                    .map(|p| SweepSums::of(&p.0))
                    .filter(|s| s.surface.count > 0.0)
                    .collect(),
            })
        })
        .collect()
}
