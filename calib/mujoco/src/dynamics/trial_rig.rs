//! What trials of damping and contact run on: a wire that is let go, one that falls on a plate, and
//! one that is led past a ball at two speeds.
//!
//! Let go: the wire bent by F = 3 EI delta / l^3 (small deflection delta of a straight cantilever
//! of length l). Bounce: greatest speed of the tip between first and second touch over that before,
//! divided by the undamped wire's. Damping per joint c = zeta k, from the paper's joints of length
//! L / 39: zeta = c L / (39 EI). Source of the cantilever: S. Timoshenko, "Strength of Materials".

use crate::engine::protocol::{Request, Series};
use crate::mjcf::{MjcfOptions, Touch, WorldParts, mjcf_among};
use crate::{MujocoEngine, TwinError};
use nalgebra::Vector3;
use serde::Serialize;
use wcal_core::observation::{RestShape, WhiskerSpec};

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

impl Parameters {
    pub(super) fn of([damping_nms_rad, width_mm, d0, dmax]: [f64; 4]) -> Self {
        Self {
            damping_nms_rad,
            width_mm,
            d0,
            dmax,
        }
    }

    pub(super) fn array(&self) -> [f64; 4] {
        [self.damping_nms_rad, self.width_mm, self.d0, self.dmax]
    }
}

/// What is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Targets {
    /// Time in which the released wire's base moment falls to 1/e for good, s; not judged without a
    /// record.
    pub ring_down_s: Option<f64>,
    /// Speed of the bounce over that of the undamped wire; not judged where the recorded wire crept
    /// to the plate without a bounce.
    pub bounce_ratio: Option<f64>,
    /// Ripple of the sweep's moments, N mm; 0 without a record: as little as can be.
    pub ripple_nmm: f64,
    /// Change of the mean moment from 3.2 to 7.7 mm/s, as a share; 0 without a record.
    pub bias: f64,
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

/// Time constant of a ring-down: the last time at which the moment is above 1/e of its start, s.
/// The end's mean is taken off.
pub fn ring_down_s(time_s: &[f64], moment: &[f64]) -> Option<f64> {
    let tail = moment.len() / 10;
    if time_s.len() != moment.len() || tail == 0 {
        return None;
    }
    let rest = moment[moment.len() - tail..].iter().sum::<f64>() / tail as f64;
    let size = |k: usize| (moment[k] - rest).abs();
    let start = size(0);
    // The last crossing: a vibration passes 1/e many times before it stays below.
    let last = (0..moment.len())
        .rev()
        .find(|k| size(*k) > start / std::f64::consts::E)?;
    Some(time_s[last] - time_s[0])
}

/// MuJoCo keeps impedances within these.
const IMPEDANCES: [f64; 2] = [0.0001, 0.9999];
/// Links of the paper's cable, and of the one that is tried: damping scales with their number.
const PAPER_LINKS: f64 = 39.0;
const TRIED_LINKS: usize = 20;
/// What counts as a unit of each demand: relative ring-down, bounce ratio, ripple (N mm), speed
/// bias; overlap in wire radii.
const UNITS: [f64; 4] = [0.2, 0.1, 0.01, 0.01];
/// What a demand counts that a trial does not answer (unstable, or through the object).
const BROKEN: f64 = 1e3;
/// Material time of the undamped wire, s: what the step of 1 ms can follow.
const BARE_S: f64 = 1e-3;
/// Speeds of the sweep, mm/s (the measured pair of docs/src/system.md), and its length, mm.
const SPEEDS_MM_S: [f64; 2] = [3.2, 7.7];
const SWEEP_MM: f64 = 28.0;
/// Way between two samples of the sweep, mm: at the same places at both speeds.
const SAMPLE_MM: f64 = 0.5;
/// The ball: radius, middle beside the wire's plane, gap between the base and the part of it in
/// that plane, and way before it is touched, mm.
const BALL_MM: f64 = 30.0;
const ASIDE_MM: f64 = -10.0;
const GAP_MM: f64 = 30.0;
const LEAD_MM: f64 = 1.0;
/// Points of the wire at which its reach is looked for.
const REACH_POINTS: u32 = 200;
/// Weight of the body that leads the wire, kg: contacts do not move it.
const BASE_KG: f64 = 1e3;
/// Share of steps between touching and free past which a sample chatters, and of such samples past
/// which the sweep is no answer.
const CHATTER: f64 = 0.1;
const MAX_CHATTER: f64 = 0.2;
/// Plate: how far the wire at rest is pressed by it, and half its side, mm. Steps that bend the
/// wire, and those watched of one that falls on the plate and of a free one: a strongly damped wire
/// takes seconds to come back.
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
    ei_nmm2: f64,
    length_mm: f64,
    /// Of the straight part, at least a third of the wire.
    straight_mm: f64,
    /// How far the wire reaches along its root's direction.
    reach_mm: f64,
    bare_bounce: f64,
}

