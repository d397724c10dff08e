//! Random sessions of the scalar kinds: sweeps along a line, with noise that is white, heavy-tailed or correlated from reading
//! to reading, as nulls and with one effect.

use std::fmt::Write as _;
use std::path::Path;

use nalgebra::{DMatrix, DVector};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use serde::Serialize;

use crate::PlantError;
use crate::case::put;

/// How the noise of a scalar session is made.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScalarNoise {
    /// White and normal.
    White,
    /// White, from Student's t of 3 to 12 degrees of freedom.
    StudentT,
    /// First-order autocorrelated: about 0.3 from reading to reading.
    WeaklyCorrelated,
    /// About 0.6.
    Correlated,
    /// About 0.9.
    StronglyCorrelated,
}

impl ScalarNoise {
    /// Every kind.
    pub const ALL: [Self; 5] =
        [Self::White, Self::StudentT, Self::WeaklyCorrelated, Self::Correlated, Self::StronglyCorrelated];

    /// Name in tables and in truth.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "line white",
            Self::StudentT => "line student-t",
            Self::WeaklyCorrelated => "line rho 0.3",
            Self::Correlated => "line rho 0.6",
            Self::StronglyCorrelated => "line rho 0.9",
        }
    }

    fn about(self) -> f64 {
        match self {
            Self::White | Self::StudentT => 0.0,
            Self::WeaklyCorrelated => 0.3,
            Self::Correlated => 0.6,
            Self::StronglyCorrelated => 0.9,
        }
    }
}

/// An effect on a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ScalarEffect {
    /// Second-order bend over the stimulus.
    Quadratic,
    /// Play between stimulus and response; for an axis the reversal value.
    Backlash,
    /// Sine over the stimulus.
    Periodic,
    /// One shift in time.
    Step,
    /// In proportion to time.
    Drift,
}

impl ScalarEffect {
    /// Every effect.
    pub const ALL: [Self; 5] = [Self::Quadratic, Self::Backlash, Self::Periodic, Self::Step, Self::Drift];

    /// Identifier of the catalogue.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quadratic => "nonlinearity-quadratic",
            Self::Backlash => "backlash",
            Self::Periodic => "periodic",
            Self::Step => "step",
            Self::Drift => "drift",
        }
    }
}

/// One order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarRequest {
    /// Seed of everything random.
    pub seed: u64,
    /// An axis (else a transducer).
    pub axis: bool,
    /// Noise.
    pub noise: ScalarNoise,
    /// Effect; none for a null.
    pub effect: Option<ScalarEffect>,
    /// Wanted size in noises, against the true covariance.
    pub target_sigma: f64,
}

/// One reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarReading {
    /// In holdout.csv (else points.csv).
    pub holdout: bool,
    /// Number within its file.
    pub point: usize,
    /// Number of the sweep.
    pub sweep: usize,
    /// Stimulus, or commanded position in mm.
    pub x: f64,
    /// Response, or measured position less commanded in um, without noise.
    pub clean: f64,
    /// The same as read.
    pub y: f64,
    /// Time, s.
    pub t_s: f64,
    /// +1 rising, -1 falling.
    pub direction: i32,
    /// Temperature that acts on nothing, degC.
    pub temperature_degc: f64,
}

/// The entry of truth.json.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ScalarTruth {
    /// `null` or the effect.
    pub label: String,
    /// Effects put in.
    pub names: Vec<String>,
    /// Kind of noise.
    pub noise: ScalarNoise,
    /// Standard deviation of a reading (unit of the response; um for an axis).
    pub noise_sd: f64,
    /// Correlation from reading to reading.
    pub rho: f64,
    /// Degrees of freedom of the tails.
    pub tails_dof: Option<f64>,
    /// Amplitude of the effect.
    pub amplitude: f64,
    /// Size in noises of what the declared model cannot absorb.
    pub projected_size_in_noises: f64,
    /// Seed.
    pub seed: u64,
}

/// A drawn session.
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarCase {
    /// An axis (else a transducer).
    pub axis: bool,
    /// Rows of points.csv and holdout.csv in order.
    pub readings: Vec<ScalarReading>,
    /// Answer.
    pub truth: ScalarTruth,
}

/// What an effect adds to every clean row for an amplitude.
struct Signature {
    effect: ScalarEffect,
    axis: bool,
    /// Slope of the response, range of the stimulus, duration of points.csv.
    slope: f64,
    range: f64,
    end_s: f64,
    /// Two random numbers of the effect (place, period, phase).
    shape: [f64; 2],
}

