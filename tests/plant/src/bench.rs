//! A random bench: wire, sensor, temperature and the groove's trajectories.

use nalgebra::Vector3;
use rand::{Rng, RngExt};

use crate::rod::Wire;
use crate::table::Path;

/// Microstep of the stage in mm; positions are read back in whole microsteps (as in the practice
/// sessions).
pub const MICROSTEP_MM: f64 = 4.7625e-5;
/// Diameter of the usual wire in mm.
pub const DIAMETER_MM: f64 = 0.3;
/// Length of the usual wire in mm.
pub const LENGTH_MM: f64 = 60.0;
/// Diameter and length of the thin wire in mm.
const THIN_DIAMETER_MM: f64 = 0.2;
const THIN_LENGTH_MM: f64 = 40.0;
/// Shift of every grating with temperature in pm per degC.
pub const PM_PER_DEGC: f64 = 10.0;
/// Temperature at which the gratings are at their nominal wavelengths, degC.
pub const REFERENCE_DEGC: f64 = 21.0;

/// What the session file declares of one trajectory, with its reach.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Number in the session.
    pub id: usize,
    /// Declared path.
    pub path: Path,
    /// Longest stage travel used, mm.
    pub reach_mm: f64,
}

/// Slow course of the temperature: the sum of sinusoids that start at zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Thermal {
    /// Amplitude in degC, period in s, phase in rad.
    pub waves: Vec<[f64; 3]>,
}

impl Thermal {
    /// T - T0 in degC.
    pub fn at(&self, t_s: f64) -> f64 {
        let tau = std::f64::consts::TAU;
        self.waves
            .iter()
            .map(|[a, p, f]| a * ((tau * t_s / p + f).sin() - f.sin()))
            .sum()
    }

    /// The same of a part that lags behind with a time constant, deg C: z' = (T - z) / lag, z(0) =
    /// 0.
    pub fn behind(&self, t_s: f64, lag_s: f64) -> f64 {
        // Each wave passes with gain cos(e) and phase -e, tan(e) = w lag; what its start left
        // decays.
        let (tau, decay) = (std::f64::consts::TAU, (-t_s / lag_s).exp());
        let one = |[a, p, f]: &[f64; 3]| {
            let e = (tau * lag_s / p).atan();
            let steady = |t: f64| e.cos() * (tau * t / p + f - e).sin() - f.sin();
            a * (steady(t_s) - steady(0.0) * decay)
        };
        self.waves.iter().map(one).sum()
    }
}

/// Everything that is drawn per session and is no effect.
#[derive(Debug, Clone, PartialEq)]
pub struct Bench {
    /// Wire diameter in mm.
    pub diameter_mm: f64,
    /// Wire length in mm.
    pub length_mm: f64,
    /// Straight part of the wire in mm.
    pub straight_mm: f64,
    /// Radius of the arc in mm.
    pub arc_radius_mm: f64,
    /// Young's modulus in GPa.
    pub youngs_gpa: f64,
    /// Shear modulus in GPa.
    pub shear_gpa: f64,
    /// Nominal wavelengths of both sensing gratings in nm.
    pub nominal_nm: [f64; 2],
    /// Nominal wavelength of the reference grating in nm.
    pub reference_nominal_nm: f64,
    /// Sensitivity in pm per N mm, rows are channels.
    pub k: [[f64; 2]; 2],
    /// Zero of both channels in pm.
    pub zero_pm: [f64; 2],
    /// Point-to-point noise in pm.
    pub noise_pm: f64,
    /// Spread of single samples in pm.
    pub sample_sd_pm: f64,
    /// Temperature.
    pub thermal: Thermal,
}