impl TrialRig {
    pub(super) fn new(whisker: &WhiskerSpec, targets: Targets) -> Result<Self, TwinError> {
        let section =
            wcal_rod::Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
        let (length_mm, straight_mm) = match &whisker.rest_shape {
            RestShape::StraightArc {
                straight_mm,
                length_mm,
                ..
            } => (*length_mm, straight_mm.max(length_mm / 3.0)),
            RestShape::Polyline(points) => {
                let length: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                (length, length / 3.0)
            }
        };
        let shape = wcal_rod::Shape::new(&whisker.rest_shape, 0.25)
            .map_err(|e| TwinError::value("whisker", "a wire that can be bent", e.to_string()))?;
        let along = (0..=REACH_POINTS).map(|k| f64::from(k) / f64::from(REACH_POINTS) * length_mm);
        let reach_mm = along
            .map(|s_mm| shape.rest_point(s_mm).x)
            .fold(0.0, f64::max);
        let mut bench = Self {
            whisker: whisker.clone(),
            targets,
            engine: MujocoEngine::start()?,
            ei_nmm2: section.ei_nmm2,
            length_mm,
            straight_mm,
            reach_mm,
            bare_bounce: 1.0,
        };
        // The undamped wire on a hard contact is the unit of the bounce.
        let hard = Touch::default();
        let bare = Parameters::of([0.0, hard.width_mm, hard.impedance[0], hard.impedance[1]]);
        bench.bare_bounce = bounce(&bench.released(&bare, true)?)
            .unwrap_or(1.0)
            .max(1e-3);
        Ok(bench)
    }

    pub(super) fn options(&self, p: &Parameters) -> MjcfOptions {
        // N mm s/rad over the stiffness of a joint of the paper's length.
        let damping_s =
            (p.damping_nms_rad * 1e3 * (self.length_mm / PAPER_LINKS) / self.ei_nmm2).max(BARE_S);
        let within = |d: f64| d.clamp(IMPEDANCES[0], IMPEDANCES[1]);
        let touch = Touch {
            impedance: [within(p.d0), within(p.dmax)],
            width_mm: p.width_mm,
            ..Touch::default()
        };
        MjcfOptions {
            links: TRIED_LINKS,
            damping_s,
            touch,
            ..MjcfOptions::default()
        }
    }

