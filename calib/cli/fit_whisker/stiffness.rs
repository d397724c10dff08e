//! Young's modulus from base moments that are known at a session's poses, with the fitted geometry.
//!
//! At a given pose the rod's moment is proportional to the modulus (the ratio to the shear modulus
//! kept): one slope through all points, robust against labels on another branch; its sd by a
//! jackknife over trajectories, and by the geometry's covariance.

use anyhow::{Context, Result, ensure};
use nalgebra::{DVector, Vector2};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_core::order_statistics::median;
use wcal_core::{Role, WhiskerData};
use wcal_rod::{Line, Outcome, RestFit, Rod, WORKING_STEP_MM};

/// Huber's tuning constant, and rounds of reweighting.
const HUBER: f64 = 1.345;
const ROUNDS: usize = 30;
/// A residual beyond this many robust standard deviations is no noise.
const OUTLIER: f64 = 6.0;
/// Steps for the derivative by the geometry, over those of the fit: labels are followed anew from
/// the first touch.
const NUDGE: f64 = 10.0;

/// `[stiffness]` of whisker.toml.
#[derive(Debug, Serialize)]
pub(crate) struct Stiffness {
    /// Young's modulus, GPa; the diameter is as stated, and EI goes with its fourth power.
    pub youngs_gpa: f64,
    /// All of it, GPa.
    pub sd_gpa: f64,
    /// The part that the geometry's uncertainty makes, GPa.
    pub sd_by_geometry_gpa: f64,
    /// Points used.
    pub points: usize,
    /// Root mean square difference at them, N mm.
    pub rms_nmm: f64,
    /// Points left out, with the reason.
    pub left_out: Vec<String>,
}

/// A point with a known and a modelled moment.
struct Pair {
    point: i64,
    trajectory: u32,
    known_nmm: Vector2<f64>,
    model_nmm: Vector2<f64>,
}

/// Fits the modulus.
///
/// # Errors
/// Where the session has no known moments, or none at a pose that the rod reaches.
pub(crate) fn stiffness(session: &Path, nominal: &WhiskerSpec, fit: &RestFit) -> Result<Stiffness> {
    let loaded = wcal_session::load(session)?;
    let data = loaded.whisker().context("--moments")?;
    ensure!(
        !data.twin.is_empty(),
        "{}: expected [files] twin with the known moments in session.toml, found none",
        session.display()
    );
    let (pairs, mut left_out) = pairs(data, nominal, fit, &fit.values)?;
    let weights = weights(&pairs);
    for (p, _) in pairs.iter().zip(&weights).filter(|(_, w)| **w == 0.0) {
        left_out.push(format!(
            "point {}: known moment {:.3?} N mm, rod {:.3?} N mm",
            p.point,
            p.known_nmm.as_slice(),
            p.model_nmm.as_slice()
        ));
    }
    let used: Vec<(Pair, f64)> = pairs
        .into_iter()
        .zip(weights)
        .filter(|(_, w)| *w > 0.0)
        .collect();
    ensure!(
        used.len() >= 3,
        "--moments: expected three usable points or more, found {}",
        used.len()
    );
    // The moments of a wire in a given shape are proportional to its modulus.
    let ratio = slope(used.iter().map(|(p, w)| (p, *w)));
    let jackknifed = jackknife(&used, ratio)?;
    let by_geometry = by_geometry(data, nominal, fit, &used, ratio)?;
    let squares: f64 = used.iter().map(|(p, _)| residual(p, ratio).powi(2)).sum();
    Ok(Stiffness {
        youngs_gpa: nominal.youngs_gpa * ratio,
        sd_gpa: nominal.youngs_gpa * jackknifed.hypot(by_geometry),
        sd_by_geometry_gpa: nominal.youngs_gpa * by_geometry,
        points: used.len(),
        rms_nmm: (squares / (2 * used.len()) as f64).sqrt(),
        left_out,
    })
}

