//! Natural continuation of the equilibrium along a straight path of the groove, from first touch,
//! in adaptive steps.
//!
//! Predictor: secant through the last two equilibria, x(l + dl) = x(l) + (x(l) - x(l')) dl / (l -
//! l'); corrector: Newton ([`super::solve`]). The step grows by 1.5 where Newton is quick and is
//! halved where it fails; a branch ends at a fold where the step falls below 1e-4 mm or the
//! determinant would change its sign. Source: E. Allgower & K. Georg, "Numerical Continuation
//! Methods" (1990), ch. 2 and 6.

use crate::kirchhoff::solve::{Equilibrium, Failure, Guess, Rod, Tangential};
use nalgebra::Vector3;

/// A straight path of the groove.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Groove point at 0, mm.
    pub origin_mm: Vector3<f64>,
    /// Unit vector of travel.
    pub direction: Vector3<f64>,
}

impl Line {
    /// Groove point at stage position `x_mm`.
    pub fn point(&self, x_mm: f64) -> Vector3<f64> {
        self.origin_mm + self.direction * x_mm
    }
}

/// What the model says at one stage position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Outcome {
    /// Equilibrium on the branch that starts at first touch.
    Held(Equilibrium),
    /// The groove has not reached the wire.
    NotTouched,
    /// The branch from first touch ended at `at_mm`: the wire snaps there.
    Snapped {
        /// Stage position of the end of the branch, mm.
        at_mm: f64,
    },
    /// The contact ran off the tip at `at_mm`.
    SlippedOff {
        /// Stage position, mm.
        at_mm: f64,
    },
}

impl Outcome {
    /// The equilibrium, if the wire is held.
    pub fn equilibrium(&self) -> Option<&Equilibrium> {
        match self {
            Self::Held(e) => Some(e),
            _ => None,
        }
    }
}

/// Where a path first meets the unloaded wire.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Stage position, mm.
    pub x_mm: f64,
    /// Arc length, mm.
    pub arclength_mm: f64,
    /// Distance between path and wire there, mm.
    pub gap_mm: f64,
}

/// Spacing of the samples of the wire in the search for first touch, mm.
const TOUCH_GRID_MM: f64 = 0.05;
/// Approaches within this of the closest one are caught by the groove's mouth, mm: wider than the
/// contact offsets of a bench (0.1-1.5 mm).
const MOUTH_MM: f64 = 2.0;

/// Golden-section search for the smallest gap around a sample.
fn golden_section(at: impl Fn(f64) -> Touch, sample: Touch, grid_mm: f64, length_mm: f64) -> Touch {
    let (mut a, mut b) = (
        (sample.arclength_mm - grid_mm).max(0.0),
        (sample.arclength_mm + grid_mm).min(length_mm),
    );
    // 0.618^60 is 3e-13: the bracket shrinks to rounding.
    for _ in 0..60 {
        let (c, d) = (b - 0.618_034 * (b - a), a + 0.618_034 * (b - a));
        if at(c).gap_mm < at(d).gap_mm {
            b = d
        } else {
            a = c
        }
    }
    let found = at(0.5 * (a + b));
    if found.gap_mm <= sample.gap_mm {
        found
    } else {
        sample
    }
}

const FIRST_STEP_MM: f64 = 0.5;
const LONGEST_STEP_MM: f64 = 4.0;
const SHORTEST_STEP_MM: f64 = 1e-4;

impl Rod {
    /// First approach of `line` to the unloaded wire along the travel, at a stage position in
    /// [-`back_mm`, `reach_mm`].
    ///
    /// A bent wire can be met twice: of the local minima of the gap that the groove's mouth would
    /// catch, the earliest counts. Where the travel ends before the wire, the closest point stands
    /// in.
    pub fn first_touch(&self, line: &Line, back_mm: f64, reach_mm: f64) -> Touch {
        let samples = (self.shape.length_mm / TOUCH_GRID_MM).ceil() as usize;
        let grid_mm = self.shape.length_mm / samples as f64;
        let at = |s: f64| {
            let wire = self.shape.rest_point(s);
            // The groove is nearest to a place of the wire at the foot of the perpendicular on its
            // path.
            let x_mm = (wire - line.origin_mm)
                .dot(&line.direction)
                .clamp(-back_mm, reach_mm);
            Touch {
                x_mm,
                arclength_mm: s,
                gap_mm: (line.point(x_mm) - wire).norm(),
            }
        };
        let sampled: Vec<Touch> = (1..=samples).map(|k| at(grid_mm * k as f64)).collect();
        let gap = |k: usize| sampled.get(k).map_or(f64::INFINITY, |t| t.gap_mm);
        // A sample below its neighbours brackets a minimum of the gap.
        let minima: Vec<Touch> = (0..samples)
            .filter(|&k| (k == 0 || gap(k) <= gap(k - 1)) && gap(k) < gap(k + 1))
            .map(|k| golden_section(at, sampled[k], grid_mm, self.shape.length_mm))
            .collect();
        let closest = minima
            .iter()
            .map(|t| t.gap_mm)
            .fold(f64::INFINITY, f64::min);
        minima
            .into_iter()
            .filter(|t| t.gap_mm <= closest + MOUTH_MM)
            // The end of the travel is an approach only if nothing else is.
            .min_by(|a, b| {
                let beyond = |t: &Touch| t.x_mm >= reach_mm && t.gap_mm > closest;
                beyond(a).cmp(&beyond(b)).then(a.x_mm.total_cmp(&b.x_mm))
            })
            .unwrap_or_else(|| at(self.shape.length_mm))
    }

