//! Effects between the rod's moment and the sensor that remember: lag, hysteresis, dead zone,
//! creep, permanent set.

use crate::effects::{Effect, Kind};
use crate::layout::Instant;

type M = [f64; 2];

/// First-order relaxation toward a signal that runs straight from `from` to `to` within `dt`.
fn relax(z: f64, from: f64, to: f64, dt: f64, tau: f64) -> f64 {
    if dt <= 0.0 {
        return z;
    }
    let q = (-dt / tau).exp();
    let late = 1.0 - tau / dt * (1.0 - q);
    z * q + to * late + from * (1.0 - q - late)
}

/// Relaxed copy of a signal.
fn relaxed(motion: &[Instant], m: &[M], tau: f64) -> Vec<M> {
    let mut z = [0.0; 2];
    let (mut before, mut t) = ([0.0; 2], 0.0);
    motion
        .iter()
        .zip(m)
        .map(|(i, m)| {
            for c in 0..2 {
                z[c] = relax(z[c], before[c], m[c], i.t_s - t, tau);
            }
            (before, t) = (*m, i.t_s);
            z
        })
        .collect()
}

fn add(m: &mut [M], other: &[M], weight: f64) {
    for (m, o) in m.iter_mut().zip(other) {
        m[0] += weight * o[0];
        m[1] += weight * o[1];
    }
}

/// Signal a time `delay` ago.
fn delayed(motion: &[Instant], m: &[M], delay: f64) -> Vec<M> {
    motion
        .iter()
        .map(|i| {
            let t = i.t_s - delay;
            let k = motion.partition_point(|j| j.t_s <= t);
            if k == 0 {
                return m[0];
            }
            if k == motion.len() {
                return m[k - 1];
            }
            let share = (t - motion[k - 1].t_s) / (motion[k].t_s - motion[k - 1].t_s);
            [0, 1].map(|c| m[k - 1][c] + share * (m[k][c] - m[k - 1][c]))
        })
        .collect()
}

/// Signal minus a play operator of half width `radius`, per component.
fn play(m: &[M], radius: f64) -> Vec<M> {
    let mut p = [0.0_f64; 2];
    m.iter()
        .map(|m| {
            for c in 0..2 {
                p[c] = p[c].clamp(m[c] - radius, m[c] + radius);
            }
            [p[0] - m[0], p[1] - m[1]]
        })
        .collect()
}

/// Play in the plane: the follower is dragged along a rope of length `radius`.
fn vector_play(m: &[M], radius: f64) -> Vec<M> {
    let mut p = [0.0_f64; 2];
    m.iter()
        .map(|m| {
            let gap = [p[0] - m[0], p[1] - m[1]];
            let far = gap[0].hypot(gap[1]);
            if far > radius {
                p = [m[0] + gap[0] * radius / far, m[1] + gap[1] * radius / far];
            }
            [p[0] - m[0], p[1] - m[1]]
        })
        .collect()
}

/// Plastic bending with full hardening: past the onset each new largest moment leaves its rise
/// behind, in its own direction.
fn set(m: &[M], onset: f64) -> Vec<M> {
    let (mut left, mut largest) = ([0.0; 2], onset);
    m.iter()
        .map(|m| {
            let size = m[0].hypot(m[1]);
            if size > largest {
                left = [0, 1].map(|c| left[c] + (size - largest) * m[c] / size);
                largest = size;
            }
            left
        })
        .collect()
}

/// Bouc-Wen state per component, saturating at +-1: dz = dm/width (1 - |z| (beta sign(dm z) + 1 -
/// beta)).
fn bouc_wen(m: &[M], width: f64, beta: f64) -> Vec<M> {
    let (mut z, mut before) = ([0.0_f64; 2], [0.0; 2]);
    m.iter()
        .map(|m| {
            for c in 0..2 {
                let steps = 40;
                let dm = (m[c] - before[c]) / f64::from(steps);
                for _ in 0..steps {
                    let sign = (dm * z[c]).signum();
                    z[c] += dm / width * (1.0 - z[c].abs() * (beta * sign + 1.0 - beta));
                }
            }
            before = *m;
            z
        })
        .collect()
}

/// Sensed moment at every instant under one effect (unchanged for effects without memory or
/// threshold).
pub fn apply(effect: &Effect, motion: &[Instant], mut m: Vec<M>) -> Vec<M> {
    let (a, s) = (effect.amplitude, &effect.shape);
    let range = m.iter().map(|m| m[0].hypot(m[1])).fold(0.0, f64::max);
    match effect.kind {
        Kind::LagDelay => delayed(motion, &m, a),
        Kind::LagLowPass => relaxed(motion, &m, a),
        Kind::CreepProny1 => {
            let z = relaxed(motion, &m, s[0]);
            add(&mut m, &z, a);
            m
        }
        Kind::CreepProny2 => {
            let (fast, slow) = (relaxed(motion, &m, s[0]), relaxed(motion, &m, s[1]));
            add(&mut m, &fast, a * s[2]);
            add(&mut m, &slow, a * (1.0 - s[2]));
            m
        }
        Kind::CreepLog => {
            // A flat spectrum of time constants answers a step with the logarithm of time.
            let spectrum: Vec<_> = (0..8)
                .map(|i| relaxed(motion, &m, 0.5 * 3f64.powi(i)))
                .collect();
            for z in &spectrum {
                add(&mut m, z, a / 8.0);
            }
            m
        }
        Kind::HysteresisBoucWen => {
            let z = bouc_wen(&m, s[0], s[1]);
            add(&mut m, &z, a * range);
            m
        }
        Kind::HysteresisPlay => {
            // Normalised so that the loop's half height is a x range.
            let (narrow, wide) = (play(&m, s[0]), play(&m, s[1]));
            add(&mut m, &narrow, 0.5 * a * range / s[0]);
            add(&mut m, &wide, 0.5 * a * range / s[1]);
            m
        }
        Kind::HysteresisVector => {
            let z = vector_play(&m, s[0]);
            add(&mut m, &z, a * range / s[0]);
            m
        }
        Kind::DeadZoneRadial => {
            m.iter_mut().for_each(|m| {
                let share = (1.0 - a / m[0].hypot(m[1]).max(1e-300)).max(0.0);
                *m = [m[0] * share, m[1] * share];
            });
            m
        }
        Kind::DeadZoneComponent => {
            m.iter_mut()
                .for_each(|m| *m = m.map(|v| v.signum() * (v.abs() - a).max(0.0)));
            m
        }
        Kind::UnknownPermanentSet => {
            let z = set(&m, s[0] * range);
            add(&mut m, &z, a);
            m
        }
        _ => m,
    }
}