/// Known and modelled moments, for a geometry in the order of the fit's unknowns.
fn pairs(
    data: &WhiskerData,
    nominal: &WhiskerSpec,
    fit: &RestFit,
    v: &DVector<f64>,
) -> Result<(Vec<Pair>, Vec<String>)> {
    let rest_shape = fit.model.rest_shape(v)?;
    let rod = Rod::new(
        &WhiskerSpec {
            rest_shape,
            ..nominal.clone()
        },
        WORKING_STEP_MM,
    )?;
    let (turn, offset) = fit.model.root(v);
    let known: BTreeMap<i64, [f64; 2]> =
        data.twin.iter().map(|t| (t.point, t.moment_nmm)).collect();
    let (mut pairs, mut left_out) = (Vec::new(), Vec::new());
    for trajectory in &data.trajectories {
        let rows = data
            .rows
            .iter()
            .filter(|r| r.role != Role::Rest && r.trajectory == Some(trajectory.id));
        let rows: Vec<_> = rows.filter_map(|r| Some((r.point, r.stage_mm?))).collect();
        // In the clamp's own frame.
        let line = Line {
            origin_mm: turn.inverse() * (trajectory.origin_mm - offset),
            direction: turn.inverse() * trajectory.direction,
        };
        let stages: Vec<f64> = rows.iter().map(|r| r.1).collect();
        for (outcome, (point, _)) in rod.follow(&line, &stages).iter().zip(&rows) {
            let Some(known_nmm) = known.get(point).copied() else {
                continue;
            };
            match outcome {
                Outcome::Held(held) => pairs.push(Pair {
                    point: *point,
                    trajectory: trajectory.id,
                    known_nmm: known_nmm.into(),
                    model_nmm: data
                        .moments
                        .components_nmm(&(turn * held.moment_nmm))
                        .into(),
                }),
                _ => left_out.push(format!("point {point}: the rod is not held there")),
            }
        }
    }
    Ok((pairs, left_out))
}

fn residual(p: &Pair, ratio: f64) -> f64 {
    (p.known_nmm - ratio * p.model_nmm).norm()
}

/// Weighted least-squares slope of known over modelled moments.
fn slope<'a>(pairs: impl Iterator<Item = (&'a Pair, f64)>) -> f64 {
    let (mut up, mut down) = (0.0, 0.0);
    for (p, w) in pairs {
        up += w * p.known_nmm.dot(&p.model_nmm);
        down += w * p.model_nmm.norm_squared();
    }
    up / down
}

/// Huber's weights; 0 for outliers.
fn weights(pairs: &[Pair]) -> Vec<f64> {
    // Start: the median of each point's own slope.
    let own = |p: &Pair| p.known_nmm.dot(&p.model_nmm) / p.model_nmm.norm_squared().max(1e-12);
    let mut ratio = median(pairs.iter().map(own)).unwrap_or(0.0);
    let mut weights = vec![1.0; pairs.len()];
    for _ in 0..ROUNDS {
        let off: Vec<f64> = pairs.iter().map(|p| residual(p, ratio)).collect();
        // Median length of a plane normal vector: 1.177 standard deviations; a floor for labels
        // without noise.
        let sd = (median(off.iter().copied()).unwrap_or(0.0) / 1.177).max(1e-6);
        // Beyond the bound an error counts by its size, not by its square.
        weights = off
            .iter()
            .map(|r| {
                if *r > OUTLIER * sd {
                    0.0
                } else {
                    (HUBER * sd / r.max(1e-300)).min(1.0)
                }
            })
            .collect();
        let next = slope(pairs.iter().zip(weights.iter().copied()));
        if !next.is_finite() || (next - ratio).abs() < 1e-10 {
            break;
        }
        ratio = next;
    }
    weights
}

/// Relative sd by leaving out one trajectory after the other.
fn jackknife(used: &[(Pair, f64)], ratio: f64) -> Result<f64> {
    let mut groups: Vec<u32> = used.iter().map(|(p, _)| p.trajectory).collect();
    groups.sort_unstable();
    groups.dedup();
    ensure!(
        groups.len() >= 3,
        "--moments: expected three trajectories or more, found {}",
        groups.len()
    );
    let n = groups.len() as f64;
    let without = |g: &u32| {
        let others = used.iter().filter(|(p, _)| p.trajectory != *g);
        slope(others.map(|(p, w)| (p, *w)))
    };
    // Leaving out one of n groups moves an estimate by about 1 / (n - 1) of that group's error.
    let squares: f64 = groups.iter().map(|g| (without(g) - ratio).powi(2)).sum();
    Ok((squares * (n - 1.0) / n).sqrt())
}

/// Relative sd that the geometry's covariance makes.
fn by_geometry(
    data: &WhiskerData,
    nominal: &WhiskerSpec,
    fit: &RestFit,
    used: &[(Pair, f64)],
    ratio: f64,
) -> Result<f64> {
    let Some(covariance) = &fit.covariance else {
        return Ok(0.0);
    };
    let weight: BTreeMap<i64, f64> = used.iter().map(|(p, w)| (p.point, *w)).collect();
    let mut gradient = DVector::zeros(fit.values.len());
    for (k, nudge) in fit.model.difference_steps().into_iter().enumerate() {
        let mut there = fit.values.clone();
        there[k] += NUDGE * nudge;
        let (pairs, _) = pairs(data, nominal, fit, &there)?;
        let weighted = pairs
            .iter()
            .map(|p| (p, weight.get(&p.point).copied().unwrap_or(0.0)));
        gradient[k] = (slope(weighted) - ratio) / (NUDGE * nudge);
    }
    // To first order: g' C g.
    let variance = gradient.dot(&(covariance * &gradient));
    Ok(variance.max(0.0).sqrt())
}