    /// Frictionless branch at the stage positions `xs_mm` (any order); positions before first touch
    /// are `NotTouched`.
    pub fn follow(&self, line: &Line, xs_mm: &[f64]) -> Vec<Outcome> {
        let far = xs_mm.iter().copied().fold(0.0, f64::max);
        let near = xs_mm.iter().copied().fold(0.0, f64::min);
        let touch = self.first_touch(line, -near, far);
        let mut order: Vec<usize> = (0..xs_mm.len()).collect();
        order.sort_by(|&a, &b| xs_mm[a].total_cmp(&xs_mm[b]));
        let mut out = vec![Outcome::NotTouched; xs_mm.len()];
        let Some(mut tracker) = BranchTracker::start(self, line, &touch) else {
            return out;
        };
        for index in order {
            let x = xs_mm[index];
            out[index] = if x < touch.x_mm - 1e-9 {
                Outcome::NotTouched
            } else {
                tracker.advance_to(x)
            };
        }
        out
    }
}

/// Follows one branch of equilibria along a line; it keeps the last two for the secant predictor.
pub(crate) struct BranchTracker<'a> {
    rod: &'a Rod,
    line: Line,
    last: (f64, Equilibrium),
    before: Option<(f64, Equilibrium)>,
    step_mm: f64,
    end: Option<Outcome>,
}

impl<'a> BranchTracker<'a> {
    /// Starts at first touch: from the unloaded wire straight to the line, then along it.
    pub(crate) fn start(rod: &'a Rod, line: &Line, touch: &Touch) -> Option<Self> {
        let wire = rod.shape.rest_point(touch.arclength_mm);
        let target = line.point(touch.x_mm);
        let mut guess = Guess {
            force_n: Vector3::zeros(),
            arclength_mm: touch.arclength_mm,
        };
        // The unloaded wire is pulled across the gap in steps that Newton can follow.
        // A step of half a millimetre stays in Newton's basin.
        let pulls = (touch.gap_mm / FIRST_STEP_MM).ceil().max(1.0) as usize;
        let mut found = None;
        for k in 1..=pulls {
            let point = wire + (target - wire) * (k as f64 / pulls as f64);
            let e = rod.solve(&point, &guess, Tangential::Frictionless).ok()?;
            guess = Guess::from(&e);
            found = Some(e);
        }
        Some(Self {
            rod,
            line: *line,
            last: (touch.x_mm, found?),
            before: None,
            step_mm: FIRST_STEP_MM,
            end: None,
        })
    }

    /// Equilibrium at `x_mm`, which must not lie before the last one.
    pub(crate) fn advance_to(&mut self, x_mm: f64) -> Outcome {
        if let Some(end) = self.end {
            return end;
        }
        while self.last.0 < x_mm {
            let room = x_mm - self.last.0;
            let target = if self.step_mm >= room {
                x_mm
            } else {
                self.last.0 + self.step_mm
            };
            match self.try_step(target) {
                Ok(next) => {
                    let taken = target - self.last.0;
                    self.before = Some(self.last);
                    self.last = (target, next);
                    // A quick corrector: the secant is good for a longer step.
                    if next.iterations <= 4 {
                        self.step_mm = (taken.max(self.step_mm) * 1.5).min(LONGEST_STEP_MM);
                    }
                }
                Err(why) => {
                    // Nearer to the last point the secant is better, until the branch has ended.
                    self.step_mm = 0.5 * (target - self.last.0);
                    if self.step_mm < SHORTEST_STEP_MM {
                        let at_mm = self.last.0;
                        let end = match why {
                            Failure::PastTip => Outcome::SlippedOff { at_mm },
                            _ => Outcome::Snapped { at_mm },
                        };
                        self.end = Some(end);
                        return end;
                    }
                }
            }
        }
        Outcome::Held(self.last.1)
    }

    /// A step counts only if it stays close to the predictor and keeps the determinant's sign.
    fn try_step(&self, target: f64) -> Result<Equilibrium, Failure> {
        let last = &self.last.1;
        let guess = match &self.before {
            Some((x0, e0)) if self.last.0 - x0 > 1e-12 => {
                // Secant through the last two, extrapolated by at most twice their distance.
                let f = ((target - self.last.0) / (self.last.0 - x0)).min(2.0);
                Guess {
                    force_n: last.force_n + (last.force_n - e0.force_n) * f,
                    arclength_mm: last.arclength_mm + (last.arclength_mm - e0.arclength_mm) * f,
                }
            }
            _ => Guess::from(last),
        };
        let found = self
            .rod
            .solve(&self.line.point(target), &guess, Tangential::Frictionless)?;
        // Another branch: the contact jumps along the wire, or the determinant changes its sign.
        let travelled = target - self.last.0;
        let jump = (found.arclength_mm - last.arclength_mm).abs();
        if jump > 4.0 * travelled + 0.5 || found.determinant * last.determinant <= 0.0 {
            return Err(Failure::Singular);
        }
        Ok(found)
    }
}
