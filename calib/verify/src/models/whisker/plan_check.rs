//! Which effects a plan can distinguish, before anything is measured.
//!
//! The signature of an effect is the derivative of the predicted readings by its parameter, off K
//! and the zero. With orthonormal bases A, B of what two effects can do at given shapes,
//!
//! ```text
//! c(A, B) = |A' B| / sqrt(dim A)        1: whatever A does, B can imitate
//! ```
//!
//! A and B cannot be distinguished where every shape of A is imitated by some shape of B
//! (`c > 0.995`), whatever the noise.

use super::system::WhiskerSystem;
use crate::method::{
    CLASS_COSINE, Signature, Weights, fit, nuisance_basis, signatures_of_catalogue,
};
use crate::{MeasurementModel, VerifyError};
use std::collections::{BTreeMap, BTreeSet};
use wcal_core::WhiskerData;
use wcal_core::observation::{Role, WhiskerRow};
use wcal_core::plan_check_document::{Addition, PlanCheck, PlannedEffect};

/// Sensitivity of a typical sensor, pm/(N mm): signatures off K do not depend on it but for their
/// scale.
const TYPICAL_PM_PER_NMM: [[f64; 2]; 2] = [[75.0, 6.0], [-6.0, 75.0]];

/// Checks the plan whose rows `data` holds; their shifts are not used.
///
/// # Errors
/// Where the wire cannot be modelled or has no equilibrium at the planned poses.
pub fn plan_check(data: &WhiskerData) -> Result<PlanCheck, VerifyError> {
    let effects = planned(data)?;
    let mut additions = Vec::new();
    for (what, more) in extended(data) {
        let with = planned(&more)?;
        let both = with.iter().zip(&effects);
        let new = both.filter(|(w, e)| w.status == "testable" && e.status != "testable");
        let testable: Vec<String> = new.map(|(w, _)| w.id.clone()).collect();
        let separates: Vec<[String; 2]> =
            pairs(&effects).difference(&pairs(&with)).cloned().collect();
        if !testable.is_empty() || !separates.is_empty() {
            additions.push(Addition {
                what,
                testable,
                separates,
            });
        }
    }
    additions.sort_by_key(|a| std::cmp::Reverse(a.testable.len() + a.separates.len()));
    Ok(PlanCheck { effects, additions })
}

/// Pairs that cannot be distinguished, each once.
fn pairs(effects: &[PlannedEffect]) -> BTreeSet<[String; 2]> {
    let all = effects
        .iter()
        .flat_map(|e| e.never_apart.iter().map(move |o| [&e.id, o]));
    let sorted = all.map(|[a, b]| [a.min(b).clone(), a.max(b).clone()]);
    sorted.collect()
}

fn planned(data: &WhiskerData) -> Result<Vec<PlannedEffect>, VerifyError> {
    let no_solution = || VerifyError::NoEquilibrium("the plan's trajectories".to_owned());
    let bare = WhiskerSystem::new(data, &[])?;
    let (sensed, _) = bare.moments(&[]).ok_or_else(no_solution)?;
    // Readings of a typical sensor at the planned poses.
    let mut made = data.clone();
    for (&row, m) in bare.path.rows.iter().zip(&sensed) {
        let k = TYPICAL_PM_PER_NMM;
        made.rows[row].shift_pm = [0, 1].map(|c| k[c][0] * m[0] + k[c][1] * m[1]);
    }
    let system = WhiskerSystem::new(&made, &[])?;
    // Cosines of signatures do not depend on the size of the noise.
    let weights = Weights::equal(system.path.readings.len());
    let base = fit(&system, &[], &weights, 1).ok_or_else(no_solution)?;
    let signatures = signatures_of_catalogue(&system, &base, &weights, &nuisance_basis(&base));
    let effects = 0..system.catalogue.len();
    Ok(effects
        .map(|e| of_effect(&system, &signatures, e))
        .collect())
}

