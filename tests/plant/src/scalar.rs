//! Random sessions of the scalar kinds: sweeps along a line, with noise that is white, heavy-tailed
//! or correlated from reading to reading, as nulls and with one effect.

use std::collections::BTreeMap;
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
    /// White and normal, read in steps of one standard deviation (not among [`Self::ALL`]).
    Rounded,
}

impl ScalarNoise {
    /// Every kind that the exam's mixes draw.
    pub const ALL: [Self; 5] = [
        Self::White,
        Self::StudentT,
        Self::WeaklyCorrelated,
        Self::Correlated,
        Self::StronglyCorrelated,
    ];

    /// Name in tables and in truth.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "line white",
            Self::StudentT => "line student-t",
            Self::WeaklyCorrelated => "line rho 0.3",
            Self::Correlated => "line rho 0.6",
            Self::StronglyCorrelated => "line rho 0.9",
            Self::Rounded => "line rounded",
        }
    }

    fn about(self) -> f64 {
        match self {
            Self::White | Self::StudentT | Self::Rounded => 0.0,
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
    pub const ALL: [Self; 5] = [
        Self::Quadratic,
        Self::Backlash,
        Self::Periodic,
        Self::Step,
        Self::Drift,
    ];

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
    /// Its size.
    pub size: EffectSize,
    /// Sweeps and readings; drawn where none is given.
    pub layout: Option<Layout>,
    /// Another recording of the same instrument: the noise alone is drawn anew, from this seed.
    pub noise_seed: Option<u64>,
}

/// Size of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EffectSize {
    /// In noises, against the true covariance.
    Noises(f64),
    /// A size by a law of the effect as verify.json states both, in its units.
    Stated(f64, StatedLaw),
}

/// A law of verify.json and its shape. Others act by the one law that they have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StatedLaw {
    /// The only one.
    Only,
    /// Play of the stimulus.
    Play,
    /// A wave over time, of a period in s.
    WaveOverTime(f64),
    /// A wave over the stimulus, of a period in its unit.
    WaveOverStimulus(f64),
    /// A shift from a time on, s.
    From(f64),
}

/// Sweeps up and down in turn over places at equal distances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Layout {
    /// Sweeps of points.csv.
    pub sweeps: usize,
    /// Readings of a sweep, at least two.
    pub places: usize,
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
    /// Parameters of the effect by their names in verify.json, in its units.
    pub parameters: BTreeMap<String, f64>,
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
    line: Line,
    signature: Option<Signature>,
}

/// The clean response without effect: zero, slope, and the largest stimulus.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Line {
    zero: f64,
    slope: f64,
    range: f64,
}

/// What an effect adds to every clean row for an amplitude.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Signature {
    effect: ScalarEffect,
    axis: bool,
    /// Slope of the response, range of the stimulus, duration of points.csv.
    slope: f64,
    range: f64,
    end_s: f64,
    /// Two random numbers of the effect (place, period, phase).
    shape: [f64; 2],
    /// The law, where one is stated.
    law: Option<StatedLaw>,
}

impl Signature {
    fn at(&self, amplitude: f64, rows: &[ScalarReading]) -> Vec<f64> {
        let mut held = rows.first().map_or(0.0, |r| r.x);
        // um of an axis that stands by 1 mm.
        let slope = if self.axis { 1e3 } else { self.slope };
        let play = !self.axis || self.law == Some(StatedLaw::Play);
        let turns = |r: &ScalarReading| match self.law {
            Some(StatedLaw::WaveOverTime(period)) => r.t_s / period,
            Some(StatedLaw::WaveOverStimulus(period)) => r.x / period,
            _ => self.shape[0] * r.x / self.range,
        };
        let from = if let Some(StatedLaw::From(t_s)) = self.law {
            t_s
        } else {
            self.shape[0] * self.end_s
        };
        rows.iter()
            .map(|r| match self.effect {
                ScalarEffect::Quadratic => amplitude * (2.0 * r.x / self.range - 1.0).powi(2),
                ScalarEffect::Backlash if play => {
                    // The response hangs behind by the play, which is an input's.
                    held = held.clamp(r.x - 0.5 * amplitude, r.x + 0.5 * amplitude);
                    slope * (held - r.x)
                }
                ScalarEffect::Backlash => -0.5 * amplitude * f64::from(r.direction),
                ScalarEffect::Periodic => {
                    amplitude * (std::f64::consts::TAU * (turns(r) + self.shape[1])).sin()
                }
                ScalarEffect::Step => amplitude * f64::from(u8::from(r.t_s > from)),
                ScalarEffect::Drift => amplitude * r.t_s / self.end_s,
            })
            .collect()
    }
}

