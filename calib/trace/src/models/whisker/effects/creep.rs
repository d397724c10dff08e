//! Creep of the bond: m + a relaxed(m), integrated over the whole run, unloaded moves included.

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::{Memory, WhiskerEffect};

/// See the module.
pub struct Creep;

impl Effect for Creep {
    fn id(&self) -> &'static str {
        "creep"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("prony")
                .needing(&[LawRequirement::Time])
                .amplitude("creep_fraction", "1", [0.0, 0.3], 0.02)
                .shape("time_constant_s", "s", [0.3, 3000.0], &[1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0]),
            law("log-time").needing(&[LawRequirement::Time]).amplitude(
                "creep_fraction",
                "1",
                [0.0, 0.3],
                0.02,
            ),
        ]
    }
    fn refinements(&self) -> Vec<EffectModel> {
        const GRID: &[f64] = &[1.0, 10.0, 100.0, 1000.0];
        let seconds = [0.3, 3000.0];
        vec![
            law("prony-2")
                .needing(&[LawRequirement::Time])
                .amplitude("creep_fraction", "1", [0.0, 0.3], 0.02)
                .shape("time_constant_s", "s", seconds, GRID)
                .amplitude("second_creep_fraction", "1", [0.0, 0.3], 0.02)
                .shape("second_time_constant_s", "s", seconds, GRID),
        ]
    }
    fn has_memory(&self) -> bool {
        true
    }
    fn sentence(&self) -> &'static str {
        "The bond of the gratings creeps: the wavelengths keep changing after the load has settled."
    }
    fn source(&self) -> &'static str {
        "linear viscoelasticity, one or two Prony terms or a spectrum that gives log-time creep"
    }
}

impl WhiskerEffect for Creep {
    fn memory(&self, values: &Values) -> Option<Box<dyn Memory>> {
        // Weights and time constants; equal weights on constants spaced by half decades make creep in log time from 1 s to about an hour.
        let spectrum: Vec<(f64, f64)> = match values.law() {
            "log-time" => {
                let share = values.of("creep_fraction") / 8.0;
                (0..8).map(|k| (share, 10f64.powf(0.5 * f64::from(k)))).collect()
            }
            law => {
                let mut terms = vec![(values.of("creep_fraction"), values.of("time_constant_s"))];
                if law == "prony-2" {
                    terms.push((values.of("second_creep_fraction"), values.of("second_time_constant_s")));
                }
                terms
            }
        };
        let relaxed = vec![[0.0; 2]; spectrum.len()];
        Some(Box::new(Relaxing { spectrum, relaxed, last: [0.0; 2] }))
    }
}

/// Relaxed moments, one a time constant.
struct Relaxing {
    spectrum: Vec<(f64, f64)>,
    relaxed: Vec<[f64; 2]>,
    last: [f64; 2],
}

impl Relaxing {
    fn next(&self, k: usize, dt_s: f64, m: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|c| relax(self.relaxed[k][c], self.last[c], m[c], dt_s, self.spectrum[k].1))
    }
}

impl Memory for Relaxing {
    fn sensed(&self, dt_s: Option<f64>, m: [f64; 2]) -> [f64; 2] {
        let Some(dt_s) = dt_s else { return m };
        let mut sensed = m;
        for (k, (share, _)) in self.spectrum.iter().enumerate() {
            let relaxed = self.next(k, dt_s, m);
            sensed = [0, 1].map(|c| sensed[c] + share * relaxed[c]);
        }
        sensed
    }

    fn accept(&mut self, dt_s: Option<f64>, m: [f64; 2]) {
        if let Some(dt_s) = dt_s {
            self.relaxed = (0..self.spectrum.len()).map(|k| self.next(k, dt_s, m)).collect();
        }
        self.last = m;
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