    pub(super) fn score(&mut self, p: &Parameters, full: bool) -> Result<Score, TwinError> {
        let free = self.released(p, false)?;
        // The wire is let go along y: the moment about z rings.
        let moments: Vec<f64> = free.base_elastic_nm.iter().map(|m| m[2]).collect();
        let ring_down_s = ring_down_s(&free.time_s, &moments)
            .filter(|_| !free.bad)
            .unwrap_or(f64::NAN);
        let bounce_ratio = bounce(&self.released(p, true)?).unwrap_or(f64::NAN) / self.bare_bounce;
        let mut score = Score {
            ring_down_s,
            bounce_ratio,
            ripple_nmm: None,
            bias: None,
            overlap_mm: None,
            total: 0.0,
        };
        if full {
            // Without an answer at both speeds there is neither ripple nor bias.
            let [ripple, bias, overlap] = match SPEEDS_MM_S.map(|speed| self.swept(p, speed)) {
                [Ok(Some(slow)), Ok(Some(fast))] => compared(&slow, &fast),
                [Err(e), _] | [_, Err(e)] => return Err(e),
                _ => [f64::NAN; 3],
            };
            score.ripple_nmm = Some(ripple);
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
        if let (Some(ripple), Some(bias), Some(overlap)) =
            (score.ripple_nmm, score.bias, score.overlap_mm)
        {
            demands.push((ripple - self.targets.ripple_nmm) / UNITS[2]);
            demands.push((bias - self.targets.bias) / UNITS[3]);
            demands.push(overlap / (self.whisker.diameter_mm / 2.0));
        }
        demands
    }

    /// The wire led past the ball at a speed; none where a step went wrong, the contact chatters,
    /// or the wire went through the ball.
    fn swept(&mut self, p: &Parameters, speed_mm_s: f64) -> Result<Option<Swept>, TwinError> {
        let mut options = self.options(p);
        options.touch.friction = 0.0;
        // In the wire's plane the ball is a circle; along the way of the base its lowest point
        // within the wire's reach is touched first.
        let circle_mm = leg(BALL_MM, ASIDE_MM);
        let beyond_mm = (GAP_MM + circle_mm - self.reach_mm).max(0.0);
        let middle = Vector3::new(
            GAP_MM + circle_mm,
            ASIDE_MM,
            LEAD_MM + leg(circle_mm, beyond_mm),
        ) * 1e-3;
        let around = WorldParts {
            bodies: format!(
                "<geom name=\"ball\" type=\"sphere\" pos=\"{} {} {}\" size=\"{}\" contype=\"2\" conaffinity=\"1\" {}/>",
                middle.x,
                middle.y,
                middle.z,
                BALL_MM * 1e-3,
                options.touch.attributes()
            ),
            base: [
                String::new(),
                format!(
                    "<inertial pos=\"0 0 0\" mass=\"{BASE_KG}\" diaginertia=\"1 1 1\"/><joint name=\"base\" type=\"slide\" axis=\"0 0 1\"/>"
                ),
            ],
            ..WorldParts::default()
        };
        let step_s = self
            .engine
            .load(&mjcf_among(&self.whisker, &options, &around)?, false)?
            .step_s;
        let (mut swept, mut taken, mut chatter) = (
            Swept {
                moments_nmm: Vec::new(),
                overlap_mm: 0.0,
            },
            0,
            0.0,
        );
        for place in 1..=(SWEEP_MM / SAMPLE_MM) as u32 {
            // Counted from the start, so that the rounding to whole steps does not add up.
            let end = (f64::from(place) * SAMPLE_MM / speed_mm_s / step_s).round() as u64;
            let steps = end - taken;
            let frame = self.engine.frame(&Request::Lead {
                speed_m_s: speed_mm_s * 1e-3,
                acceleration_m_s2: 0.0,
                steps,
            })?;
            taken = end;
            let moment = frame
                .base_moment_nm
                .filter(|m| !frame.bad && m.iter().all(|x| x.is_finite()));
            // A wire deeper than its radius goes on through the ball.
            let Some(moment) =
                moment.filter(|_| frame.deepest_m * 1e3 <= self.whisker.diameter_mm / 2.0)
            else {
                return Ok(None);
            };
            chatter += f64::from(u8::from(frame.toggles as f64 > CHATTER * steps as f64));
            let pushed = frame
                .contacts
                .iter()
                .filter(|c| Vector3::from(c.force_n).norm() > 0.0);
            let overlaps: Vec<f64> = pushed.map(|c| -c.gap_m * 1e3).collect();
            swept.overlap_mm = overlaps.iter().copied().fold(swept.overlap_mm, f64::max);
            swept
                .moments_nmm
                .push((!overlaps.is_empty()).then(|| Vector3::from(moment) * 1e3));
        }
        Ok(Some(swept).filter(|s| chatter <= MAX_CHATTER * s.moments_nmm.len() as f64))
    }

    /// The wire bent aside and let go, with or without a plate that it falls on.
    fn released(&mut self, p: &Parameters, plate: bool) -> Result<Series, TwinError> {
        let options = self.options(p);
        let radius_mm = self.whisker.diameter_mm / 2.0;
        let mut around = WorldParts::default();
        if plate {
            // Across the straight part's end; the wire comes from +y.
            // Its face lies PRESSED_MM above the underside of the wire at rest.
            let y = (PRESSED_MM - radius_mm - PLATE_MM) * 1e-3;
            around.bodies = format!(
                "<geom name=\"plate\" type=\"box\" pos=\"{} {y} 0\" size=\"{half} {half} {half}\" contype=\"2\" conaffinity=\"1\" {}/>",
                self.straight_mm * 0.9e-3,
                options.touch.attributes(),
                half = PLATE_MM * 1e-3
            );
        }
        self.engine
            .load(&mjcf_among(&self.whisker, &options, &around)?, false)?;
        let deflection = DEFLECTION * self.straight_mm;
        // The force that bends a cantilever by the deflection.
        let force_n = 3.0 * self.ei_nmm2 * deflection / self.straight_mm.powi(3);
        let link_mm = self.length_mm / options.links as f64;
        let link = ((self.straight_mm / link_mm) as usize).saturating_sub(1);
        self.engine.frame(&Request::Push {
            body: format!("link{link}"),
            along_m: link_mm * 1e-3,
            force_n: [0.0, force_n, 0.0],
            steps: BEND_STEPS,
        })?;
        self.engine
            .series(if plate { PLATE_STEPS } else { FREE_STEPS }, 1)
    }
}

/// A sweep over the ball.
struct Swept {
    /// Moments at the root, place after place, N mm; none where the wire is free.
    moments_nmm: Vec<Option<Vector3<f64>>>,
    /// Deepest overlap with the ball, mm.
    overlap_mm: f64,
}

/// The other leg of a right triangle.
fn leg(long: f64, short: f64) -> f64 {
    (long * long - short * short).max(0.0).sqrt()
}

/// Ripple (N mm), bias by the speed, and overlap (mm) of two sweeps.
///
/// Ripple: RMS of m_i - (m_(i-1) + m_i + m_(i+1)) / 3; bias: sum |m_i| of the fast sweep over that
/// of the slow one where both touch, less 1.
fn compared(slow: &Swept, fast: &Swept) -> [f64; 3] {
    // Minus a third of the second difference: what is straight over three places drops out.
    let ripple = |s: &Swept| {
        let off = |w: &[Option<Vector3<f64>>]| {
            Some((w[1]? - (w[0]? + w[1]? + w[2]?) / 3.0).norm_squared())
        };
        let squares: Vec<f64> = s.moments_nmm.windows(3).filter_map(off).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    // Where one sweep is free of the ball a share of its moment would mean nothing.
    let both = slow
        .moments_nmm
        .iter()
        .zip(&fast.moments_nmm)
        .filter_map(|(s, f)| Some(((*s)?, (*f)?)));
    let sums = both.fold([0.0; 2], |[a, b], (s, f)| [a + s.norm(), b + f.norm()]);
    [
        ripple(slow).max(ripple(fast)),
        sums[1] / sums[0] - 1.0,
        slow.overlap_mm.max(fast.overlap_mm),
    ]
}

/// Fastest tip between the first touch and the next over the fastest before it; 0 where it stays on
/// the plate, none where a step went wrong or the plate was not reached.
fn bounce(series: &Series) -> Option<f64> {
    if series.bad {
        return None;
    }
    let touch = series.touching.iter().position(|t| *t)?;
    let fastest = |range: std::ops::Range<usize>| {
        series.tip_speed_m_s[range]
            .iter()
            .copied()
            .fold(0.0, f64::max)
    };
    let before = fastest(0..touch.max(1));
    let Some(free) = series.touching[touch..]
        .iter()
        .position(|t| !*t)
        .map(|k| touch + k)
    else {
        return Some(0.0);
    };
    let again = series.touching[free..]
        .iter()
        .position(|t| *t)
        .map_or(series.touching.len(), |k| free + k);
    (before > 0.0).then(|| fastest(free..again) / before)
}