impl Signature {
    /// Names of the parameters in verify.json, and their values for an amplitude of one. A place
    /// has no size.
    fn parameters(&self, amplitude: f64) -> BTreeMap<String, f64> {
        let of = |name: &str, value: f64| BTreeMap::from([(name.to_owned(), value)]);
        match self.effect {
            ScalarEffect::Quadratic => of("coefficient", 4.0 * amplitude / self.range.powi(2)),
            ScalarEffect::Backlash => of("reversal_value", amplitude),
            ScalarEffect::Periodic => {
                let mut both = of("amplitude", amplitude);
                both.insert("period".into(), self.range / self.shape[0]);
                both
            }
            ScalarEffect::Step => of("height", amplitude),
            ScalarEffect::Drift => of("rate", amplitude / self.end_s),
        }
    }

    /// Amplitude for a value of the parameter that scales with it.
    fn amplitude(&self, parameter: f64) -> f64 {
        let one = self.parameters(1.0);
        let name = if self.effect == ScalarEffect::Periodic {
            "amplitude"
        } else {
            ""
        };
        let of_one = one
            .get(name)
            .or_else(|| one.values().next())
            .copied()
            .unwrap_or(1.0);
        parameter / of_one
    }
}

/// Size in noises of a signature on the rows of points.csv: white after the correlation is taken
/// out, less what the declared model (a line; for an axis a constant) takes up.
fn size(signature: &[f64], rows: &[ScalarReading], axis: bool, rho: f64, noise_sd: f64) -> f64 {
    let n = rows.iter().filter(|r| !r.holdout).count();
    let whiten = |v: &dyn Fn(usize) -> f64| -> DVector<f64> {
        DVector::from_fn(n, |k, _| {
            if k == 0 {
                v(0)
            } else {
                (v(k) - rho * v(k - 1)) / (1.0 - rho * rho).sqrt()
            }
        })
    };
    let mut columns = vec![whiten(&|_| 1.0)];
    if !axis {
        columns.push(whiten(&|k| rows[k].x));
    }
    let base = DMatrix::from_columns(&columns);
    let y = whiten(&|k| signature[k] / noise_sd);
    let Ok(x) = base.clone().svd(true, true).solve(&y, 1e-12) else {
        return f64::NAN;
    };
    (y - base * x).norm()
}

/// Seconds from reading to reading and between sweeps.
pub const READING_S: f64 = 2.0;
const PAUSE_S: f64 = 10.0;

