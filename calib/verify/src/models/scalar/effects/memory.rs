//! Operators with memory over the sequence of readings.

use crate::models::relaxation::{approach, relax};

/// Exact solution of r' = (u - r)/tau along the readings, u linear between them, starting in
/// equilibrium.
pub(crate) fn relaxed(u: &[f64], time: &[f64], tau: f64) -> Vec<f64> {
    relaxed_from(u.first().copied().unwrap_or_default(), u, time, tau)
}

/// The same from another state at the first reading.
pub(crate) fn relaxed_from(first: f64, u: &[f64], time: &[f64], tau: f64) -> Vec<f64> {
    let mut out = u.to_vec();
    if let Some(start) = out.first_mut() {
        *start = first;
    }
    for k in 1..u.len() {
        let x = (time[k] - time[k - 1]) / tau;
        out[k] = relax(out[k - 1], [u[k - 1], u[k]], x);
    }
    out
}

/// The same of a stimulus that jumps between readings, each time at that share of the interval: it
/// was held until then, and is from then on.
pub(crate) fn relaxed_by_steps(u: &[f64], time: &[f64], tau: f64, moment: f64) -> Vec<f64> {
    let mut out = u.to_vec();
    for k in 1..u.len() {
        // Held at the old stimulus until the jump, at the new one after it: two exact relaxations.
        let x = (time[k] - time[k - 1]) / tau;
        // Before the interval's beginning, where an estimate scatters about it: not beyond what can
        // be written.
        let at_step = u[k - 1] + (out[k - 1] - u[k - 1]) * (-moment * x).min(300.0).exp();
        out[k] = u[k] + (at_step - u[k]) * (-(1.0 - moment) * x).exp();
    }
    out
}

/// Relative standard deviation of what remains of a relaxation at the first reading after the
/// stimulus jumped, at a moment between two readings that nothing tells (all alike: m from 0 to 1,
/// `e^{m x}`, `x` the interval in time constants). The stimulus jumps where it is held before and
/// after; the largest jump counts. 0 where it moves evenly.
pub(crate) fn spread_of_jumps(u: &[f64], time: &[f64], tau: f64) -> f64 {
    let held = |k: usize| u[k] == u[k - 1];
    let jumps = (2..u.len().saturating_sub(1)).filter(|&k| !held(k) && held(k - 1) && held(k + 1));
    let size = |k: &usize| (u[*k] - u[k - 1]).abs();
    let Some(largest) = jumps.max_by(|a, b| size(a).total_cmp(&size(b))) else {
        return 0.0;
    };
    let x = ((time[largest] - time[largest - 1]) / tau).clamp(1e-6, 50.0);
    // Moments of e^{m x}, m uniform from 0 to 1.
    let mean = x.exp_m1() / x;
    let variance = (2.0 * x).exp_m1() / (2.0 * x) - mean * mean;
    variance.max(0.0).sqrt() / mean
}

/// Play: the output stays until the play is taken up, true on the way up. `begun`: how far toward
/// the other end it is taken up at first.
pub(crate) fn play(u: &[f64], width: f64, begun: f64) -> Vec<f64> {
    let mut held = u.first().copied().unwrap_or_default() + begun * width;
    u.iter()
        .map(|&x| {
            // Play operator: the output is held inside a band of the input.
            held = held.clamp(x, x + width);
            held
        })
        .collect()
}

/// Bouc-Wen state with n = 1 (Wen 1976): tends to the sign of the motion over the distance `width`.
pub(crate) fn bouc_wen(u: &[f64], width: f64) -> Vec<f64> {
    let mut state = 0.0;
    let mut before = u.first().copied().unwrap_or_default();
    u.iter()
        .map(|&x| {
            let step = x - before;
            before = x;
            let target = if step == 0.0 { state } else { step.signum() };
            state = approach(state, target, step.abs() / width);
            state
        })
        .collect()
}

