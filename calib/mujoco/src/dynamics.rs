//! Damping and contact of MuJoCo's wire: the paper's grid from coarse to fine, then NLopt around the best (all SIMULATED trials).
//!
//! Judged by the ring-down of a released wire (against a record), the bounce off a plate (half of the undamped wire's, SYSTEM), and on
//! a sweep over a ball against the quasi-static rod: ripple, speed bias, and how deep the wire overlaps the ball.

use crate::against::against_speed;
use crate::convex::Convex;
use crate::engine::protocol::{Request, Series};
use crate::mjcf::{MjcfOptions, Surroundings, Touch, mjcf_among};
use crate::{Mesh, MujocoEngine, SweepPlan, TwinError};
use nlopt::{Algorithm, Nlopt, Target};
use serde::Serialize;
use std::cell::RefCell;
use wcal_core::observation::{RestShape, WhiskerSpec};

/// The paper's grid: damping of its joints (N m s/rad), contact width (mm), impedances.
const DAMPINGS: [f64; 7] = [0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03];
const WIDTHS_MM: [f64; 2] = [1.0, 10.0];
const IMPEDANCE_STEP: f64 = 0.05;
/// MuJoCo keeps impedances within these.
const IMPEDANCES: [f64; 2] = [0.0001, 0.9999];
/// Links of the paper's cable, and of the one that is tried: damping scales with their number.
const PAPER_LINKS: f64 = 39.0;
const TRIED_LINKS: usize = 20;
/// What counts as a unit of each demand: relative ring-down, bounce ratio, ripple (N mm), speed bias; overlap in wire radii.
const UNITS: [f64; 4] = [0.2, 0.1, 0.01, 0.01];
/// What a demand counts that a trial does not answer (unstable, or through the object).
const BROKEN: f64 = 1e3;
/// Material time of the undamped wire, s: what the step of 1 ms can follow.
const BARE_S: f64 = 1e-3;
/// Speeds of the sweep, mm/s (SYSTEM's measured pair), and its length, mm.
const SPEEDS_MM_S: [f64; 2] = [3.2, 7.7];
const SWEEP_MM: f64 = 28.0;
/// Plate: how far the wire at rest is pressed by it, and half its side, mm. Steps that bend the wire, and those watched.
const PRESSED_MM: f64 = 0.5;
const PLATE_MM: f64 = 5.0;
const BEND_STEPS: u64 = 1500;
const WATCH_STEPS: u64 = 600;
/// The released wire's deflection at two thirds of the straight reach, share of that reach.
const DEFLECTION: f64 = 0.1;

/// What is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Parameters {
    /// Damping of a joint of the paper's cable (39 links), N m s/rad.
    pub damping_nms_rad: f64,
    /// Overlap at which the contact's impedance is full, mm.
    pub width_mm: f64,
    /// Impedance at touch.
    pub d0: f64,
    /// Full impedance, not below `d0`.
    pub dmax: f64,
}

/// What is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Targets {
    /// Time in which the released wire's base moment falls to 1/e for good, s; not judged without a record.
    pub ring_down_s: Option<f64>,
    /// Speed of the bounce over that of the undamped wire.
    pub bounce_ratio: f64,
}

/// What a trial gave.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Score {
    /// Ring-down, s.
    pub ring_down_s: f64,
    /// Bounce over the undamped wire's.
    pub bounce_ratio: f64,
    /// Ripple of the sweep's moments, N mm; none where the sweep was not run.
    pub ripple_nmm: Option<f64>,
    /// Change of the mean moment between the sweep's speeds, as a share.
    pub bias: Option<f64>,
    /// Deepest overlap, mm.
    pub overlap_mm: Option<f64>,
    /// Sum of squares over the units.
    pub total: f64,
}

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
    /// Options of the best, 40 links.
    #[serde(skip)]
    pub options: MjcfOptions,
}

