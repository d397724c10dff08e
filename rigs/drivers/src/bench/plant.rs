//! The simulated sensor: response of the gratings to the stage. Shares no code with the program
//! that fits it.
//!
//! ```text
//! play         x_c = clamp(x_c, x - b / 2, x + b / 2)                          x: screw with its errors, b: backlash
//! delay        d += (1 - exp(-dt / t_lag)) (x_c - d)
//! wire         m = m(d), by another model ([`Plant`])
//! creep        c += (1 - exp(-dt / t_creep)) (m - c),   M = m + f c            one Prony term
//! wavelength   l_g = l_g0 + (K_g . M) (1 + q K_g . M / |K_g|) + zero_g + kappa_g (T - 21) + drift + noise
//! ```

use super::scenario::{Scenario, WhiskerScenario, rest_point};
use super::scene::Scene;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;

/// Lead of the LSM100A's screw, mm.
const SCREW_LEAD_MM: f64 = 0.6096;
/// Temperature of the nominal wavelengths, deg C.
const NOMINAL_DEGC: f64 = 21.0;
/// Pieces of the wire in which its place nearest to a point is looked for.
const PIECES: usize = 600;

/// Base moment of the wire at a depth of the groove.
pub trait Plant: Send {
    /// Moments about base y and z (N mm) for trajectory `id` at `depth_mm` past first contact
    /// (negative: none).
    fn moment_nmm(&mut self, id: u32, depth_mm: f64) -> [f64; 2];
    /// Its appearance to the cameras; `None`: uniform grey.
    fn scene(&self) -> Option<Arc<dyn Scene>> {
        None
    }
}

/// Arc length (mm) of the point of the resting wire nearest to `point_mm`.
pub fn rest_arclength_mm(whisker: &WhiskerScenario, point_mm: [f64; 3]) -> f64 {
    let point = Vector3::from(point_mm);
    let far = |s: f64| (Vector3::from(rest_point(whisker, s).0) - point).norm();
    let step = whisker.length_mm / PIECES as f64;
    let all = (0..=PIECES).map(|k| step * k as f64);
    let near = all
        .min_by(|a, b| far(*a).total_cmp(&far(*b)))
        .unwrap_or(whisker.length_mm);
    // Golden section between its neighbours: a first contact off by half a step would push before
    // it touches.
    let (mut low, mut high) = ((near - step).max(0.0), (near + step).min(whisker.length_mm));
    const RATIO: f64 = 0.618_033_988_749_895;
    for _ in 0..60 {
        let (a, b) = (high - RATIO * (high - low), low + RATIO * (high - low));
        if far(a) < far(b) {
            high = b;
        } else {
            low = a;
        }
    }
    (low + high) / 2.0
}

/// The sensor in its surroundings: stage errors, plant, memory, temperature, noise. Stepped once a
/// scan.
pub(super) struct Physics {
    scenario: Scenario,
    plant: Box<dyn Plant>,
    rng: ChaCha8Rng,
    last_s: f64,
    carriage_mm: Option<f64>,
    lagged_mm: Option<f64>,
    crept_nmm: [f64; 2],
    /// Step of the room's temperature so far, K.
    pub(super) temperature_step_degc: f64,
    /// Bench time since which both zeros drift, and their rate, pm/s.
    pub(super) drift: (f64, f64),
}

impl Physics {
    /// The sensor of a scenario with a wire.
    pub(super) fn new(scenario: &Scenario, plant: Box<dyn Plant>) -> Self {
        Self {
            plant,
            rng: ChaCha8Rng::seed_from_u64(scenario.seed),
            scenario: scenario.clone(),
            last_s: 0.0,
            carriage_mm: None,
            lagged_mm: None,
            crept_nmm: [0.0; 2],
            temperature_step_degc: 0.0,
            drift: (0.0, 0.0),
        }
    }

    /// Temperature at `t_s`, deg C.
    fn temperature_degc(&self, t_s: f64) -> f64 {
        let t = &self.scenario.temperature;
        let swing = t.swing_degc * (std::f64::consts::TAU * t_s / t.swing_period_s.max(1e-3)).sin();
        t.start_degc + t.drift_degc_per_h * t_s / 3600.0 + swing + self.temperature_step_degc
    }

    /// Wavelengths (nm) of reference, first and second sensing grating with the stage at
    /// `stage_mm`.
    pub(super) fn step(&mut self, t_s: f64, trajectory: u32, stage_mm: f64) -> [f64; 3] {
        let dt = (t_s - self.last_s).max(0.0);
        self.last_s = t_s;
        let depth_mm = self.depth_mm(stage_mm, dt);
        let elastic = self.plant.moment_nmm(trajectory, depth_mm);
        let moment = self.creep(elastic, dt);
        let (fbg, effects) = (&self.scenario.fbg, &self.scenario.effects);
        let rise = self.temperature_degc(t_s) - NOMINAL_DEGC;
        let mut out = [0.0; 3];
        let noise = self.scenario.interrogator.noise_pm;
        let mut draw = || {
            let z: f64 = StandardNormal.sample(&mut self.rng);
            noise * z
        };
        // The reference is isolated from strain: temperature and noise alone move it.
        out[0] = fbg.reference_nominal_nm
            + (fbg.reference_temperature_pm_per_degc * rise + draw()) * 1e-3;
        for g in 0..2 {
            let [about_y, about_z] = fbg.k_pm_per_nmm[g];
            let linear = about_y * moment[0] + about_z * moment[1];
            // Second order in the strain at the grating: in the moment along its own axis.
            let along = linear / about_y.hypot(about_z);
            let pm = linear * (1.0 + effects.quadratic_fraction * along)
                + fbg.zero_pm[g]
                + fbg.temperature_pm_per_degc[g] * rise
                + effects.zero_drift_pm_per_min * t_s / 60.0
                + (t_s - self.drift.0) * self.drift.1;
            out[g + 1] = fbg.nominal_nm[g] + (pm + draw()) * 1e-3;
        }
        out
    }