impl Signature {
    fn at(&self, amplitude: f64, rows: &[ScalarReading]) -> Vec<f64> {
        let mut held = rows.first().map_or(0.0, |r| r.x);
        let play = self.effect == ScalarEffect::Backlash && !self.axis;
        rows.iter()
            .map(|r| match self.effect {
                ScalarEffect::Quadratic => amplitude * (2.0 * r.x / self.range - 1.0).powi(2),
                ScalarEffect::Backlash if play => {
                    // The response hangs behind by the play, which is an input's.
                    held = held.clamp(r.x - 0.5 * amplitude, r.x + 0.5 * amplitude);
                    self.slope * (held - r.x)
                }
                ScalarEffect::Backlash => -0.5 * amplitude * f64::from(r.direction),
                ScalarEffect::Periodic => {
                    let turns = self.shape[0] * r.x / self.range;
                    amplitude * (std::f64::consts::TAU * (turns + self.shape[1])).sin()
                }
                ScalarEffect::Step => amplitude * f64::from(u8::from(r.t_s > self.shape[0] * self.end_s)),
                ScalarEffect::Drift => amplitude * r.t_s / self.end_s,
            })
            .collect()
    }
}

/// Size in noises of a signature on the rows of points.csv: white after the correlation is taken out, less what the
/// declared model (a line; for an axis a constant) takes up.
fn size(signature: &[f64], rows: &[ScalarReading], axis: bool, rho: f64, noise_sd: f64) -> f64 {
    let n = rows.iter().filter(|r| !r.holdout).count();
    let whiten =
        |v: &dyn Fn(usize) -> f64| -> DVector<f64> {
            DVector::from_fn(n, |k, _| {
                if k == 0 { v(0) } else { (v(k) - rho * v(k - 1)) / (1.0 - rho * rho).sqrt() }
            })
        };
    let mut columns = vec![whiten(&|_| 1.0)];
    if !axis {
        columns.push(whiten(&|k| rows[k].x));
    }
    let base = DMatrix::from_columns(&columns);
    let y = whiten(&|k| signature[k] / noise_sd);
    let Ok(x) = base.clone().svd(true, true).solve(&y, 1e-12) else { return f64::NAN };
    (y - base * x).norm()
}

/// Seconds from reading to reading and between sweeps.
pub const READING_S: f64 = 2.0;
const PAUSE_S: f64 = 10.0;

/// Sweeps up and down in turn, every other session with one more as a holdout.
fn sweeps(rng: &mut impl Rng, range: f64) -> Vec<ScalarReading> {
    let (count, length) = if rng.random_bool(0.5) {
        (5, 40)
    } else {
        (rng.random_range(4..=7_usize), rng.random_range(28..=48_usize))
    };
    let held_out = usize::from(rng.random_bool(0.5));
    let (amplitude, period, phase) =
        (rng.random_range(0.1..1.5), rng.random_range(200.0..900.0), rng.random_range(0.0..6.0_f64));
    let mut t_s = 0.0;
    let mut out = Vec::new();
    for sweep in 0..count + held_out {
        for k in 0..length {
            let place = k as f64 / (length - 1) as f64;
            let direction = if sweep % 2 == 0 { 1 } else { -1 };
            out.push(ScalarReading {
                holdout: sweep >= count,
                point: if sweep >= count { k } else { sweep * length + k },
                sweep: sweep + 1,
                x: range * if direction > 0 { place } else { 1.0 - place },
                clean: 0.0,
                y: 0.0,
                t_s,
                direction,
                temperature_degc: 21.0 + amplitude * (t_s / period + phase).sin(),
            });
            t_s += READING_S;
        }
        t_s += PAUSE_S;
    }
    out
}

