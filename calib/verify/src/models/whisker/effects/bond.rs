//! Effects on what the gratings sense of the moment: the bond between wire and fibre.

use crate::effect::{Effect, LawRequirement, law};
use crate::whisker::whisker_effect::{Memory, WhiskerEffect};

/// Creep of the bond: m + a relaxed(m), integrated over the whole run, unloaded moves included.
/// Linear viscoelasticity, one or two Prony terms or a spectrum that gives log-time creep.
pub(crate) fn creep() -> WhiskerEffect {
    const GRID: &[f64] = &[1.0, 10.0, 100.0, 1000.0];
    let (share, seconds) = ([0.0, 0.3], [0.3, 3000.0]);
    let creep = |name| {
        let timed = law(name).needing(&[LawRequirement::Time]);
        timed.amplitude("creep_fraction", "1", share, 0.02)
    };
    let grid = &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
    let prony = creep("prony").shape("time_constant_s", "s", seconds, grid);
    let two = creep("prony-2")
        .shape("time_constant_s", "s", seconds, GRID)
        .amplitude("second_creep_fraction", "1", share, 0.02)
        .shape("second_time_constant_s", "s", seconds, GRID);
    WhiskerEffect {
        memory: Some(|values| {
            // Weights and time constants; equal weights on constants spaced by half decades make
            // creep in log time from 1 s to about an hour.
            let spectrum: Vec<(f64, f64)> = if values.law() == "log-time" {
                let share = values.of("creep_fraction") / 8.0;
                (0..8).map(|k| (share, 10f64.powf(0.5 * f64::from(k)))).collect()
            } else {
                values.all().chunks(2).map(|p| (p[0], p[1])).collect()
            };
            Box::new(Elements::new(spectrum, |state, [before, now], dt_s, tau_s| {
                let Some(dt_s) = dt_s else { return state };
                [0, 1].map(|c| relax(state[c], before[c], now[c], dt_s, tau_s))
            }))
        }),
        ..Effect {
            refinements: vec![two],
            has_memory: true,
            ..Effect::new(
                "creep",
                "The bond of the gratings creeps: the wavelengths keep changing after the load has settled.",
                vec![prony, creep("log-time")],
            )
        }
        .into()
    }
}

/// State of an element after a step: its state, the moments before and after, the time between, its
/// time constant or width.
type NextState = dyn Fn([f64; 2], [[f64; 2]; 2], Option<f64>, f64) -> [f64; 2] + Send;

/// Elements side by side: what is sensed is the moment and, weighted, the state of each, which
/// follows the moment with a memory.
struct Elements {
    /// Weight, and time constant or width.
    elements: Vec<(f64, f64)>,
    next: Box<NextState>,
    states: Vec<[f64; 2]>,
    before: [f64; 2],
}

impl Elements {
    fn new(
        elements: Vec<(f64, f64)>,
        next: impl Fn([f64; 2], [[f64; 2]; 2], Option<f64>, f64) -> [f64; 2] + Send + 'static,
    ) -> Self {
        let states = vec![[0.0; 2]; elements.len()];
        Self {
            elements,
            next: Box::new(next),
            states,
            before: [0.0; 2],
        }
    }

    fn states(&self, dt_s: Option<f64>, m: [f64; 2]) -> Vec<[f64; 2]> {
        let of =
            |(e, state): (&(f64, f64), &[f64; 2])| (self.next)(*state, [self.before, m], dt_s, e.1);
        self.elements.iter().zip(&self.states).map(of).collect()
    }
}

impl Memory for Elements {
    fn sensed(&self, dt_s: Option<f64>, m: [f64; 2]) -> [f64; 2] {
        let states = self.states(dt_s, m);
        let add =
            |sum: [f64; 2], (e, s): (&(f64, f64), &[f64; 2])| [0, 1].map(|c| sum[c] + e.0 * s[c]);
        self.elements.iter().zip(&states).fold(m, add)
    }

    fn accept(&mut self, dt_s: Option<f64>, m: [f64; 2]) {
        self.states = self.states(dt_s, m);
        self.before = m;
    }
}

/// Exact solution of r' = (m - r)/tau over a step in which m goes linearly from `m0` to `m1`.
pub(crate) fn relax(r: f64, m0: f64, m1: f64, dt_s: f64, tau_s: f64) -> f64 {
    if dt_s <= 0.0 {
        return r;
    }
    let x = dt_s / tau_s;
    let decay = (-x).exp();
    let slope = (m1 - m0) / x;
    m1 - slope + (r - m0 + slope) * decay
}

