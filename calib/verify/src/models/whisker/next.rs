//! Next measurement: the one that would decide between surviving explanations.

use super::system::WhiskerSystem;
use crate::effect::LawRequirement;
use crate::method::{Fit, Hypothesis, linear, power};
use crate::{EffectTerm, MeasurementModel};
use nalgebra::DMatrix;
use wcal_core::observation::{Role, WhiskerRow};
use wcal_core::verify_document::{NextMeasurement, NextPose};

/// Poses asked for at most.
const POSES: usize = 3;
/// Rivals that the poses are chosen against, nearest first: each costs a rod solution a proposal.
pub(super) const RIVALS: usize = 4;
/// Readings averaged at each proposed pose.
const REPEATS: f64 = 4.0;

/// An excursion on one trajectory and the reading proposed on it.
#[derive(Debug, Clone)]
struct Proposal {
    pose: NextPose,
    /// The reading, after the deepest pose where the way goes back.
    rows: Vec<WhiskerRow>,
}

fn row(template: &WhiskerRow, pose: &NextPose, t_s: f64, system: &WhiskerSystem) -> WhiskerRow {
    let line = system.data.trajectory(pose.trajectory);
    WhiskerRow {
        role: Role::Verification,
        trajectory: Some(pose.trajectory),
        t_s: Some(t_s),
        stage_mm: Some(pose.stage_mm),
        direction: Some(pose.direction),
        speed_mm_s: Some(pose.speed_mm_s),
        dwell_s: Some(pose.dwell_s),
        average_s: None,
        pair: None,
        groove_mm: line.map(|l| l.origin_mm + l.direction * pose.stage_mm),
        ..template.clone()
    }
}

/// Loading, unloading after the deepest pose, fast passes and long dwells on every trajectory.
fn proposals(system: &WhiskerSystem) -> Vec<Proposal> {
    // The later session begins in the surroundings in which this one ended; its temperature is not
    // ours to choose.
    let Some(template) = system.data.rows.iter().rfind(|r| r.role != Role::Rest) else {
        return Vec::new();
    };
    let times = system.path.readings.iter().map(|r| r.t_s);
    let start = times.reduce(f64::max).unwrap_or_default() + 30.0;
    let mut out = Vec::new();
    for (l, trajectory) in system.data.trajectories.iter().enumerate() {
        let reach = system.path.reach_mm[l];
        if reach <= 0.0 {
            continue;
        }
        for share in [0.3, 0.6, 1.0] {
            for (direction, speed_mm_s, dwell_s) in [
                (1.0, 0.0, 2.0),
                (1.0, 0.0, 60.0),
                (-1.0, 0.0, 2.0),
                (1.0, 8.0, 0.0),
                (-1.0, 8.0, 0.0),
            ] {
                if direction < 0.0 && share == 1.0 {
                    continue;
                }
                let pose = NextPose {
                    trajectory: trajectory.id,
                    stage_mm: (share * reach * 1000.0).round() / 1000.0,
                    direction,
                    speed_mm_s,
                    dwell_s,
                };
                let mut rows = Vec::new();
                let mut t = start;
                if direction < 0.0 {
                    let deep = NextPose {
                        stage_mm: reach,
                        direction: 1.0,
                        speed_mm_s: 0.0,
                        dwell_s: 2.0,
                        ..pose.clone()
                    };
                    t += 5.0;
                    rows.push(row(template, &deep, t, system));
                }
                t += 5.0 + dwell_s;
                rows.push(row(template, &pose, t, system));
                out.push(Proposal { pose, rows });
            }
        }
    }
    out
}

/// Design of `terms` at the reading of a proposal, taken after the whole session.
fn design_at(
    system: &WhiskerSystem,
    proposal: &Proposal,
    terms: &[EffectTerm],
) -> Option<DMatrix<f64>> {
    let extended = system.with_rows(&proposal.rows)?;
    let design = extended.design(terms)?;
    let mut order = extended.path.rows.iter();
    let index = order.position(|&r| r + 1 == extended.path.rows.len())?;
    Some(design.rows(index, 1).into_owned())
}

/// Noncentrality (in variances) by which new readings separate `a` (taken as true) from `b` once b
/// is refitted. They come from a later session with its own zero, known from a rest reading before
/// each. `seen`: by how much the pictures that are there separate them.
fn separation(
    b: &Fit,
    present: &DMatrix<f64>,
    seen: f64,
    new: &[(DMatrix<f64>, DMatrix<f64>)],
    variance: f64,
) -> f64 {
    let (n, q, channels) = (b.design.nrows(), b.design.ncols(), b.residual.ncols());
    let total = n + new.len() + 1;
    // A mean of n readings has 1 / n of the variance: its row weighs by the root of n.
    let weight = REPEATS.sqrt();
    // A rest reading before each of them says as often where the later zero is.
    let at_rest = weight * (new.len() as f64).sqrt();
    // The later session's zero, then the rival's columns; at rest only the constants read.
    let columns = DMatrix::from_fn(total, 1 + q, |i, j| match (i.checked_sub(n), j) {
        (None, 0) => 0.0,
        (None, _) => b.design[(i, j - 1)],
        (Some(k), _) if k == new.len() => at_rest * f64::from(u8::from(j < 2)),
        (Some(_), 0) => weight,
        (Some(k), _) => weight * new[k].1[j - 1],
    });
    let difference = DMatrix::from_fn(total, channels, |i, c| match i.checked_sub(n) {
        None => present[(i, c)],
        Some(k) => new.get(k).map_or(0.0, |(gap, _)| weight * gap[c]),
    });
    // Every column is free in each channel.
    let left = linear(&columns, &difference).1;
    (left.norm_squared() + seen) / variance
}