fn of_effect(system: &WhiskerSystem, signatures: &[Signature], effect: usize) -> PlannedEffect {
    let candidate = &system.catalogue()[effect];
    let entry = |status: &str, why: String| PlannedEffect {
        id: candidate.id.to_owned(),
        status: status.to_owned(),
        why,
        never_apart: Vec::new(),
        sometimes_alike: Vec::new(),
    };
    if let Some(why) = system.not_observable(effect) {
        return entry("not-observable", why);
    }
    if candidate.is_outlier_process {
        let why = "single readings far outside the noise are flagged";
        return entry("testable", why.to_owned());
    }
    let of = |e: usize| -> Vec<&Signature> {
        signatures.iter().filter(|a| a.term.effect == e).collect()
    };
    let own = of(effect);
    if own.is_empty() {
        let why = "not identifiable: fully absorbed by sensitivity K and zero offset";
        return entry("absorbed", why.to_owned());
    }
    let left = own.iter().map(|a| a.share_left).fold(0.0, f64::max);
    let percent = 100.0 * left;
    let why = "of its signature is independent of sensitivity K and zero offset";
    let mut out = entry("testable", format!("{percent:.0} % {why}"));
    for other in (0..system.catalogue().len()).filter(|&o| o != effect) {
        let theirs = of(other);
        if theirs.is_empty() {
            continue;
        }
        // Shapes that some shape of the other one imitates.
        let imitated = |a: &&&Signature| {
            theirs
                .iter()
                .any(|b| signature_overlap(a, b) > CLASS_COSINE)
        };
        let alike = own.iter().filter(imitated).count();
        let id = system.catalogue()[other].id.to_owned();
        if alike == own.len() {
            out.never_apart.push(id);
        } else if alike > 0 {
            out.sometimes_alike.push(id);
        }
    }
    out
}

/// How much of what `a` does `b` can imitate.
fn signature_overlap(a: &Signature, b: &Signature) -> f64 {
    // |A' B|^2: squared cosines between the two spans, summed.
    let shared: f64 = a
        .directions
        .iter()
        .flat_map(|p| b.directions.iter().map(move |q| p.dot(q).powi(2)))
        .sum();
    (shared / a.dimension() as f64).sqrt()
}

/// The plan with one more column or kind of pose each.
fn extended(data: &WhiskerData) -> Vec<(String, WhiskerData)> {
    let depth = |r: &WhiskerRow| r.stage_mm.unwrap_or_default();
    let mut deepest: BTreeMap<u32, &WhiskerRow> = BTreeMap::new();
    for row in data.rows.iter().filter(|r| r.role != Role::Rest) {
        let Some(id) = row.trajectory else { continue };
        let known = deepest.entry(id).or_insert(row);
        if depth(row) >= depth(known) {
            *known = row;
        }
    }
    let times = data.rows.iter().filter_map(|r| r.t_s);
    let end_s = times.reduce(f64::max).unwrap_or_default();
    // Rows made from the deepest pose of each trajectory, a minute apart.
    let with = |changes: &[&dyn Fn(&mut WhiskerRow)]| {
        let mut more = data.clone();
        for (k, (id, row)) in deepest.iter().enumerate() {
            for (j, change) in changes.iter().enumerate() {
                let mut row = (*row).clone();
                row.t_s = Some(end_s + 60.0 * (1 + k * changes.len() + j) as f64);
                change(&mut row);
                let line = data.trajectory(*id).zip(row.stage_mm);
                row.groove_mm = line.map(|(l, x)| l.origin_mm + l.direction * x);
                more.rows.push(row);
            }
        }
        more
    };
    let to = |share: f64, direction: f64, speed: f64| {
        move |row: &mut WhiskerRow| {
            row.stage_mm = row.stage_mm.map(|x| share * x);
            (row.direction, row.speed_mm_s) = (Some(direction), Some(speed));
            row.dwell_s = Some(if speed > 0.0 { 0.0 } else { 2.0 });
        }
    };
    let held = |row: &mut WhiskerRow| row.dwell_s = Some(60.0);
    let mut warmed = data.clone();
    let count = warmed.rows.len().max(2) as f64 - 1.0;
    for (k, row) in warmed.rows.iter_mut().enumerate() {
        // Up and down again, so that temperature is not time.
        row.temperature_degc = Some(22.0 + 4.0 * (std::f64::consts::PI * k as f64 / count).sin());
    }
    vec![
        (
            "readings on the way back (unloading) on every trajectory".to_owned(),
            with(&[
                &to(1.0, 1.0, 0.0),
                &to(0.66, -1.0, 0.0),
                &to(0.33, -1.0, 0.0),
            ]),
        ),
        (
            "a reading after 60 s at the deepest pose of every trajectory".to_owned(),
            with(&[&to(1.0, 1.0, 0.0), &held]),
        ),
        (
            "readings while passing at 8 mm/s on every trajectory".to_owned(),
            with(&[&to(0.33, 1.0, 8.0), &to(0.66, 1.0, 8.0), &to(1.0, 1.0, 8.0)]),
        ),
        (
            "a temperature column, the bench warmed by some kelvin and let cool".to_owned(),
            warmed,
        ),
    ]
}
