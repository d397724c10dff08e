//! Rate-independent memory of the moment.

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
    fn sentence(&self) -> &'static str {
        "The readings depend on whether the load was rising or falling, whatever the speed."
    }
    fn source(&self) -> &'static str {
        "Bouc-Wen with n = 1 (Wen 1976) and play operators (Prandtl-Ishlinskii)"
    }
}

impl WhiskerEffect for Hysteresis {
    fn not_observable(&self, path: &WhiskerPath, _data: &wcal_core::WhiskerData) -> Option<String> {
        (!path.columns.both_directions).then(|| "no reading was taken while unloading".to_owned())
    }

    fn sensor(&self, law: usize, values: &[f64], _path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let (size, width) = (values[0], values[1]);
        let mut state = [0.0_f64; 2];
        let mut before = [0.0_f64; 2];
        for m in moments_nmm.iter_mut() {
            let now = *m;
            let step = [now[0] - before[0], now[1] - before[1]];
            match law {
                0 => {
                    for c in 0..2 {
                        state[c] = approach(state[c], step[c].signum(), step[c].abs() / width);
                    }
                }
                1 => {
                    // Play of half width w: the state follows once the play is used up; scaled to +-1.
                    for c in 0..2 {
                        state[c] = (state[c] + step[c] / width).clamp(-1.0, 1.0);
                    }
                }
                _ => {
                    let length = step[0].hypot(step[1]);
                    if length > 0.0 {
                        for c in 0..2 {
                            state[c] = approach(state[c], step[c] / length, length / width);
                        }
                    }
                }
            }
            for c in 0..2 {
                m[c] += size * state[c];
            }
            before = now;
        }
    }
}

/// dz/dx = target - z over the distance `x`: the state tends to the side that the load moves to.
fn approach(z: f64, target: f64, x: f64) -> f64 {
    target + (z - target) * (-x).exp()
}