    /// Carriage past the position of first contact, mm: screw errors and play, from the play's
    /// state after the last step.
    fn carriage_mm(&self, stage_mm: f64) -> f64 {
        let e = &self.scenario.effects;
        // A screw's error repeats with its turn.
        let screw = (stage_mm - self.scenario.stage.contact_mm()) * (1.0 + e.stage_scale)
            + e.periodic_um * 1e-3 * (std::f64::consts::TAU * stage_mm / SCREW_LEAD_MM).sin();
        // Play operator: the carriage follows the nut only once the play is used up.
        let half = e.backlash_um * 5e-4;
        self.carriage_mm
            .unwrap_or(screw)
            .clamp(screw - half, screw + half)
    }

    /// Where the groove is with the stage at `stage_mm`, mm past first contact. Loading is the
    /// reference of the play.
    pub(super) fn groove_mm(&self, stage_mm: f64) -> f64 {
        self.carriage_mm(stage_mm) + 5e-4 * self.scenario.effects.backlash_um
    }

    /// Depth of the groove in the signal: screw errors, play, delay.
    fn depth_mm(&mut self, stage_mm: f64, dt: f64) -> f64 {
        let carriage = self.carriage_mm(stage_mm);
        self.carriage_mm = Some(carriage);
        let e = &self.scenario.effects;
        // First-order delay of the reading behind the carriage.
        let share = if e.lag_ms > 0.0 {
            1.0 - (-dt * 1e3 / e.lag_ms).exp()
        } else {
            1.0
        };
        let lagged = self.lagged_mm.unwrap_or(carriage);
        let lagged = lagged + share * (carriage - lagged);
        self.lagged_mm = Some(lagged);
        // Loading direction is the reference of the play.
        lagged + 5e-4 * e.backlash_um
    }

    /// One Prony term: the moment relaxes by a share of its slow part.
    fn creep(&mut self, elastic: [f64; 2], dt: f64) -> [f64; 2] {
        let e = &self.scenario.effects;
        if e.creep_fraction == 0.0 || e.creep_s <= 0.0 {
            return elastic;
        }
        let share = 1.0 - (-dt / e.creep_s).exp();
        std::array::from_fn(|k| {
            self.crept_nmm[k] += share * (elastic[k] - self.crept_nmm[k]);
            elastic[k] + e.creep_fraction * self.crept_nmm[k]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wire whose moment grows with the depth.
    struct Spring;

    impl Plant for Spring {
        fn moment_nmm(&mut self, _: u32, depth_mm: f64) -> [f64; 2] {
            [-0.2 * depth_mm.max(0.0), 0.0]
        }
    }

    fn scenario(extra: &str) -> Scenario {
        Scenario::parse(&format!("format = \"wcal-scenario/1\"\n{extra}")).unwrap()
    }

    #[test]
    fn the_same_seed_gives_the_same_scans_and_another_does_not() {
        let run = |seed: u64| {
            let mut p = Physics::new(&scenario(&format!("seed = {seed}")), Box::new(Spring));
            (0..50)
                .map(|k| p.step(f64::from(k) * 5e-4, 1, 22.0))
                .collect::<Vec<_>>()
        };
        assert_eq!(run(3), run(3));
        assert_ne!(run(3), run(4));
    }

    #[test]
    fn backlash_shows_after_a_reversal_and_only_then() {
        let quiet =
            "[interrogator]\nnoise_pm = 0\n[temperature]\ndrift_degc_per_h = 0\nswing_degc = 0\n";
        let shift = |effects: &str| {
            let mut p = Physics::new(
                &scenario(&format!("{quiet}[effects]\n{effects}")),
                Box::new(Spring),
            );
            let path = |k: i32| 20.0 + 0.01 * f64::from(if k <= 200 { k } else { 400 - k });
            let all: Vec<f64> = (0..=300)
                .map(|k| p.step(f64::from(k) * 0.01, 1, path(k))[1])
                .collect();
            (all[100], all[300])
        };
        let (up, down) = shift("backlash_um = 40");
        let (clean_up, clean_down) = shift("");
        assert!((up - clean_up).abs() < 1e-9 && (clean_up - clean_down).abs() < 1e-9);
        assert!((down - up).abs() > 0.5e-3, "{up} {down}");
    }
}