/// The poses that separate the best explanation from `rivals`, and the power expected from them:
/// the chance that none of them survives where the best one is true (Bonferroni's lower bound).
pub fn next_measurement(
    system: &WhiskerSystem,
    best: &Hypothesis,
    rivals: &[&Hypothesis],
    separates: Vec<String>,
) -> Option<NextMeasurement> {
    // A rival that is refitted takes up what it can: what it cannot, over the variance, is the noncentrality.
    let variance = best.fit.variance();
    // The present readings separate each pair by what their predictions differ.
    let present: Vec<DMatrix<f64>> = rivals
        .iter()
        .map(|r| &r.fit.residual - &best.fit.residual)
        .collect();
    let seen: Vec<f64> = rivals
        .iter()
        .map(|r| (&r.fit.auxiliary_residual - &best.fit.auxiliary_residual).norm_squared())
        .collect();
    let evaluate = |proposal: Proposal| {
        let expected = design_at(system, &proposal, &best.fit.terms)? * &best.fit.coefficients;
        let against = rivals.iter().map(|r| {
            let design = design_at(system, &proposal, &r.fit.terms)?;
            Some((&expected - &design * &r.fit.coefficients, design))
        });
        let against = against.collect::<Option<Vec<_>>>()?;
        Some((proposal.pose, against))
    };
    // Each pose with, for each rival, the gap between the best explanation's prediction and the
    // rival's and the rival's design there.
    let evaluated: Vec<_> = proposals(system).into_iter().filter_map(evaluate).collect();
    let separations = |poses: &[usize]| -> Vec<f64> {
        let of = |r: usize| {
            let new: Vec<_> = poses.iter().map(|&k| evaluated[k].1[r].clone()).collect();
            separation(&rivals[r].fit, &present[r], seen[r], &new, variance)
        };
        (0..rivals.len()).map(of).collect()
    };
    let decides = |each: &[f64]| (1.0 - each.iter().map(|v| 1.0 - power(*v)).sum::<f64>()).max(0.0);
    let mut chosen: Vec<usize> = Vec::new();
    let mut reached = Vec::new();
    for _ in 0..POSES {
        // The least separated rival rules, so that no pose is spent on what is decided already.
        let scored = (0..evaluated.len())
            .filter(|k| !chosen.contains(k))
            .map(|k| {
                let poses: Vec<usize> = chosen.iter().copied().chain([k]).collect();
                let each = separations(&poses);
                (k, each.iter().copied().fold(f64::INFINITY, f64::min), each)
            });
        let (k, _, each) = scored.max_by(|a, b| a.1.total_cmp(&b.1))?;
        chosen.push(k);
        reached = each;
        if decides(&reached) > 0.95 {
            break;
        }
    }
    let poses: Vec<NextPose> = chosen.iter().map(|&k| evaluated[k].0.clone()).collect();
    let expected_power = decides(&reached);
    let instruction = if expected_power < 0.5 {
        let slow = |t: &EffectTerm| {
            let effect = &system.catalogue()[t.effect];
            let by_clock = |need: &LawRequirement| {
                matches!(need, LawRequirement::Time | LawRequirement::Temperature)
            };
            effect.needs().iter().any(by_clock) && !effect.has_memory
        };
        let mut terms = rivals.iter().chain([&best]).flat_map(|h| &h.fit.terms);
        let needed = if terms.any(slow) {
            "the temperature has to change otherwise than steadily with time: warm the bench by some kelvin, let it cool, and take a rest \
             reading every minute; then `wcal verify --add` that session"
        } else {
            "it needs another direction of approach, another medium or a second sensor"
        };
        format!(
            "{} cannot be separated on this rig by three more poses; {needed}.",
            separates.join(" and ")
        )
    } else {
        let list: Vec<String> = poses.iter().map(describe).collect();
        format!(
            "Read {REPEATS} times each, a rest reading before every one: {}; then `wcal verify --add` that session.",
            list.join("; ")
        )
    };
    Some(NextMeasurement {
        separates,
        instruction,
        poses,
        expected_power,
    })
}

fn describe(p: &NextPose) -> String {
    let how = if p.speed_mm_s > 0.0 {
        format!("passing at {} mm/s", p.speed_mm_s)
    } else {
        format!("settled for {} s", p.dwell_s)
    };
    let way = if p.direction < 0.0 {
        "unloading from the deepest pose"
    } else {
        "loading"
    };
    format!(
        "trajectory {}, stage {:.2} mm, {way}, {how}",
        p.trajectory, p.stage_mm
    )
}