/// No response below a moment m0: play of the seat, radial or by axis.
pub(crate) fn dead_zone() -> WhiskerEffect {
    let threshold = |name| law(name).amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05);
    WhiskerEffect {
        memory: Some(|values| {
            let radial = values.law() == "radial";
            Box::new(DeadZoneState {
                radial,
                threshold_nmm: values.of("threshold_nmm"),
            })
        }),
        ..WhiskerEffect::new(
            "dead-zone",
            "Dead zone: small moments do not reach the gratings (play in the bond or the mounting).",
            vec![threshold("radial"), threshold("by-axis")],
        )
    }
}

/// A sensor that feels what is past a threshold; it remembers nothing.
struct DeadZoneState {
    radial: bool,
    threshold_nmm: f64,
}

impl Memory for DeadZoneState {
    fn sensed(&self, _dt_s: Option<f64>, m: [f64; 2]) -> [f64; 2] {
        if self.radial {
            let size = m[0].hypot(m[1]);
            let left = if size > self.threshold_nmm {
                1.0 - self.threshold_nmm / size
            } else {
                0.0
            };
            [m[0] * left, m[1] * left]
        } else {
            m.map(|v| v.signum() * (v.abs() - self.threshold_nmm).max(0.0))
        }
    }

    fn accept(&mut self, _dt_s: Option<f64>, _moment_nmm: [f64; 2]) {}
}

/// Rate-independent memory of the moment: Bouc-Wen with n = 1 (Wen 1976) and play operators
/// (Prandtl-Ishlinskii), in the plane as a body dragged on a rope. Readings taken while loading
/// only show it too: the wire comes back unloaded between them.
pub(crate) fn hysteresis() -> WhiskerEffect {
    let (size, narrow, wide) = ([-0.3, 0.3], [0.01, 1.0], [0.01, 2.0]);
    let one = |name, width, grid| {
        law(name)
            .amplitude("loop_nmm", "N mm", size, 0.01)
            .shape("width_nmm", "N mm", width, grid)
    };
    // A stack of plays whose widths cover what a bond shows, each with its own size.
    let stack = ["play_1_nmm", "play_2_nmm", "play_3_nmm", "play_4_nmm"]
        .into_iter()
        .fold(law("prandtl-ishlinskii"), |stack, name| {
            stack.amplitude(name, "N mm", size, 0.01)
        });
    let two = one("two-plays", narrow, &[0.02, 0.06, 0.2])
        .amplitude("second_loop_nmm", "N mm", size, 0.01)
        .shape("second_width_nmm", "N mm", narrow, &[0.06, 0.2, 0.6]);
    WhiskerEffect {
        memory: Some(|values| {
            let loops: Vec<(f64, f64)> = if values.law() == "prandtl-ishlinskii" {
                values.all().iter().copied().zip(STACK_WIDTHS_NMM).collect()
            } else {
                values.all().chunks(2).map(|p| (p[0], p[1])).collect()
            };
            let law = values.law();
            Box::new(Elements::new(
                loops,
                move |state, [before, now], _, width| {
                    next(law, state, [now[0] - before[0], now[1] - before[1]], width)
                },
            ))
        }),
        ..Effect {
            refinements: vec![one("play-vector", narrow, &[0.03, 0.1, 0.3]), two, stack],
            has_memory: true,
            ..Effect::new(
                "hysteresis",
                "Rate-independent hysteresis: the readings differ between rising and falling load.",
                vec![
                    one("bouc-wen", wide, &[0.05, 0.15, 0.5]),
                    one("play", narrow, &[0.03, 0.1, 0.3]),
                    one("bouc-wen-vector", wide, &[0.05, 0.15, 0.5]),
                ],
            )
        }
        .into()
    }
}

/// Half widths of the plays of the stack, N mm.
const STACK_WIDTHS_NMM: [f64; 4] = [0.04, 0.1, 0.25, 0.6];

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

#[cfg(test)]
mod tests {
    use super::relax;

    #[test]
    fn many_small_steps_give_the_same_as_one() {
        let one = relax(0.3, 1.0, 2.0, 7.0, 5.0);
        let mut r = 0.3;
        for k in 0..1000 {
            let (a, b) = (1.0 + f64::from(k) / 1000.0, 1.0 + f64::from(k + 1) / 1000.0);
            r = relax(r, a, b, 7.0 / 1000.0, 5.0);
        }
        assert!((one - r).abs() < 1e-12, "{one} {r}");
        let mut euler = 0.3;
        for k in 0..100_000 {
            let m = 1.0 + f64::from(k) / 1e5;
            euler += (m - euler) / 5.0 * 7.0 / 1e5;
        }
        assert!((one - euler).abs() < 1e-4);
    }
}