/// The stimulus at an earlier time, linear between readings; before the first one it stood still,
/// or, `moving`, went on as it does after it: u(t0 - d) = 2 u(t0) - u(t0 + d).
pub(crate) fn delayed(u: &[f64], time: &[f64], delay: f64, moving: bool) -> Vec<f64> {
    let Some((&first, &begun)) = u.first().zip(time.first()) else {
        return Vec::new();
    };
    let at = |t: f64| {
        let j = time
            .partition_point(|x| *x <= t)
            .clamp(1, time.len().max(2) - 1);
        let gap = time[j] - time[j - 1];
        if gap > 0.0 {
            u[j - 1] + (u[j] - u[j - 1]) * ((t - time[j - 1]) / gap).clamp(0.0, 1.0)
        } else {
            u[j]
        }
    };
    let stimulus = |t: f64| match begun - t {
        _ if u.len() < 2 => first,
        before if before < 0.0 => at(t),
        before if moving => 2.0 * first - at(begun + before),
        _ => first,
    };
    time.iter().map(|t| stimulus(t - delay)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relaxation_does_not_depend_on_the_step() {
        let time: Vec<f64> = (0..=1000).map(|k| f64::from(k) / 1000.0).collect();
        let fine = relaxed(&time, &time, 0.3);
        let coarse = relaxed(&[0.0, 1.0], &[0.0, 1.0], 0.3);
        assert!((fine[1000] - coarse[1]).abs() < 1e-12);
        // Ramp through a first-order lag: t - tau (1 - exp(-t/tau)).
        assert!((coarse[1] - (1.0 - 0.3 * (1.0 - (-1.0f64 / 0.3).exp()))).abs() < 1e-12);
    }

    #[test]
    fn a_step_at_the_reading_is_not_seen_by_it() {
        let (u, time) = ([20.0, 80.0, 80.0], [0.0, 5.0, 10.0]);
        let stepped = |moment| relaxed_by_steps(&u, &time, 25.0, moment);
        let after = |s: f64| 80.0 - 60.0 * (-s / 25.0f64).exp();
        for (moment, s) in [(1.0, [0.0, 5.0]), (0.4, [3.0, 8.0]), (0.0, [5.0, 10.0])] {
            let out = stepped(moment);
            assert!(
                (1..3).all(|k| (out[k] - after(s[k - 1])).abs() < 1e-12),
                "{moment}: {out:?}"
            );
        }
    }

    #[test]
    fn what_no_reading_saw_of_a_jump_is_uniform_in_time() {
        let time: Vec<f64> = (0..8).map(f64::from).collect();
        let jump = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0];
        // A tenth of a time constant: its uniform spread.
        assert!((spread_of_jumps(&jump, &time, 10.0) - 0.1 / 12f64.sqrt()).abs() < 1e-4);
        assert_eq!(spread_of_jumps(&time, &time, 10.0), 0.0);
    }

    #[test]
    fn a_ramp_is_delayed_by_the_delay() {
        let time: Vec<f64> = (0..50).map(f64::from).collect();
        let out = delayed(&time, &time, 3.25, false);
        assert!((out[40] - 36.75).abs() < 1e-12 && out[0] == 0.0);
        assert_eq!(delayed(&time, &time, 0.0, false), time);
        // In motion before the first reading, too: the state of a ramp is its delay.
        assert!((delayed(&time, &time, 3.25, true)[0] + 3.25).abs() < 1e-12);
    }

    /// Another state at the first reading is one more column: r' = (u - r) / tau is linear.
    #[test]
    fn the_first_state_dies_away_with_the_time_constant() {
        let time: Vec<f64> = (0..50).map(f64::from).collect();
        let u: Vec<f64> = time.iter().map(|t| (0.3 * t).sin()).collect();
        let (still, other) = (relaxed(&u, &time, 7.0), relaxed_from(-2.0, &u, &time, 7.0));
        let died = |tau: f64| {
            (0..50).all(|k| (other[k] - still[k] + 2.0 * (-time[k] / tau).exp()).abs() < 1e-12)
        };
        assert!(died(7.0) && !died(7.1));
    }

    #[test]
    fn play_lags_only_after_the_reversal() {
        let up_down = [0.0, 1.0, 2.0, 1.95, 1.0, 0.0];
        assert_eq!(play(&up_down, 0.1, 0.0), vec![0.0, 1.0, 2.0, 2.0, 1.1, 0.1]);
        assert_eq!(play(&up_down, 0.1, 0.5)[0], 0.05);
        let state = bouc_wen(&up_down, 1e-6);
        assert!(state[2] > 0.999 && state[4] < -0.999);
    }
}