/// Sweeps up and down in turn, every other session with one more as a holdout.
fn sweeps(rng: &mut impl Rng, range: f64, layout: Option<Layout>) -> Vec<ScalarReading> {
    let drawn = if rng.random_bool(0.5) {
        (5, 40)
    } else {
        (
            rng.random_range(4..=7_usize),
            rng.random_range(28..=48_usize),
        )
    };
    let (count, length) = layout.map_or(drawn, |l| (l.sweeps, l.places));
    let held_out = usize::from(rng.random_bool(0.5));
    let (amplitude, period, phase) = (
        rng.random_range(0.1..1.5),
        rng.random_range(200.0..900.0),
        rng.random_range(0.0..6.0_f64),
    );
    let mut t_s = 0.0;
    let mut out = Vec::new();
    for sweep in 0..count + held_out {
        for k in 0..length {
            let place = k as f64 / (length - 1) as f64;
            let direction = if sweep % 2 == 0 { 1 } else { -1 };
            out.push(ScalarReading {
                holdout: sweep >= count,
                point: if sweep >= count {
                    k
                } else {
                    sweep * length + k
                },
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
    let range = if request.axis {
        rng.random_range(5.0..40.0_f64)
    } else {
        rng.random_range(2.0..50.0_f64)
    };
    let mut readings = sweeps(&mut rng, range, request.layout);
    let slope = if request.axis {
        0.0
    } else {
        rng.random_range(0.05..2.0_f64)
    };
    let zero = if request.axis {
        rng.random_range(-5.0..5.0)
    } else {
        rng.random_range(-0.1..0.1)
    };
    let noise_sd = if request.axis {
        rng.random_range(0.2..2.0)
    } else {
        slope * range * 10f64.powf(rng.random_range(-4.0..-2.7))
    };
    let (mut noise, rho, tails_dof) = draw_noise(request.noise, &mut rng, readings.len());
    if let Some(seed) = request.noise_seed {
        noise = unit_noise(
            rho,
            tails_dof,
            &mut ChaCha8Rng::seed_from_u64(seed),
            readings.len(),
        );
    }

    let end_s = readings
        .iter()
        .rev()
        .find(|r| !r.holdout)
        .map_or(1.0, |r| r.t_s);
    let shape = match request.effect {
        Some(ScalarEffect::Periodic) => [rng.random_range(2.5..8.0), rng.random_range(0.0..1.0)],
        _ => [rng.random_range(0.2..0.8), 0.0],
    };
    let mut added = vec![0.0; readings.len()];
    let (mut amplitude, mut projected) = (0.0, 0.0);
    let law = if let EffectSize::Stated(_, law) = request.size {
        Some(law)
    } else {
        None
    };
    let signature = request.effect.map(|effect| Signature {
        effect,
        axis: request.axis,
        slope,
        range,
        end_s,
        shape,
        law,
    });
    if let Some(signature) = &signature {
        let play = slope > 0.0 && signature.effect == ScalarEffect::Backlash;
        amplitude = match request.size {
            EffectSize::Noises(_) => noise_sd * if play { 1.0 / slope } else { 1.0 },
            EffectSize::Stated(value, _) => signature.amplitude(value),
        };
        // All are in proportion to their amplitude, a play but nearly.
        for _ in 0..8 {
            added = signature.at(amplitude, &readings);
            projected = size(&added, &readings, request.axis, rho, noise_sd);
            if let EffectSize::Noises(noises) = request.size {
                amplitude *= noises / projected;
            }
        }
    }
    for ((r, add), e) in readings.iter_mut().zip(added).zip(noise) {
        r.clean = zero + slope * r.x + add;
        r.y = read_out(request.noise, r.clean + noise_sd * e, noise_sd);
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
            parameters: signature
                .map(|s| s.parameters(amplitude))
                .unwrap_or_default(),
            projected_size_in_noises: projected,
            seed: request.seed,
        },
        line: Line { zero, slope, range },
        signature,
    }
}

/// A value as the instrument shows it.
fn read_out(noise: ScalarNoise, value: f64, step: f64) -> f64 {
    if noise == ScalarNoise::Rounded {
        (value / step).round() * step
    } else {
        value
    }
}

/// Correlation from reading to reading and degrees of freedom of the tails, and noise of unit
/// variance for `count` readings.
fn draw_noise(
    kind: ScalarNoise,
    rng: &mut ChaCha8Rng,
    count: usize,
) -> (Vec<f64>, f64, Option<f64>) {
    // Half of the correlated sessions have the round number, the others one beside it.
    let beside = if rng.random_bool(0.5) {
        0.0
    } else {
        rng.random_range(-0.12..0.06)
    };
    let rho = if kind.about() > 0.0 {
        kind.about() + beside
    } else {
        0.0
    };
    let tails_dof =
        (kind == ScalarNoise::StudentT).then(|| rng.random_range(3f64.ln()..12f64.ln()).exp());
    (unit_noise(rho, tails_dof, rng, count), rho, tails_dof)
}

/// A first-order autoregression of unit variance; innovations from Student's t where it has degrees
/// of freedom.
fn unit_noise(rho: f64, tails_dof: Option<f64>, rng: &mut ChaCha8Rng, count: usize) -> Vec<f64> {
    let chi = tails_dof.and_then(|dof| Some((dof, ChiSquared::new(dof).ok()?)));
    let mut state = 0.0;
    (0..count)
        .map(|k| {
            let white: f64 = StandardNormal.sample(rng);
            let white = match &chi {
                Some((dof, chi)) => white * ((dof - 2.0) / chi.sample(rng)).sqrt(),
                None => white,
            };
            state = if k == 0 {
                white
            } else {
                rho * state + (1.0 - rho * rho).sqrt() * white
            };
            state
        })
        .collect()
}

impl ScalarCase {
    /// Standard deviation of a reading, rounding included (uniform within a step), in the unit of
    /// the response; um for an axis.
    pub fn reading_sd(&self) -> f64 {
        let rounding = if self.truth.noise == ScalarNoise::Rounded {
            1.0 / 12.0
        } else {
            0.0
        };
        self.truth.noise_sd * f64::sqrt(1.0 + rounding)
    }

    /// Another sweep of the same instrument after the session, at stimuli that are given as parts
    /// of the range: clean values, and values as read.
    pub fn another_sweep(&self, parts: &[f64], seed: u64) -> Vec<ScalarReading> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x00a0_7e12);
        let after_s = self.readings.last().map_or(0.0, |r| r.t_s) + PAUSE_S;
        let mut out: Vec<ScalarReading> = (0..parts.len())
            .map(|k| ScalarReading {
                holdout: true,
                point: k,
                sweep: self.readings.last().map_or(0, |r| r.sweep) + 1,
                x: parts[k] * self.line.range,
                clean: 0.0,
                y: 0.0,
                t_s: after_s + k as f64 * READING_S,
                direction: 1,
                temperature_degc: 21.0,
            })
            .collect();
        let added = self.signature.map(|s| s.at(self.truth.amplitude, &out));
        let noise = unit_noise(self.truth.rho, self.truth.tails_dof, &mut rng, parts.len());
        for (k, r) in out.iter_mut().enumerate() {
            r.clean = self.line.zero + self.line.slope * r.x + added.as_ref().map_or(0.0, |a| a[k]);
            r.y = read_out(
                self.truth.noise,
                r.clean + self.truth.noise_sd * noise[k],
                self.truth.noise_sd,
            );
        }
        out
    }

    /// Writes the session into `folder` (made if missing); its name is the id.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written.
    pub fn write(&self, folder: &Path) -> Result<(), PlantError> {
        std::fs::create_dir_all(folder).map_err(|source| PlantError::Write {
            path: folder.display().to_string(),
            source,
        })?;
        let id = folder
            .file_name()
            .map_or_else(|| "case".into(), |n| n.to_string_lossy().into_owned());
        let held_out = self.readings.iter().any(|r| r.holdout);
        let (kind, model) = if self.axis {
            ("axis", "")
        } else {
            (
                "transducer",
                "[transducer]\nstimulus_unit = \"N\"\nresponse_unit = \"V\"\nmodel = \"linear\"\n",
            )
        };
        let holdout = if held_out {
            "holdout = \"holdout.csv\"\n"
        } else {
            ""
        };
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
