//! What trials of damping and contact run on: a wire that is let go, one that falls on a plate, and a sweep over a ball by both engines.
//!
//! Let go: the wire bent by F = 3 EI delta / l^3 (small deflection delta of a straight cantilever of length l). Bounce: greatest speed of the
//! tip between first and second touch over that before, divided by the undamped wire's. Damping per joint c = zeta k, from the paper's joints
//! of length L / 39: zeta = c L / (39 EI). Source of the cantilever: S. Timoshenko, "Strength of Materials".

use super::{Parameters, Score, Targets, ring_down_s};
use crate::convex::Convex;
use crate::engine::protocol::{Request, Series};
use crate::mjcf::{MjcfOptions, Touch, WorldParts, mjcf_among};
use crate::rod_comparison::compare_speeds;
use crate::{MujocoEngine, TwinError};
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_sim::{Mesh, SweepPlan, objects};

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
/// Speeds of the sweep, mm/s (the measured pair of docs/src/system.md), and its length, mm.
const SPEEDS_MM_S: [f64; 2] = [3.2, 7.7];
const SWEEP_MM: f64 = 28.0;
/// Plate: how far the wire at rest is pressed by it, and half its side, mm. Steps that bend the wire, and those watched of one that falls on
/// the plate and of a free one: a strongly damped wire takes seconds to come back.
const PRESSED_MM: f64 = 0.5;
const PLATE_MM: f64 = 5.0;
const BEND_STEPS: u64 = 1500;
const PLATE_STEPS: u64 = 600;
const FREE_STEPS: u64 = 2500;
/// The released wire's deflection at two thirds of the straight reach, share of that reach.
const DEFLECTION: f64 = 0.1;

/// What trials run on.
pub(super) struct TrialRig {
    whisker: WhiskerSpec,
    targets: Targets,
    engine: MujocoEngine,
    ball: (Mesh, Convex),
    ei_nmm2: f64,
    length_mm: f64,
    reach_mm: f64,
    bare_bounce: f64,
}

impl TrialRig {
    pub(super) fn new(whisker: &WhiskerSpec, targets: Targets) -> Result<Self, TwinError> {
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
        let mesh = objects::built_in("ball")?;
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

    pub(super) fn options(&self, p: &Parameters) -> MjcfOptions {
        // N mm s/rad over the stiffness of a joint of the paper's length.
        let damping_s = (p.damping_nms_rad * 1e3 * (self.length_mm / PAPER_LINKS) / self.ei_nmm2).max(BARE_S);
        let within = |d: f64| d.clamp(IMPEDANCES[0], IMPEDANCES[1]);
        let touch =
            Touch { impedance: [within(p.d0), within(p.dmax)], width_mm: p.width_mm, ..Touch::default() };
        MjcfOptions { links: TRIED_LINKS, damping_s, touch, ..MjcfOptions::default() }
    }

    pub(super) fn score(&mut self, p: &Parameters, full: bool) -> Result<Score, TwinError> {
        let free = self.released(p, false)?;
        let moments: Vec<f64> = free.base_elastic_nm.iter().map(|m| m[2]).collect();
        let ring_down_s = ring_down_s(&free.time_s, &moments).filter(|_| !free.bad).unwrap_or(f64::NAN);
        let bounce_ratio = bounce(&self.released(p, true)?).unwrap_or(f64::NAN) / self.bare_bounce;
        let mut score =
            Score { ring_down_s, bounce_ratio, ripple_nmm: None, bias: None, overlap_mm: None, total: 0.0 };
        if full {
            let plan = SweepPlan {
                max_travel_mm: SWEEP_MM,
                rate_hz: 10.0,
                gap_mm: [30.0, 30.0],
                lead_mm: [1.0, 1.0],
                ..SweepPlan::default()
            };
            let rows = compare_speeds(
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
            // Without a sweep kept there is neither ripple nor bias.
            let answered = rows.iter().all(|r| r.samples > 0);
            score.ripple_nmm = Some(if answered { ripple } else { f64::NAN });
            (score.bias, score.overlap_mm) = (Some(bias), Some(overlap));
        }
        let square = |d: f64| if d.is_finite() { d * d } else { BROKEN };
        score.total = self.demands(&score).into_iter().map(square).sum();
        Ok(score)
    }

    /// What a trial leaves of each demand, in units of what counts.
    pub(super) fn demands(&self, score: &Score) -> Vec<f64> {
        let mut demands = Vec::new();
        if let Some(wanted) = self.targets.bounce_ratio {
            demands.push((score.bounce_ratio - wanted) / UNITS[1]);
        }
        if let Some(wanted) = self.targets.ring_down_s {
            demands.push((score.ring_down_s.max(1e-4) / wanted).ln() / UNITS[0]);
        }
        if let (Some(ripple), Some(bias), Some(overlap)) = (score.ripple_nmm, score.bias, score.overlap_mm) {
            demands.push((ripple - self.targets.ripple_nmm) / UNITS[2]);
            demands.push((bias - self.targets.bias) / UNITS[3]);
            demands.push(overlap / (self.whisker.diameter_mm / 2.0));
        }
        demands
    }

    /// The wire bent aside and let go, with or without a plate that it falls on.
    fn released(&mut self, p: &Parameters, plate: bool) -> Result<Series, TwinError> {
        let options = self.options(p);
        let radius_mm = self.whisker.diameter_mm / 2.0;
        let mut around = WorldParts::default();
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
        // The force that bends a cantilever by the deflection.
        let force_n = 3.0 * self.ei_nmm2 * deflection / self.reach_mm.powi(3);
        let link_mm = self.length_mm / options.links as f64;
        let link = ((self.reach_mm / link_mm) as usize).saturating_sub(1);
        self.engine.frame(&Request::Push {
            body: format!("link{link}"),
            along_m: link_mm * 1e-3,
            force_n: [0.0, force_n, 0.0],
            steps: BEND_STEPS,
        })?;
        self.engine.series(if plate { PLATE_STEPS } else { FREE_STEPS }, 1)
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
