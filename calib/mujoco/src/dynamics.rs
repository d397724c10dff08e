//! Damping and contact of MuJoCo's wire: the paper's grid from coarse to fine, then NLopt around
//! the best (all SIMULATED trials).
//!
//! Judged by the ring-down of a released wire (against a record), the bounce off a plate (half of
//! the undamped wire's, docs/src/system.md), and on a sweep over a ball at two speeds: ripple,
//! speed bias, and how deep the wire overlaps the ball.
//!
//! min over x of sum_i ((y_i(x) - y_i*) / u_i)^2, x = (damping, width, d0, dmax), y the demands
//! (ring-down as its logarithm) and u the units that count. Sensitivity: with J the change of y_i /
//! u_i over one step of the grid in each x_k and N = J^T J = V diag(n) V^T, the standard deviation
//! of x_k with the others free is sqrt(sum_j V_kj^2 / n_j) steps. Source: M. Powell, "The BOBYQA
//! algorithm", DAMTP 2009/NA06; P. Kaelo & M. Ali, J. Optim. Theory Appl. 130 (2006) (CRS2), both
//! by NLopt; contact parameters: MuJoCo documentation, "Solver parameters".

mod trial_rig;

use crate::TwinError;
use crate::mjcf::MjcfOptions;
use nalgebra::Matrix4;
use nlopt::{Algorithm, Nlopt, Target};
use serde::Serialize;
use std::cell::RefCell;
use trial_rig::TrialRig;
pub use trial_rig::{Parameters, Score, Targets, ring_down_s};
use wcal_core::observation::WhiskerSpec;

/// The paper's grid: step, lowest and highest of damping of its joints (N m s/rad), contact width
/// (mm), and both impedances.
const STEPS: [f64; 4] = [0.005, 1.0, 0.05, 0.05];
const LOWEST: [f64; 4] = [0.0, 1.0, 0.0, 0.05];
const HIGHEST: [f64; 4] = [0.03, 10.0, 1.0, 1.0];
const DAMPINGS: [f64; 7] = [0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03];

/// A trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Trial {
    /// grid-damping, grid-contact, grid-fine, bobyqa or crs2.
    pub stage: &'static str,
    /// What was tried.
    pub parameters: Parameters,
    /// What it gave.
    pub score: Score,
}

/// All trials, and the best of those judged in full.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DynamicsFit {
    /// In order.
    pub trials: Vec<Trial>,
    /// Number of the best.
    pub best: usize,
    /// How much the demands change with a step of the paper's grid in each parameter, in units of
    /// what counts; below 1 the data do not determine it to a step.
    pub sensitivity: Sensitivity,
    /// Options of the best, 40 links.
    #[serde(skip)]
    pub options: MjcfOptions,
}

/// Change of all demands together over a step of the paper's grid, each parameter alone; and how
/// well they are known together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Over 0.005 N m s/rad.
    pub damping: f64,
    /// Over 1 mm.
    pub width: f64,
    /// Over 0.05.
    pub d0: f64,
    /// Over 0.05.
    pub dmax: f64,
    /// Standard deviation of each, in steps, with the others free and every demand met to its unit:
    /// contact parameters that trade with each other are not determined, however strongly each acts
    /// alone. At most [`UNKNOWN_STEPS`].
    pub together_steps: [f64; 4],
}

/// Steps that stand for "not determined at all".
const UNKNOWN_STEPS: f64 = 1e3;

impl Sensitivity {
    /// Names of the parameters that the data do not determine to a step of the grid while the
    /// others are free.
    pub fn undetermined(&self) -> Vec<&'static str> {
        let names = ["damping", "width", "d0", "dmax"];
        names
            .into_iter()
            .zip(self.together_steps)
            .filter(|(_, sd)| !(*sd <= 1.0))
            .map(|(name, _)| name)
            .collect()
    }
}

