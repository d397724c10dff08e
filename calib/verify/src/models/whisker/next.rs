//! Next measurement: the one that would decide between surviving explanations.

use super::system::WhiskerSystem;
use crate::effect::{EffectTerm, LawRequirement};
use crate::measurement_model::MeasurementModel;
use crate::method::ambiguity::power;
use crate::method::fit::{Fit, linear};
use crate::method::hypothesis::Hypothesis;
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
    rows: Vec<WhiskerRow>,
    /// Which of `rows` is the reading.
    reading: usize,
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
    let start = system
        .path
        .readings
        .iter()
        .map(|r| r.t_s)
        .reduce(f64::max)
        .unwrap_or(0.0)
        + 30.0;
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
                out.push(Proposal {
                    pose,
                    reading: rows.len() - 1,
                    rows,
                });
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
    let rows: Vec<&WhiskerRow> = system.data.rows.iter().chain(&proposal.rows).collect();
    let extended = system.with_rows(&rows);
    let design = extended.design(terms)?;
    let index = extended
        .path
        .rows
        .iter()
        .position(|&r| r == system.data.rows.len() + proposal.reading)?;
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
    let n = b.design.nrows();
    let total = n + new.len() + 1;
    let weight = REPEATS.sqrt();
    let at_rest = weight * (new.len() as f64).sqrt();
    let extend = |column: &[f64], extra: &dyn Fn(usize) -> f64, rest: f64| -> Vec<f64> {
        column
            .iter()
            .copied()
            .chain((0..new.len()).map(|k| weight * extra(k)))
            .chain([at_rest * rest])
            .collect()
    };
    // At rest only the constant reads.
    let rest = |j: usize| f64::from(u8::from(j == 0));
    let own = |j: usize| {
        extend(
            b.design.column(j).clone_owned().as_slice(),
            &|k| new[k].1[j],
            rest(j),
        )
    };
    let mut columns = vec![extend(&vec![0.0; n], &|_| 1.0, 1.0)];
    columns.extend((0..b.design.ncols()).map(own));
    let gap = |c: usize| {
        extend(
            present.column(c).clone_owned().as_slice(),
            &|k| new[k].0[c],
            0.0,
        )
    };
    let difference: Vec<Vec<f64>> = (0..b.residual.ncols()).map(gap).collect();
    let matrix =
        |columns: &[Vec<f64>]| DMatrix::from_fn(total, columns.len(), |i, j| columns[j][i]);
    // Every column is free in each channel.
    (linear(&matrix(&columns), &matrix(&difference))
        .1
        .norm_squared()
        + seen)
        / variance
}

/// A proposal and, for each rival, the gap between the best explanation's prediction and the
/// rival's and the rival's design there.
struct Evaluated {
    proposal: usize,
    against: Vec<(DMatrix<f64>, DMatrix<f64>)>,
}

/// The poses that separate the best explanation from `rivals`, and the power expected from them:
/// the chance that none of them survives where the best one is true (Bonferroni's lower bound).
pub fn next_measurement(
    system: &WhiskerSystem,
    best: &Hypothesis,
    rivals: &[&Hypothesis],
    separates: Vec<String>,
) -> Option<NextMeasurement> {
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
    let candidates = proposals(system);
    let evaluated: Vec<Evaluated> = candidates
        .iter()
        .enumerate()
        .filter_map(|(proposal, p)| {
            let expected = design_at(system, p, &best.fit.terms)? * &best.fit.coefficients;
            let against = rivals
                .iter()
                .map(|r| {
                    let design = design_at(system, p, &r.fit.terms)?;
                    Some((&expected - &design * &r.fit.coefficients, design))
                })
                .collect::<Option<Vec<_>>>()?;
            Some(Evaluated { proposal, against })
        })
        .collect();
    let separations = |poses: &[usize]| -> Vec<f64> {
        (0..rivals.len())
            .map(|r| {
                let new: Vec<_> = poses
                    .iter()
                    .map(|&k| evaluated[k].against[r].clone())
                    .collect();
                separation(&rivals[r].fit, &present[r], seen[r], &new, variance)
            })
            .collect()
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
    let poses: Vec<NextPose> = chosen
        .iter()
        .map(|&k| candidates[evaluated[k].proposal].pose.clone())
        .collect();
    let expected_power = decides(&reached);
    let instruction = if expected_power < 0.5 {
        let slow = |t: &EffectTerm| {
            let effect = &system.catalogue()[t.effect];
            let by_clock = |need: &LawRequirement| {
                matches!(need, LawRequirement::Time | LawRequirement::Temperature)
            };
            effect.needs().iter().any(by_clock) && !effect.has_memory
        };
        let needed = if rivals
            .iter()
            .chain([&best])
            .any(|h| h.fit.terms.iter().any(slow))
        {
            "the temperature has to change otherwise than steadily with time: warm the rod_tables by some kelvin, let it cool, and take a rest \
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
