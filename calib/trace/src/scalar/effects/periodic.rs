//! Periodic effect: sine and cosine over stimulus, time or order, with a free frequency.

use super::{PERIODIC, law, shape};
use crate::candidate::{Candidate, Law};
use crate::scalar::frame::{Frame, correlation};
use crate::scalar::system::ScalarEffect;

/// See the module.
pub struct Periodic;

/// Half cycles: neighbouring frequencies are then still half in step, and the fit slides to the best between them.
const GRID: [f64; 199] = {
    let mut grid = [0.0; 199];
    let mut k = 0;
    while k < 199 {
        grid[k] = 1.0 + 0.5 * k as f64;
        k += 1;
    }
    grid
};

impl Candidate for Periodic {
    fn id(&self) -> &'static str {
        PERIODIC
    }
    fn laws(&self) -> Vec<Law> {
        let columns = [("sine", "response"), ("cosine", "response")];
        let cycles = |unit| vec![shape("period", unit, [0.6, 120.0], &GRID)];
        vec![
            law("over-stimulus", cycles("period:stimulus"), &columns),
            law("over-time", cycles("period:time"), &columns),
            law("over-order", cycles("period:order"), &columns),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The residual repeats with a fixed period."
    }
    fn source(&self) -> &'static str {
        "harmonic regression; frequencies up to the sampling limit or 100 cycles"
    }
}

/// Two covariates that run together this closely are one.
const SAME: f64 = 0.9999;
/// Fewer places than this do not show a period.
const LEAST_PLACES: usize = 12;

/// The covariate of a law, from 0 to 1, and how many different places it has; none where another law covers it.
fn variable(law: usize, frame: &Frame) -> Option<(Vec<f64>, usize)> {
    let same = |a: &[f64], b: &[f64]| correlation(a, b).abs() > SAME;
    let n = frame.scaling.count;
    match law {
        0 => Some((frame.u.iter().map(|u| 0.5 * (u + 1.0)).collect(), frame.levels())),
        1 => frame.time.as_ref().filter(|t| !same(t, &frame.u)).map(|t| (t.clone(), n)),
        _ => {
            let known =
                frame.time.as_ref().is_some_and(|t| same(t, &frame.order)) || same(&frame.u, &frame.order);
            (!known).then(|| (frame.order.clone(), n))
        }
    }
}

impl ScalarEffect for Periodic {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        (frame.scaling.count < LEAST_PLACES).then(|| format!("fewer than {LEAST_PLACES} readings"))
    }
    fn columns(&self, law: usize, values: &[f64], frame: &Frame, out: &mut Vec<Vec<f64>>) -> bool {
        let Some((place, places)) = variable(law, frame) else { return false };
        // Above half a cycle from place to place a frequency is another one's alias.
        if places < LEAST_PLACES || values[0] > 0.5 * (places as f64 - 1.0) {
            return false;
        }
        let phase: Vec<f64> = place.iter().map(|p| std::f64::consts::TAU * values[0] * p).collect();
        out.push(phase.iter().map(|p| p.sin()).collect());
        out.push(phase.iter().map(|p| p.cos()).collect());
        true
    }
}
