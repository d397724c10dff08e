//! Effects on what the gratings sense of the moment: the bond between wire and fibre.

use crate::effect::LawRequirement::Time;
use crate::effect::{Effect, Values, law};
use crate::models::relaxation::{approach, relax};
use crate::whisker::whisker_effect::WhiskerEffect;

/// Creep of the bond: m + a relaxed(m), integrated over the whole run, unloaded moves included.
/// Linear viscoelasticity, one or two Prony terms or a spectrum that gives log-time creep.
pub(crate) fn creep() -> WhiskerEffect {
    const GRID: &[f64] = &[1.0, 10.0, 100.0, 1000.0];
    let (share, seconds) = ([0.0, 0.3], [0.3, 3000.0]);
    let creep = |name| {
        let timed = law(name).needing(&[Time]);
        timed.amplitude("creep_fraction", "1", share, 0.02)
    };
    let grid = &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
    let prony = creep("prony").shape("time_constant_s", "s", seconds, grid);
    let two = creep("prony-2")
        .shape("time_constant_s", "s", seconds, GRID)
        .amplitude("second_creep_fraction", "1", share, 0.02)
        .shape("second_time_constant_s", "s", seconds, GRID);
    WhiskerEffect {
        sensor: |values, memory, dt_s, m| {
            // Weights and time constants; equal weights on constants spaced by half decades make
            // creep in log time from 1 s to about an hour.
            let spectrum = if values.law() == "log-time" {
                let share = values.of("creep_fraction") / 8.0;
                (0..8).map(|k| (share, 10f64.powf(0.5 * f64::from(k)))).collect()
            } else {
                pairs(values)
            };
            // Prony sum: m + sum a_k r_k with tau_k r_k' = m - r_k.
            memory.sensed(spectrum, m, |state, before, tau_s| {
                let Some(dt_s) = dt_s else { return state };
                [0, 1].map(|c| relax(state[c], [before[c], m[c]], dt_s / tau_s))
            })
        },
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

/// Size and width of each element.
fn pairs(values: &Values) -> Vec<(f64, f64)> {
    values.all().chunks(2).map(|p| (p[0], p[1])).collect()
}

/// No response below a moment m0: play of the seat, radial or by axis.
pub(crate) fn dead_zone() -> WhiskerEffect {
    let threshold = |name| law(name).amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05);
    WhiskerEffect {
        sensor: |values, _, _, m| {
            let threshold_nmm = values.of("threshold_nmm");
            // What lies below the threshold is taken off, as play does.
            let past = |size: f64| (size - threshold_nmm).max(0.0);
            if values.law() == "radial" {
                let size = m[0].hypot(m[1]);
                m.map(|v| v * past(size) / size.max(f64::MIN_POSITIVE))
            } else {
                m.map(|v| v.signum() * past(v.abs()))
            }
        },
        ..WhiskerEffect::new(
            "dead-zone",
            "Dead zone: small moments do not reach the gratings (play in the bond or the mounting).",
            vec![threshold("radial"), threshold("by-axis")],
        )
    }
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
    let plays = ["play_1_nmm", "play_2_nmm", "play_3_nmm", "play_4_nmm"];
    let stack = law("prandtl-ishlinskii").amplitudes(plays, "N mm", size, 0.01);
    let two = one("two-plays", narrow, &[0.02, 0.06, 0.2])
        .amplitude("second_loop_nmm", "N mm", size, 0.01)
        .shape("second_width_nmm", "N mm", narrow, &[0.06, 0.2, 0.6]);
    WhiskerEffect {
        sensor: |values, memory, _, m| {
            let loops = if values.law() == "prandtl-ishlinskii" {
                values.all().iter().copied().zip(STACK_WIDTHS_NMM).collect()
            } else {
                pairs(values)
            };
            memory.sensed(loops, m, |state, before, width| {
                next(
                    values.law(),
                    state,
                    [m[0] - before[0], m[1] - before[1]],
                    width,
                )
            })
        },
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
        // dz = (sign(dm) - z) |dm| / w: it relaxes along the way of the load, not in time.
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