/// Time constant of a ring-down: the last time at which the moment is above 1/e of its start, s. The end's mean is taken off.
#[must_use]
pub fn ring_down_s(time_s: &[f64], moment: &[f64]) -> Option<f64> {
    let tail = moment.len() / 10;
    if time_s.len() != moment.len() || tail == 0 {
        return None;
    }
    let rest = moment[moment.len() - tail..].iter().sum::<f64>() / tail as f64;
    let size = |k: usize| (moment[k] - rest).abs();
    let start = size(0);
    let last = (0..moment.len()).rev().find(|k| size(*k) > start / std::f64::consts::E)?;
    Some(time_s[last] - time_s[0])
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
    let mut bench = Bench::new(whisker, targets)?;
    let mut trials: Vec<Trial> = Vec::new();
    let mut add = |bench: &mut Bench, stage, parameters, full| -> Result<f64, TwinError> {
        let trial = Trial { stage, parameters, score: bench.score(&parameters, full)? };
        progress(&trial);
        trials.push(trial);
        Ok(trial.score.total)
    };
    // Damping with a hard contact, then the contact with that damping: the two barely meet in ring-down and overlap.
    let mut best = Parameters { damping_nms_rad: 0.0, width_mm: 1.0, d0: 0.95, dmax: 1.0 };
    let mut least = f64::INFINITY;
    for damping in DAMPINGS {
        let tried = Parameters { damping_nms_rad: damping, ..best };
        let total = add(&mut bench, "grid-damping", tried, true)?;
        if total < least {
            (least, best.damping_nms_rad) = (total, damping);
        }
    }
    let mut candidates: Vec<(f64, Parameters)> = Vec::new();
    for width_mm in [1.0, 4.0, 7.0, 10.0] {
        for (d0, dmax) in [(0.0, 0.5), (0.0, 1.0), (0.5, 0.5), (0.5, 1.0), (0.8, 0.95), (0.95, 1.0)] {
            let tried = Parameters { width_mm, d0, dmax, ..best };
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
    // Neighbours on the paper's own steps, until none is better.
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
    for (stage, algorithm) in [("bobyqa", Algorithm::Bobyqa), ("crs2", Algorithm::Crs2Lm)] {
        let from = best_of(&shared.borrow().1).map_or(best, |k| shared.borrow().1[k].parameters);
        search(stage, algorithm, &from, evaluations, &shared, &progress)?;
    }
    let (bench, trials, _) = shared.into_inner();
    let best = best_of(&trials).ok_or_else(|| TwinError::Engine("no trial was judged in full".to_owned()))?;
    let options =
        MjcfOptions { links: MjcfOptions::default().links, ..bench.options(&trials[best].parameters) };
    Ok(DynamicsFit { trials, best, options })
}

/// Best of the trials that were judged in full.
fn best_of(trials: &[Trial]) -> Option<usize> {
    let full = (0..trials.len()).filter(|k| trials[*k].score.ripple_nmm.is_some());
    full.min_by(|a, b| trials[*a].score.total.total_cmp(&trials[*b].score.total))
}

fn neighbours(p: &Parameters) -> Vec<Parameters> {
    let mut all = Vec::new();
    for sign in [-1.0, 1.0] {
        let damping = (p.damping_nms_rad + sign * 0.005).clamp(0.0, 0.03);
        all.push(Parameters { damping_nms_rad: damping, ..*p });
        all.push(Parameters { width_mm: (p.width_mm + sign).clamp(WIDTHS_MM[0], WIDTHS_MM[1]), ..*p });
        all.push(Parameters { d0: (p.d0 + sign * IMPEDANCE_STEP).clamp(0.0, p.dmax), ..*p });
        all.push(Parameters { dmax: (p.dmax + sign * IMPEDANCE_STEP).clamp(p.d0, 1.0), ..*p });
    }
    all.retain(|q| q != p);
    all
}

type Shared = RefCell<(Bench, Vec<Trial>, Option<TwinError>)>;

/// NLopt within two of the grid's steps around a place.
fn search(
    stage: &'static str,
    algorithm: Algorithm,
    from: &Parameters,
    evaluations: u32,
    shared: &Shared,
    progress: &impl Fn(&Trial),
) -> Result<(), TwinError> {
    let fault = |e: String| TwinError::Value { what: "NLopt", expected: "a search".to_owned(), found: e };
    // Share of dmax stands for d0, so that d0 <= dmax holds by itself.
    let start = [from.damping_nms_rad, from.width_mm, from.d0 / from.dmax.max(1e-6), from.dmax];
    let reach = [0.01, 2.0, 0.2, 0.1];
    let (lowest, highest) = ([0.0, WIDTHS_MM[0], 0.0, 0.05], [0.03, WIDTHS_MM[1], 1.0, 1.0]);
    let lower: Vec<f64> = (0..4).map(|k| (start[k] - reach[k]).max(lowest[k])).collect();
    let upper: Vec<f64> = (0..4).map(|k| (start[k] + reach[k]).min(highest[k])).collect();
    let objective = |x: &[f64], _: Option<&mut [f64]>, _: &mut ()| {
        let parameters = Parameters { damping_nms_rad: x[0], width_mm: x[1], d0: x[2] * x[3], dmax: x[3] };
        let (bench, trials, error) = &mut *shared.borrow_mut();
        match bench.score(&parameters, true) {
            Ok(score) => {
                let trial = Trial { stage, parameters, score };
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
    opt.set_lower_bounds(&lower).map_err(|e| fault(format!("{e:?}")))?;
    opt.set_upper_bounds(&upper).map_err(|e| fault(format!("{e:?}")))?;
    opt.set_maxeval(evaluations.max(1)).map_err(|e| fault(format!("{e:?}")))?;
    let mut x: Vec<f64> = (0..4).map(|k| start[k].clamp(lower[k], upper[k])).collect();
    // How it ended is not asked: the best trial counts.
    let _ = opt.optimize(&mut x);
    drop(opt);
    shared.borrow_mut().2.take().map_or(Ok(()), Err)
}

/// What trials run on.
struct Bench {
    whisker: WhiskerSpec,
    targets: Targets,
    engine: MujocoEngine,
    ball: (Mesh, Convex),
    ei_nmm2: f64,
    length_mm: f64,
    reach_mm: f64,
    bare_bounce: f64,
}

impl Bench {
    fn new(whisker: &WhiskerSpec, targets: Targets) -> Result<Self, TwinError> {
        let section = wcal_rod::Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
        let (length_mm, reach_mm) = match &whisker.rest_shape {
            RestShape::StraightArc { straight_mm, length_mm, .. } => {
                (*length_mm, straight_mm.max(length_mm / 3.0))
            }
            RestShape::Polyline(points) => {
                let length: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                (length, length / 3.0)
            }
        };
        let mesh = crate::objects::built_in("ball")?;
        // Convex already: no need of CoACD.
        let parts = vec![mesh.points().map(Into::into).collect()];
        let convex = Convex { made_from: "ball".to_owned(), parts, beyond_mm: 0.0, short_mm: 0.0 };
        let mut bench = Self {
            whisker: whisker.clone(),
            targets,
            engine: MujocoEngine::start()?,
            ball: (mesh, convex),
            ei_nmm2: section.ei_nmm2,
            length_mm,
            reach_mm,
            bare_bounce: 1.0,
        };
        let hard = Touch::default();
        let bare = Parameters {
            damping_nms_rad: 0.0,
            width_mm: hard.width_mm,
            d0: hard.impedance[0],
            dmax: hard.impedance[1],
        };
        bench.bare_bounce = bounce(&bench.released(&bare, true)?).unwrap_or(1.0).max(1e-3);
        Ok(bench)
    }

    fn options(&self, p: &Parameters) -> MjcfOptions {
        // N mm s/rad over the stiffness of a joint of the paper's length.
        let damping_s = (p.damping_nms_rad * 1e3 * (self.length_mm / PAPER_LINKS) / self.ei_nmm2).max(BARE_S);
        let within = |d: f64| d.clamp(IMPEDANCES[0], IMPEDANCES[1]);
        let touch =
            Touch { impedance: [within(p.d0), within(p.dmax)], width_mm: p.width_mm, ..Touch::default() };
        MjcfOptions { links: TRIED_LINKS, damping_s, touch, ..MjcfOptions::default() }
    }

    fn score(&mut self, p: &Parameters, full: bool) -> Result<Score, TwinError> {
        let free = self.released(p, false)?;
        let moments: Vec<f64> = free.base_elastic_nm.iter().map(|m| m[2]).collect();
        let ring_down_s = ring_down_s(&free.time_s, &moments).filter(|_| !free.bad).unwrap_or(f64::NAN);
        let bounce_ratio = bounce(&self.released(p, true)?).unwrap_or(f64::NAN) / self.bare_bounce;
        let mut demands = vec![(bounce_ratio - self.targets.bounce_ratio) / UNITS[1]];
        if let Some(wanted) = self.targets.ring_down_s {
            demands.push((ring_down_s.max(1e-4) / wanted).ln() / UNITS[0]);
        }
        let mut score =
            Score { ring_down_s, bounce_ratio, ripple_nmm: None, bias: None, overlap_mm: None, total: 0.0 };
        if full {
            let plan = SweepPlan {
                most_mm: SWEEP_MM,
                rate_hz: 10.0,
                gap_mm: [30.0, 30.0],
                lead_mm: [1.0, 1.0],
                ..SweepPlan::default()
            };
            let rows = against_speed(
                &self.whisker,
                &self.options(p),
                std::slice::from_ref(&self.ball),
                &plan,
                &SPEEDS_MM_S,
                1,
            )?
            .by_speed;
            let ripple = rows.iter().map(|r| r.ripple_nmm).fold(0.0, f64::max);
            let overlap = rows.iter().map(|r| r.overlap_mm).fold(0.0, f64::max);
            let bias = rows[1].bias - rows[0].bias;
            score.ripple_nmm = Some(ripple);
            (score.bias, score.overlap_mm) = (Some(bias), Some(overlap));
            // Without a sweep kept there is neither ripple nor bias.
            let answered = rows.iter().all(|r| r.samples > 0);
            let ripple = if answered { ripple } else { f64::NAN };
            demands.extend([ripple / UNITS[2], bias / UNITS[3], overlap / (self.whisker.diameter_mm / 2.0)]);
        }
        score.total = demands.iter().map(|d| if d.is_finite() { d * d } else { BROKEN }).sum();
        Ok(score)
    }

    /// The wire bent aside and let go, with or without a plate that it falls on.
    fn released(&mut self, p: &Parameters, plate: bool) -> Result<Series, TwinError> {
        let options = self.options(p);
        let radius_mm = self.whisker.diameter_mm / 2.0;
        let mut around = Surroundings::default();
        if plate {
            // Across the straight part's end; the wire comes from +y.
            let y = (PRESSED_MM - radius_mm - PLATE_MM) * 1e-3;
            around.bodies = format!(
                "<geom name=\"plate\" type=\"box\" pos=\"{} {y} 0\" size=\"{half} {half} {half}\" contype=\"2\" conaffinity=\"1\" {}/>",
                self.reach_mm * 0.9e-3,
                options.touch.attributes(),
                half = PLATE_MM * 1e-3
            );
        }
        self.engine.load(&mjcf_among(&self.whisker, &options, &around)?, false)?;
        let deflection = DEFLECTION * self.reach_mm;
        let force_n = 3.0 * self.ei_nmm2 * deflection / self.reach_mm.powi(3);
        let link_mm = self.length_mm / options.links as f64;
        let link = ((self.reach_mm / link_mm) as usize).saturating_sub(1);
        self.engine.frame(&Request::Push {
            body: format!("link{link}"),
            along_m: link_mm * 1e-3,
            force_n: [0.0, force_n, 0.0],
            steps: BEND_STEPS,
        })?;
        self.engine.series(WATCH_STEPS, 1)
    }
}

/// Fastest tip between the first touch and the next over the fastest before it; 0 where it stays on the plate, none where a step went
/// wrong or the plate was not reached.
fn bounce(series: &Series) -> Option<f64> {
    if series.bad {
        return None;
    }
    let touch = series.touching.iter().position(|t| *t)?;
    let fastest =
        |range: std::ops::Range<usize>| series.tip_speed_m_s[range].iter().copied().fold(0.0, f64::max);
    let before = fastest(0..touch.max(1));
    let Some(free) = series.touching[touch..].iter().position(|t| !*t).map(|k| touch + k) else {
        return Some(0.0);
    };
    let again = series.touching[free..].iter().position(|t| *t).map_or(series.touching.len(), |k| free + k);
    (before > 0.0).then(|| fastest(free..again) / before)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_constant_of_a_known_ring_down_is_found() {
        let t: Vec<f64> = (0..2000).map(|k| f64::from(k) * 1e-3).collect();
        let creep: Vec<f64> = t.iter().map(|t| 3.0 + 2.0 * (-t / 0.12).exp()).collect();
        assert!((ring_down_s(&t, &creep).unwrap() - 0.12).abs() < 2e-3);
        // A vibration's envelope, to within a half period.
        let ring: Vec<f64> = t.iter().map(|t| (-t / 0.12).exp() * (200.0 * t).cos()).collect();
        assert!((ring_down_s(&t, &ring).unwrap() - 0.12).abs() < 0.017);
        assert!(ring_down_s(&t[..5], &ring[..5]).is_none());
    }
}