/// Draws a session.
pub fn draw(request: &ScalarRequest) -> ScalarCase {
    let mut rng = ChaCha8Rng::seed_from_u64(request.seed ^ 0x5ca1_a200);
    let range = if request.axis { rng.random_range(5.0..40.0_f64) } else { rng.random_range(2.0..50.0_f64) };
    let mut readings = sweeps(&mut rng, range);
    let slope = if request.axis { 0.0 } else { rng.random_range(0.05..2.0_f64) };
    let zero = if request.axis { rng.random_range(-5.0..5.0) } else { rng.random_range(-0.1..0.1) };
    let noise_sd = if request.axis {
        rng.random_range(0.2..2.0)
    } else {
        slope * range * 10f64.powf(rng.random_range(-4.0..-2.7))
    };
    let (noise, rho, tails_dof) = draw_noise(request.noise, &mut rng, readings.len());

    let end_s = readings.iter().rev().find(|r| !r.holdout).map_or(1.0, |r| r.t_s);
    let shape = match request.effect {
        Some(ScalarEffect::Periodic) => [rng.random_range(2.5..8.0), rng.random_range(0.0..1.0)],
        _ => [rng.random_range(0.2..0.8), 0.0],
    };
    let mut added = vec![0.0; readings.len()];
    let (mut amplitude, mut projected) = (0.0, 0.0);
    if let Some(effect) = request.effect {
        let signature = Signature { effect, axis: request.axis, slope, range, end_s, shape };
        amplitude =
            noise_sd * if slope > 0.0 && effect == ScalarEffect::Backlash { 1.0 / slope } else { 1.0 };
        // All are in proportion to their amplitude, a play but nearly.
        for _ in 0..8 {
            added = signature.at(amplitude, &readings);
            projected = size(&added, &readings, request.axis, rho, noise_sd);
            amplitude *= request.target_sigma / projected;
        }
    }
    for ((r, add), e) in readings.iter_mut().zip(added).zip(noise) {
        r.clean = zero + slope * r.x + add;
        r.y = r.clean + noise_sd * e;
    }
    let name = request.effect.map(ScalarEffect::name);
    ScalarCase {
        axis: request.axis,
        readings,
        truth: ScalarTruth {
            label: name.unwrap_or("null").to_owned(),
            names: name.map(str::to_owned).into_iter().collect(),
            noise: request.noise,
            noise_sd,
            rho,
            tails_dof,
            amplitude,
            projected_size_in_noises: projected,
            seed: request.seed,
        },
    }
}

/// Noise of unit variance for `count` readings, with its correlation and degrees of freedom.
fn draw_noise(kind: ScalarNoise, rng: &mut ChaCha8Rng, count: usize) -> (Vec<f64>, f64, Option<f64>) {
    // Half of the correlated sessions have the round number, the others one beside it.
    let beside = if rng.random_bool(0.5) { 0.0 } else { rng.random_range(-0.12..0.06) };
    let rho = if kind.about() > 0.0 { kind.about() + beside } else { 0.0 };
    let tails_dof = (kind == ScalarNoise::StudentT).then(|| rng.random_range(3f64.ln()..12f64.ln()).exp());
    let chi = tails_dof.and_then(|dof| Some((dof, ChiSquared::new(dof).ok()?)));
    let mut state = 0.0;
    let noise = (0..count)
        .map(|k| {
            let white: f64 = StandardNormal.sample(rng);
            let white = match &chi {
                Some((dof, chi)) => white * ((dof - 2.0) / chi.sample(rng)).sqrt(),
                None => white,
            };
            state = if k == 0 { white } else { rho * state + (1.0 - rho * rho).sqrt() * white };
            state
        })
        .collect();
    (noise, rho, tails_dof)
}

impl ScalarCase {
    /// Writes the session into `folder` (made if missing); its name is the id.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written.
    pub fn write(&self, folder: &Path) -> Result<(), PlantError> {
        std::fs::create_dir_all(folder)
            .map_err(|source| PlantError::Write { path: folder.display().to_string(), source })?;
        let id = folder.file_name().map_or_else(|| "case".into(), |n| n.to_string_lossy().into_owned());
        let held_out = self.readings.iter().any(|r| r.holdout);
        let (kind, model) = if self.axis {
            ("axis", "")
        } else {
            ("transducer", "[transducer]\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\nmodel = \"linear\"\n")
        };
        let holdout = if held_out { "holdout = \"holdout.csv\"\n" } else { "" };
        let toml = format!(
            "format = \"wcal-session/1\"\nid = \"{id}\"\nkind = \"{kind}\"\nmedium = \"air\"\n\
             created = \"2026-11-20T09:00:00Z\"\n\n[files]\npoints = \"points.csv\"\n{holdout}\n{model}"
        );
        put(&folder.join("session.toml"), &toml)?;
        put(&folder.join("points.csv"), &self.table(false))?;
        if held_out {
            put(&folder.join("holdout.csv"), &self.table(true))?;
        }
        Ok(())
    }

    fn table(&self, holdout: bool) -> String {
        let mut out = String::from(if self.axis {
            "point,role,commanded_mm,measured_mm,t_s,direction,cycle,temperature_degc\n"
        } else {
            "point,role,stimulus,response,t_s,direction,replicate,temperature_degc\n"
        });
        let role = if holdout { "holdout" } else { "calibration" };
        for r in self.readings.iter().filter(|r| r.holdout == holdout) {
            let y = if self.axis { r.x + 1e-3 * r.y } else { r.y };
            let _ = writeln!(
                out,
                "{},{role},{:.6},{y:.9},{:.1},{},{},{:.3}",
                r.point, r.x, r.t_s, r.direction, r.sweep, r.temperature_degc
            );
        }
        out
    }
}