impl Bench {
    /// Draws a bench as varied as those of the practice sessions.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let pick = |rng: &mut dyn Rng, of: &[f64]| of[rng.random_range(0..of.len())];
        let youngs_gpa = pick(rng, &[60.0, 75.0]);
        let nanometres =
            |rng: &mut dyn Rng| (1e3 * rng.random_range(1535.0..1555.0_f64)).round() / 1e3;
        let gain = rng.random_range(62.0..90.0);
        let turn = rng.random_range(0.22..0.68) * if rng.random_bool(0.5) { 1.0 } else { -1.0_f64 };
        let cross = |rng: &mut dyn Rng| gain * turn.sin() * rng.random_range(0.85..1.15);
        let k = [
            [gain * turn.cos(), -cross(rng)],
            [cross(rng), gain * turn.cos()],
        ];
        let waves = (0..rng.random_range(1..=2_usize))
            .map(|i| {
                [
                    rng.random_range(0.4..1.3) / (1.0 + i as f64),
                    rng.random_range(700.0..2200.0) / (1.0 + 0.6 * i as f64),
                    rng.random_range(0.0..std::f64::consts::TAU),
                ]
            })
            .collect();
        Self {
            diameter_mm: DIAMETER_MM,
            length_mm: LENGTH_MM,
            straight_mm: pick(rng, &[28.0, 29.0, 30.0, 31.0, 32.0]),
            arc_radius_mm: pick(rng, &[18.0, 19.0, 20.0, 21.0, 22.0]),
            youngs_gpa,
            shear_gpa: youngs_gpa / 2.66,
            nominal_nm: [nanometres(rng), nanometres(rng)],
            reference_nominal_nm: nanometres(rng),
            k,
            zero_pm: [rng.random_range(-7.0..7.0), rng.random_range(-7.0..7.0)],
            noise_pm: rng.random_range(0.35..0.85),
            sample_sd_pm: rng.random_range(0.8..1.3),
            thermal: Thermal { waves },
        }
    }

    /// Draws a bench with a wire of another make: thinner, shorter, of other steps and of a gain
    /// that fits its moments.
    pub fn draw_thin(rng: &mut impl Rng) -> Self {
        let bench = Self::draw(rng);
        // Moments go with d^4 / L; gratings see the strain, which goes with the moment over d^3.
        let gain = rng.random_range(2.4..3.4);
        Self {
            diameter_mm: THIN_DIAMETER_MM,
            length_mm: THIN_LENGTH_MM,
            straight_mm: rng.random_range(18..=22_u32).into(),
            arc_radius_mm: rng.random_range(13..=16_u32).into(),
            youngs_gpa: rng.random_range(55.0..82.0_f64).round(),
            k: bench.k.map(|row| row.map(|v| gain * v)),
            ..bench
        }
        .with_shear()
    }

    fn with_shear(self) -> Self {
        Self {
            shear_gpa: (1e4 * self.youngs_gpa / 2.6).round() / 1e4,
            ..self
        }
    }

    /// The wire of this bench, as declared.
    pub fn wire(&self) -> Wire {
        Wire::new(
            self.diameter_mm,
            self.length_mm,
            self.straight_mm,
            self.arc_radius_mm,
            self.youngs_gpa,
            self.shear_gpa,
        )
    }

    /// The nine trajectories of the points and the six of the holdout.
    pub fn trajectories(&self) -> Vec<Trajectory> {
        let wire = self.wire();
        let mut out = Vec::new();
        let scale = self.length_mm / LENGTH_MM;
        // Turn about the wire's own axis from the arc's plane, in degrees.
        let points = [(18.0, 5.0), (31.0, 9.0), (45.0, 13.0)];
        let holdout = [(23.0, 6.0), (38.0, 10.5)];
        for (first, places, turns) in [
            (1, &points[..], [0.0, -60.0, 60.0_f64]),
            (101, &holdout[..], [-25.0, -85.0, 35.0]),
        ] {
            for (i, place) in places.iter().enumerate() {
                let arclength_mm = (10.0 * scale * place.0).round() / 10.0;
                let reach_mm = scale * place.1;
                let (origin_mm, tangent) = wire.rest(arclength_mm);
                let normal = Vector3::new(-tangent.z, 0.0, tangent.x);
                for (j, turn) in turns.iter().map(|t| t.to_radians()).enumerate() {
                    let direction = normal * turn.cos() + Vector3::y() * turn.sin();
                    let path = Path {
                        origin_mm,
                        direction,
                        arclength_mm,
                        offset_mm: Vector3::zeros(),
                    };
                    out.push(Trajectory {
                        id: first + 3 * i + j,
                        path,
                        reach_mm,
                    });
                }
            }
        }
        out
    }

    /// K m in pm.
    pub fn shift_pm(&self, m: [f64; 2]) -> [f64; 2] {
        self.k.map(|row| row[0] * m[0] + row[1] * m[1])
    }
}
