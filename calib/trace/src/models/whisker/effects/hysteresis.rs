//! Rate-independent memory of the moment. Readings taken while loading only show it too: the wire comes back unloaded between them.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::{Memory, WhiskerEffect};

/// See the module.
pub struct Hysteresis;

impl Effect for Hysteresis {
    fn id(&self) -> &'static str {
        "hysteresis"
    }
    fn laws(&self) -> Vec<EffectModel> {
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
    fn refinements(&self) -> Vec<EffectModel> {
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
            // Prandtl-Ishlinskii: a stack of plays whose widths cover what a bond shows, each with a size of its own.
            law("prandtl-ishlinskii")
                .amplitude("play_1_nmm", "N mm", size, 0.01)
                .amplitude("play_2_nmm", "N mm", size, 0.01)
                .amplitude("play_3_nmm", "N mm", size, 0.01)
                .amplitude("play_4_nmm", "N mm", size, 0.01),
        ]
    }
    fn helped_by(&self) -> Option<&'static str> {
        Some("the order of the rows, better t_s; direction (readings of loading and unloading)")
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "Rate-independent hysteresis: the readings differ between rising and falling load."
    }
    fn source(&self) -> &'static str {
        "Bouc-Wen with n = 1 (Wen 1976) and play operators (Prandtl-Ishlinskii), in the plane as a body dragged on a rope"
    }
}

impl WhiskerEffect for Hysteresis {
    fn memory(&self, values: &Values) -> Option<Box<dyn Memory>> {
        let loops: Vec<(f64, f64)> = if values.law() == "prandtl-ishlinskii" {
            values.all().iter().copied().zip(STACK_WIDTHS_NMM).collect()
        } else {
            values.all().chunks(2).map(|p| (p[0], p[1])).collect()
        };
        let states = vec![[0.0; 2]; loops.len()];
        Some(Box::new(Loops { law: values.law(), loops, states, before: [0.0; 2] }))
    }
}

/// Half widths of the plays of the stack, N mm.
const STACK_WIDTHS_NMM: [f64; 4] = [0.04, 0.1, 0.25, 0.6];

/// Sizes and widths of the loops with their states.
struct Loops {
    law: &'static str,
    loops: Vec<(f64, f64)>,
    states: Vec<[f64; 2]>,
    before: [f64; 2],
}

impl Loops {
    fn state(&self, k: usize, now: [f64; 2]) -> [f64; 2] {
        let step = [now[0] - self.before[0], now[1] - self.before[1]];
        next(self.law, self.states[k], step, self.loops[k].1)
    }
}

impl Memory for Loops {
    fn sensed(&self, _dt_s: Option<f64>, m: [f64; 2]) -> [f64; 2] {
        let mut sensed = m;
        for (k, (size, _)) in self.loops.iter().enumerate() {
            let state = self.state(k, m);
            sensed = [0, 1].map(|c| sensed[c] + size * state[c]);
        }
        sensed
    }

    fn accept(&mut self, _dt_s: Option<f64>, m: [f64; 2]) {
        self.states = (0..self.loops.len()).map(|k| self.state(k, m)).collect();
        self.before = m;
    }
}

/// State of a hysteresis law, scaled to +-1, after a step of the moment.
fn next(law: &str, mut state: [f64; 2], step: [f64; 2], width: f64) -> [f64; 2] {
    let length = step[0].hypot(step[1]);
    match law {
        "bouc-wen" => [0, 1].map(|c| approach(state[c], step[c].signum(), step[c].abs() / width)),
        "bouc-wen-vector" if length > 0.0 => {
            [0, 1].map(|c| approach(state[c], step[c] / length, length / width))
        }
        "bouc-wen-vector" => state,
        // Play in the plane: the state follows on a rope of one length.
        "play-vector" => {
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