/// Standard deviations with all free, from the demands' changes over a step of each.
fn together_steps(changes: &[Vec<f64>; 4]) -> [f64; 4] {
    // N = J^T J; its inverse is the covariance of parameters with unit demands.
    let normal = Matrix4::from_fn(|i, j| {
        let pairs = changes[i].iter().zip(&changes[j]);
        pairs
            .map(|(a, b)| a * b)
            .filter(|p| p.is_finite())
            .sum::<f64>()
    });
    // Directions that change nothing have no information: their variance is bounded, not infinite.
    let axes = normal.symmetric_eigen();
    let sd = |k: usize| {
        let along = |n: usize| {
            axes.eigenvectors[(k, n)].powi(2) / axes.eigenvalues[n].max(UNKNOWN_STEPS.powi(-2))
        };
        (0..4).map(along).sum::<f64>().sqrt().min(UNKNOWN_STEPS)
    };
    [0, 1, 2, 3].map(sd)
}

/// Tries and chooses; `evaluations` bounds each of NLopt's two searches.
///
/// # Errors
/// Where the engine is missing or the wire cannot be.
pub fn fit_dynamics(
    whisker: &WhiskerSpec,
    targets: Targets,
    evaluations: u32,
    progress: impl Fn(&Trial),
) -> Result<DynamicsFit, TwinError> {
    let mut bench = TrialRig::new(whisker, targets)?;
    let mut trials: Vec<Trial> = Vec::new();
    let mut add = |bench: &mut TrialRig, stage, parameters, full| -> Result<f64, TwinError> {
        let trial = Trial {
            stage,
            parameters,
            score: bench.score(&parameters, full)?,
        };
        progress(&trial);
        trials.push(trial);
        Ok(trial.score.total)
    };
    // Damping with a hard contact, then the contact with that damping: the two barely meet in
    // ring-down and overlap.
    let mut best = Parameters::of([0.0, 1.0, 0.95, 1.0]);
    let mut least = f64::INFINITY;
    for damping in DAMPINGS {
        let tried = Parameters {
            damping_nms_rad: damping,
            ..best
        };
        let total = add(&mut bench, "grid-damping", tried, true)?;
        if total < least {
            (least, best.damping_nms_rad) = (total, damping);
        }
    }
    let mut candidates: Vec<(f64, Parameters)> = Vec::new();
    for width_mm in [1.0, 4.0, 7.0, 10.0] {
        for (d0, dmax) in [
            (0.0, 0.5),
            (0.0, 1.0),
            (0.5, 0.5),
            (0.5, 1.0),
            (0.8, 0.95),
            (0.95, 1.0),
        ] {
            let tried = Parameters::of([best.damping_nms_rad, width_mm, d0, dmax]);
            candidates.push((add(&mut bench, "grid-contact", tried, false)?, tried));
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (_, tried) in candidates.into_iter().take(3) {
        let total = add(&mut bench, "grid-contact", tried, true)?;
        if total < least {
            (least, best) = (total, tried);
        }
    }
    // Neighbours on the paper's own steps, twice at most: one valley is left to the refinement.
    for _ in 0..2 {
        let from = best;
        for tried in neighbours(&from) {
            let total = add(&mut bench, "grid-fine", tried, true)?;
            if total < least {
                (least, best) = (total, tried);
            }
        }
        if best == from {
            break;
        }
    }
    let shared = RefCell::new((bench, trials, None::<TwinError>));
    // BOBYQA refines one valley, CRS2 looks for others; each starts from the best so far.
    for (stage, algorithm) in [("bobyqa", Algorithm::Bobyqa), ("crs2", Algorithm::Crs2Lm)] {
        let from = best_of(&shared.borrow().1).map_or(best, |k| shared.borrow().1[k].parameters);
        search(stage, algorithm, &from, evaluations, &shared, &progress)?;
    }
    let (mut bench, trials, _) = shared.into_inner();
    let best = best_of(&trials)
        .ok_or_else(|| TwinError::Engine("no trial was judged in full".to_owned()))?;
    let sensitivity = sensitivity(&mut bench, &trials[best].parameters)?;
    let options = MjcfOptions {
        links: MjcfOptions::default().links,
        ..bench.options(&trials[best].parameters)
    };
    Ok(DynamicsFit {
        trials,
        best,
        sensitivity,
        options,
    })
}

/// What a wire of these parameters does: a record to fit against (SIMULATED).
///
/// # Errors
/// Where the engine is missing, the wire cannot be, or its sweeps are rejected.
pub fn record(whisker: &WhiskerSpec, parameters: &Parameters) -> Result<Targets, TwinError> {
    let wanted = Targets {
        ring_down_s: None,
        bounce_ratio: None,
        ripple_nmm: 0.0,
        bias: 0.0,
    };
    let score = TrialRig::new(whisker, wanted)?.score(parameters, true)?;
    // A soft contact lets the wire through the ball: no sweep, no record.
    let swept = |v: Option<f64>| {
        v.filter(|v| v.is_finite()).ok_or_else(|| {
            let found = format!("{parameters:?}: rejected");
            TwinError::value("record", "a wire whose sweeps are kept", found)
        })
    };
    Ok(Targets {
        ring_down_s: Some(score.ring_down_s),
        bounce_ratio: Some(score.bounce_ratio).filter(|b| b.is_finite()),
        ripple_nmm: swept(score.ripple_nmm)?,
        bias: swept(score.bias)?,
    })
}

fn sensitivity(bench: &mut TrialRig, at: &Parameters) -> Result<Sensitivity, TwinError> {
    let here = bench.score(at, true)?;
    // Inward where the grid ends.
    let step = |x: f64, by: f64, most: f64| if x + by <= most { x + by } else { x - by };
    let mut over = |there: Parameters| -> Result<Vec<f64>, TwinError> {
        let there = bench.score(&there, true)?;
        Ok(bench
            .demands(&here)
            .into_iter()
            .zip(bench.demands(&there))
            .map(|(a, b)| b - a)
            .collect())
    };
    let most = [HIGHEST[0], HIGHEST[1], at.dmax, HIGHEST[3]];
    let mut changes: [Vec<f64>; 4] = Default::default();
    for (k, own) in changes.iter_mut().enumerate() {
        let mut x = at.array();
        x[k] = step(x[k], STEPS[k], most[k]);
        // The impedance at touch is at most the full one.
        x[2] = x[2].min(x[3]);
        // A demand that a step breaks tells nothing of its size.
        let known = |d: f64| if d.is_finite() { d } else { 0.0 };
        *own = over(Parameters::of(x))?.into_iter().map(known).collect();
    }
    let [damping, width, d0, dmax] =
        [0, 1, 2, 3].map(|k| changes[k].iter().map(|d| d * d).sum::<f64>().sqrt());
    Ok(Sensitivity {
        damping,
        width,
        d0,
        dmax,
        together_steps: together_steps(&changes),
    })
}

/// Best of the trials that were judged in full.
fn best_of(trials: &[Trial]) -> Option<usize> {
    let full = (0..trials.len()).filter(|k| trials[*k].score.ripple_nmm.is_some());
    full.min_by(|a, b| trials[*a].score.total.total_cmp(&trials[*b].score.total))
}

fn neighbours(p: &Parameters) -> Vec<Parameters> {
    let lowest = [LOWEST[0], LOWEST[1], LOWEST[2], p.d0];
    let highest = [HIGHEST[0], HIGHEST[1], p.dmax, HIGHEST[3]];
    let mut all = Vec::new();
    for sign in [-1.0, 1.0] {
        for k in 0..4 {
            let mut x = p.array();
            x[k] = (x[k] + sign * STEPS[k]).clamp(lowest[k], highest[k]);
            all.push(Parameters::of(x));
        }
    }
    all.retain(|q| q != p);
    all
}

type Shared = RefCell<(TrialRig, Vec<Trial>, Option<TwinError>)>;

/// NLopt around a place, within about two of the grid's steps.
fn search(
    stage: &'static str,
    algorithm: Algorithm,
    from: &Parameters,
    evaluations: u32,
    shared: &Shared,
    progress: &impl Fn(&Trial),
) -> Result<(), TwinError> {
    // Share of dmax stands for d0, so that d0 <= dmax holds by itself.
    let mut start = from.array();
    start[2] = from.d0 / from.dmax.max(1e-6);
    let reach = [0.01, 2.0, 0.2, 0.1];
    let lower = [0, 1, 2, 3].map(|k| (start[k] - reach[k]).max(LOWEST[k]));
    let upper = [0, 1, 2, 3].map(|k| (start[k] + reach[k]).min(HIGHEST[k]));
    let objective = |x: &[f64], _: Option<&mut [f64]>, _: &mut ()| {
        let parameters = Parameters::of([x[0], x[1], x[2] * x[3], x[3]]);
        let (bench, trials, error) = &mut *shared.borrow_mut();
        match bench.score(&parameters, true) {
            Ok(score) => {
                let trial = Trial {
                    stage,
                    parameters,
                    score,
                };
                progress(&trial);
                trials.push(trial);
                score.total
            }
            Err(e) => {
                *error = Some(e);
                f64::MAX
            }
        }
    };
    let mut opt = Nlopt::new(algorithm, 4, objective, Target::Minimize, ());
    opt.set_lower_bounds(&lower)
        .and_then(|_| opt.set_upper_bounds(&upper))
        .and_then(|_| opt.set_maxeval(evaluations.max(1)))
        .map_err(|e| TwinError::value("NLopt", "a search", format!("{e:?}")))?;
    let mut x = [0, 1, 2, 3].map(|k| start[k].clamp(lower[k], upper[k]));
    // How it ended is not asked: the best trial counts.
    let _ = opt.optimize(&mut x);
    drop(opt);
    shared.borrow_mut().2.take().map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_that_trade_are_not_determined_together() {
        let changes = |d0: Vec<f64>| {
            [
                vec![5.0, 0.0, 0.0],
                vec![0.0, 4.0, 0.0],
                d0,
                vec![0.0, 0.0, 0.0],
            ]
        };
        // Width and d0 do the same to the demands; dmax does nothing.
        let traded = together_steps(&changes(vec![0.0, 8.0, 0.0]));
        assert!(
            (traded[0] - 0.2).abs() < 1e-9 && traded[1..].iter().all(|sd| *sd > 100.0),
            "{traded:?}"
        );
        let sensitivity = Sensitivity {
            damping: 5.0,
            width: 4.0,
            d0: 8.0,
            dmax: 0.0,
            together_steps: traded,
        };
        assert_eq!(sensitivity.undetermined(), ["width", "d0", "dmax"]);
        // Negative control: separately, each is as well known as it acts.
        let separate = together_steps(&changes(vec![0.0, 0.0, 8.0]));
        assert!(
            (separate[1] - 0.25).abs() < 1e-9 && (separate[2] - 0.125).abs() < 1e-9,
            "{separate:?}"
        );
    }

    #[test]
    fn the_time_constant_of_a_known_ring_down_is_found() {
        let t: Vec<f64> = (0..2000).map(|k| f64::from(k) * 1e-3).collect();
        let creep: Vec<f64> = t.iter().map(|t| 3.0 + 2.0 * (-t / 0.12).exp()).collect();
        assert!((ring_down_s(&t, &creep).unwrap() - 0.12).abs() < 2e-3);
        // A vibration's envelope, to within a half period.
        let ring: Vec<f64> = t
            .iter()
            .map(|t| (-t / 0.12).exp() * (200.0 * t).cos())
            .collect();
        assert!((ring_down_s(&t, &ring).unwrap() - 0.12).abs() < 0.017);
        assert!(ring_down_s(&t[..5], &ring[..5]).is_none());
    }
}
