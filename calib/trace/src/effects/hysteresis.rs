//! Rate-independent memory of the moment. Readings taken while loading only show it too: the wire comes back unloaded between them.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::path::WhiskerPath;
use crate::whisker::WhiskerEffect;

/// See the module.
pub struct Hysteresis;

impl Candidate for Hysteresis {
    fn id(&self) -> &'static str {
        "hysteresis"
    }
    fn laws(&self) -> Vec<Law> {
        vec![
            law("bouc-wen").amplitude("loop_nmm", "N mm", [-0.3, 0.3], 0.01).shape(
                "width_nmm",
                "N mm",
                [0.01, 2.0],
                &[0.05, 0.15, 0.5],
            ),
            law("play").amplitude("loop_nmm", "N mm", [-0.3, 0.3], 0.01).shape(
                "width_nmm",
                "N mm",
                [0.01, 1.0],
                &[0.03, 0.1, 0.3],
            ),
            law("bouc-wen-vector").amplitude("loop_nmm", "N mm", [-0.3, 0.3], 0.01).shape(
                "width_nmm",
                "N mm",
                [0.01, 2.0],
                &[0.05, 0.15, 0.5],
            ),
        ]
    }
    fn refinements(&self) -> Vec<Law> {
        let (size, width) = ([-0.3, 0.3], [0.01, 1.0]);
        vec![
            law("play-vector").amplitude("loop_nmm", "N mm", size, 0.01).shape(
                "width_nmm",
                "N mm",
                width,
                &[0.03, 0.1, 0.3],
            ),
            law("two-plays")
                .amplitude("loop_nmm", "N mm", size, 0.01)
                .shape("width_nmm", "N mm", width, &[0.02, 0.06, 0.2])
                .amplitude("second_loop_nmm", "N mm", size, 0.01)
                .shape("second_width_nmm", "N mm", width, &[0.06, 0.2, 0.6]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The readings depend on whether the load was rising or falling, whatever the speed."
    }
    fn source(&self) -> &'static str {
        "Bouc-Wen with n = 1 (Wen 1976) and play operators (Prandtl-Ishlinskii), in the plane as a body dragged on a rope"
    }
}

impl WhiskerEffect for Hysteresis {
    fn sensor(&self, law: usize, values: &[f64], _path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let driven = moments_nmm.to_vec();
        for parameters in values.chunks(2) {
            let (size, width) = (parameters[0], parameters[1]);
            let mut state = [0.0_f64; 2];
            let mut before = [0.0_f64; 2];
            for (m, now) in moments_nmm.iter_mut().zip(&driven) {
                let step = [now[0] - before[0], now[1] - before[1]];
                state = next(law, state, step, width);
                m[0] += size * state[0];
                m[1] += size * state[1];
                before = *now;
            }
        }
    }
}

/// State of a hysteresis law, scaled to +-1, after a step of the moment.
fn next(law: usize, mut state: [f64; 2], step: [f64; 2], width: f64) -> [f64; 2] {
    let length = step[0].hypot(step[1]);
    match law {
        0 => [0, 1].map(|c| approach(state[c], step[c].signum(), step[c].abs() / width)),
        2 if length > 0.0 => [0, 1].map(|c| approach(state[c], step[c] / length, length / width)),
        2 => state,
        // Play in the plane: the state follows on a rope of one length.
        3 => {
            state = [0, 1].map(|c| state[c] + step[c] / width);
            let far = state[0].hypot(state[1]).max(1.0);
            state.map(|x| x / far)
        }
        // Play of half width w: the state follows once the play is used up.
        _ => [0, 1].map(|c| (state[c] + step[c] / width).clamp(-1.0, 1.0)),
    }
}

/// dz/dx = target - z over the distance `x`: the state tends to the side that the load moves to.
fn approach(z: f64, target: f64, x: f64) -> f64 {
    target + (z - target) * (-x).exp()
}
