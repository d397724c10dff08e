//! What explains a sweep that does not belong to its object: one thing taken for wrong at a time.
//!
//! Each suspect is tried over its usual mistakes; the one that the gaps of [`crate::sweep_witness`] like best stands for it. It explains the sweep where
//! its p-value is no longer small. Several may: a clock that is ahead and an object that stands further on are the same to a steady motion.

use crate::ContactError;
use crate::sweep_record::Trial;
use crate::sweep_witness::SweepWitness;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use wcal_calibration::WhiskerCalibration;
use wcal_core::observation::WhiskerSpec;

/// From this p-value on a suspect explains the sweep.
const EXPLAINS: f64 = 0.05;
/// Factors on the moments, and clock offsets of the motion, s, either way.
const GAINS: [f64; 12] = [0.67, 0.72, 0.78, 0.83, 0.88, 0.94, 1.06, 1.13, 1.2, 1.28, 1.38, 1.5];
const CLOCKS_S: [f64; 10] = [0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0];
/// A place of the object of which this much is not known, mm.
const PLACED_SD_MM: f64 = 10.0;

/// What may be wrong with a sweep.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Suspect {
    /// `gain`, `clock`, `unit`, `axis` or `place`.
    pub id: &'static str,
    /// In words, with the value that explains most.
    pub what: String,
    /// Probability of gaps as unlikely with it.
    pub p_value: f64,
    /// Whether it explains the sweep.
    pub explains: bool,
}

/// Suspects of a sweep, the likeliest first; those that leave nothing to judge are not among them.
///
/// # Errors
/// Where the sweep's table cannot be read.
pub fn suspects(
    witness: &SweepWitness,
    calibration: &dyn WhiskerCalibration,
    declared: &WhiskerSpec,
) -> Result<Vec<Suspect>, ContactError> {
    let record = witness.record(calibration, declared)?;
    let usual = Trial::default();
    let gains = GAINS.map(|gain| (format!("moments {gain} times as large"), Trial { gain, ..usual }));
    let clocks = CLOCKS_S
        .iter()
        .flat_map(|s| [*s, -*s])
        .map(|clock_s| (format!("the motion's clock ahead by {clock_s:+} s"), Trial { clock_s, ..usual }));
    let units = [(1e3, "metres, stated as millimetres"), (1e-3, "micrometres, stated as millimetres")].map(
        |(scale, what)| {
            (format!("the motion in {what}"), Trial { motion: Matrix3::identity() * scale, ..usual })
        },
    );
    let axes = turns().into_iter().map(|(what, motion)| (what, Trial { motion, ..usual }));
    let place = Trial { placed_sd_mm: Some(PLACED_SD_MM), ..usual };
    let place = ("the object some millimetres away from its stated place".to_owned(), place);
    let all: [(&'static str, Vec<(String, Trial)>); 5] = [
        ("clock", clocks.collect()),
        ("gain", gains.into()),
        ("unit", units.into()),
        ("axis", axes.collect()),
        ("place", vec![place]),
    ];
    let mut found = Vec::new();
    for (id, trials) in all {
        let tried = trials.into_par_iter().filter_map(|(what, trial)| {
            let p_value = witness.verdict(&record, &trial).ok()?.p_value;
            Some(Suspect { id, what, p_value, explains: p_value >= EXPLAINS })
        });
        found.extend(tried.max_by(|a, b| a.p_value.total_cmp(&b.p_value)));
    }
    found.sort_by(|a, b| b.p_value.total_cmp(&a.p_value));
    Ok(found)
}

/// The motion along another axis, or the other way: turns that take the axes to each other.
fn turns() -> Vec<(String, Matrix3<f64>)> {
    let name = ["x", "y", "z"];
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    let mut all = Vec::new();
    for from in 0..3 {
        for to in 0..3 {
            for sign in [1.0, -1.0] {
                // What the log calls `from` is `to`; the third axis stays.
                let mut m = Matrix3::identity();
                m.set_column(from, &(axes[to] * sign));
                if from != to {
                    m.set_column(to, &axes[from]);
                }
                if from != to || sign < 0.0 {
                    let way = if sign > 0.0 { "" } else { "-" };
                    all.push((format!("the motion's {} is {way}{}", name[from], name[to]), m));
                }
            }
        }
    }
    all
}

/// A sentence on suspects.
#[must_use]
pub fn sentence(all: &[Suspect]) -> String {
    let explain: Vec<&str> = all.iter().filter(|s| s.explains).map(|s| s.what.as_str()).collect();
    match explain[..] {
        [] => "no clock offset, gain, unit or axis of the motion, nor another place of the object alone explains it: the motion of another sweep, \
               moments of another whisker, another wire or another object"
            .to_owned(),
        [one] => format!("{one} would explain it"),
        _ => format!("each would explain it, and this sweep cannot distinguish them: {}", explain.join("; ")),
    }
}
