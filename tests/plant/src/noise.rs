//! Noise as instruments make it: its kinds, the numbers of one session, and the true covariance
//! that an examiner knows.
//!
//! Every part has a stream of its own, so that the white noise of a seed is the same under every
//! kind.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use serde::Serialize;

use crate::bench::{Bench, Trajectory};
use crate::layout::PlannedRow;

/// How a session's noise is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Noise {
    /// White and normal.
    #[default]
    Gaussian,
    /// White, from Student's t.
    StudentT,
    /// Loaded readings noisier than rest readings.
    Loaded,
    /// Poses scatter: readings of one visit share an offset.
    Pose,
    /// Grows in proportion to depth.
    Depth,
    /// Wavelengths in whole steps of the converter.
    Rounding,
    /// One reading grossly off.
    OneGross,
    /// Two readings grossly off.
    TwoGross,
    /// First-order Gauss-Markov drift of either channel beside white noise.
    Drift,
    /// Student's t, rounded.
    RoundedT,
    /// Drift and Student's t.
    DriftT,
}

impl Noise {
    /// Every kind.
    pub const ALL: [Self; 11] = [
        Self::Gaussian,
        Self::StudentT,
        Self::Loaded,
        Self::Pose,
        Self::Depth,
        Self::Rounding,
        Self::OneGross,
        Self::TwoGross,
        Self::Drift,
        Self::RoundedT,
        Self::DriftT,
    ];

    /// Name in tables and in truth.json.
    pub fn name(self) -> &'static str {
        match self {
            Self::Gaussian => "gaussian",
            Self::StudentT => "student-t",
            Self::Loaded => "loaded",
            Self::Pose => "pose",
            Self::Depth => "depth",
            Self::Rounding => "rounding",
            Self::OneGross => "one-gross",
            Self::TwoGross => "two-gross",
            Self::Drift => "drift",
            Self::RoundedT => "rounded-t",
            Self::DriftT => "drift-t",
        }
    }
}

/// First-order Gauss-Markov noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Markov {
    /// Stationary standard deviation, pm.
    pub sd_pm: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
}

/// How wavelengths are rounded.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rounding {
    /// Step, pm.
    pub step_pm: f64,
    /// Decimals of a wavelength in nm as written.
    pub decimals: usize,
}

/// A reading that is grossly off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Outlier {
    /// Index among all rows, points first.
    pub row: usize,
    /// Error of both channels, nm.
    pub error_nm: [f64; 2],
}

/// The numbers of one session's noise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Law {
    /// Kind.
    pub kind: Noise,
    /// White noise of a rest reading, pm.
    pub repeat_pm: f64,
    /// Degrees of freedom of the white part's tails (its variance stays that of `repeat_pm`).
    pub tails_dof: Option<f64>,
    /// White noise of a loaded reading over that of a rest reading.
    pub loaded: f64,
    /// White noise at full depth over that of a rest reading.
    pub full_depth: f64,
    /// Scatter of poses, pm.
    pub pose_pm: f64,
    /// Noise correlated in time.
    pub drift: Option<Markov>,
    /// Rounding.
    pub rounding: Option<Rounding>,
    /// Gross readings.
    pub gross: Vec<Outlier>,
}

/// Samples averaged in a settled and in a moving reading.
const SETTLED_SAMPLES: usize = 2000;
const MOVING_SAMPLES: usize = 200;

/// Samples averaged in a reading.
pub fn samples(row: &PlannedRow) -> usize {
    if row.speed_mm_s > 0.0 {
        MOVING_SAMPLES
    } else {
        SETTLED_SAMPLES
    }
}

/// Share of gross readings that fall into the holdout.
const GROSS_HELD_OUT: f64 = 0.2;
/// A gross reading's variance in the examiner's covariance: it says nothing.
const NO_WEIGHT_PM2: f64 = 1e12;

fn log_uniform(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low.ln()..high.ln()).exp()
}

impl Law {
    /// White normal noise of the bench.
    pub fn gaussian(bench: &Bench) -> Self {
        Self {
            kind: Noise::Gaussian,
            repeat_pm: bench.noise_pm,
            tails_dof: None,
            loaded: 1.0,
            full_depth: 1.0,
            pose_pm: 0.0,
            drift: None,
            rounding: None,
            gross: Vec::new(),
        }
    }

    /// Draws sizes and rates of a kind.
    pub fn draw(kind: Noise, bench: &Bench, rows: &[PlannedRow], seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0401_5e00);
        let rng = &mut rng;
        let mut law = Self {
            kind,
            ..Self::gaussian(bench)
        };
        if matches!(kind, Noise::StudentT | Noise::RoundedT | Noise::DriftT) {
            law.tails_dof = Some(log_uniform(rng, 3.0, 12.0));
        }
        if matches!(kind, Noise::Drift | Noise::DriftT) {
            law.drift = Some(Markov {
                sd_pm: law.repeat_pm * rng.random_range(1.0..3.0),
                time_constant_s: log_uniform(rng, 60.0, 1000.0),
            });
        }
        if matches!(kind, Noise::Rounding | Noise::RoundedT) {
            // Whole pm, tenths written short or padded, and steps of a converter that are no
            // decimals.
            law.rounding = Some(match rng.random_range(0..4_usize) {
                0 => Rounding {
                    step_pm: 1.0,
                    decimals: 3,
                },
                1 => Rounding {
                    step_pm: 0.1,
                    decimals: 4,
                },
                2 => Rounding {
                    step_pm: 0.1,
                    decimals: 7,
                },
                _ => Rounding {
                    step_pm: log_uniform(rng, 0.2, 1.6),
                    decimals: 7,
                },
            });
        }
        match kind {
            Noise::Loaded => law.loaded = rng.random_range(2.0..5.0),
            Noise::Pose => law.pose_pm = law.repeat_pm * rng.random_range(2.0..5.0),
            Noise::Depth => law.full_depth = rng.random_range(2.0..5.0),
            Noise::OneGross => law.gross = gross(1, rows, rng),
            Noise::TwoGross => law.gross = gross(2, rows, rng),
            _ => {}
        }
        law
    }

    /// White noise of a row, pm; `reach_mm` is the depth that counts as full.
    pub fn white_pm(&self, row: &PlannedRow, reach_mm: f64) -> f64 {
        let depth = (row.commanded_mm / reach_mm).clamp(0.0, 1.0);
        let loaded = if row.role == "rest" { 1.0 } else { self.loaded };
        self.repeat_pm * loaded * (1.0 + (self.full_depth - 1.0) * depth)
    }

    /// What a channel and the reference each add to a temperature-compensated reading, pm: samples
    /// and rounding.
    fn reading_pm(&self, bench: &Bench, row: &PlannedRow) -> f64 {
        let rounding = self.rounding.map_or(0.0, |r| r.step_pm * r.step_pm / 12.0);
        (bench.sample_sd_pm.powi(2) / samples(row) as f64 + rounding).sqrt()
    }

    /// Standard deviation of a temperature-compensated reading at a pose not visited before, pm.
    pub fn new_pose_pm(&self, bench: &Bench, row: &PlannedRow, reach_mm: f64) -> f64 {
        let pose = if row.role == "rest" {
            0.0
        } else {
            self.pose_pm
        };
        let drift = self.drift.map_or(0.0, |d| d.sd_pm);
        let reading = self.reading_pm(bench, row);
        (self.white_pm(row, reach_mm).powi(2)
            + pose * pose
            + drift * drift
            + 2.0 * reading * reading)
            .sqrt()
    }

    /// Standard deviation of repeated readings at rest, pm, without the steps of rounding.
    pub fn repeat_at_rest_pm(&self, bench: &Bench) -> f64 {
        (self.repeat_pm.powi(2) + 2.0 * bench.sample_sd_pm.powi(2) / SETTLED_SAMPLES as f64).sqrt()
    }

    /// Draws the noise of a whole session.
    pub fn series(&self, rows: &[PlannedRow], trajectories: &[Trajectory], seed: u64) -> Series {
        let mut tails = ChaCha8Rng::seed_from_u64(seed ^ 0x7a11_5000);
        let mut slow = ChaCha8Rng::seed_from_u64(seed ^ 0x510e_0000);
        let mut poses = ChaCha8Rng::seed_from_u64(seed ^ 0x905e_0000);
        let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
        let chi = self
            .tails_dof
            .and_then(|dof| Some((dof, ChiSquared::new(dof).ok()?)));
        let visits = visits(rows);
        let mut drift = [0.0; 2];
        let mut offset = [0.0; 2];
        let mut out = Series {
            scale_pm: Vec::new(),
            add_pm: Vec::new(),
        };
        for (i, row) in rows.iter().enumerate() {
            let white = self.white_pm(row, trajectories[row.trajectory].reach_mm);
            out.scale_pm.push([0, 1].map(|_| match &chi {
                // t over its standard deviation, as a normal over the root of a chi-square.
                Some((dof, chi)) => white * ((dof - 2.0) / chi.sample(&mut tails)).sqrt(),
                None => white,
            }));
            if let Some(d) = self.drift {
                let kept = if i == 0 {
                    0.0
                } else {
                    (-(row.t_s - rows[i - 1].t_s) / d.time_constant_s).exp()
                };
                for state in &mut drift {
                    *state =
                        kept * *state + (1.0 - kept * kept).sqrt() * d.sd_pm * normal(&mut slow);
                }
            }
            if i == 0 || visits[i] != visits[i - 1] {
                offset = [0, 1].map(|_| self.pose_pm * normal(&mut poses));
            }
            let pose = if row.role == "rest" { [0.0; 2] } else { offset };
            out.add_pm.push([0, 1].map(|c| drift[c] + pose[c]));
        }
        out
    }

    /// A wavelength in nm as the instrument writes it.
    pub fn rounded(&self, nm: f64) -> f64 {
        self.rounding
            .map_or(nm, |r| (1e3 * nm / r.step_pm).round() * r.step_pm / 1e3)
    }

    /// Decimals of a wavelength in nm.
    pub fn decimals(&self) -> usize {
        self.rounding.map_or(7, |r| r.decimals)
    }
}

/// Gross readings at different settled rows.
fn gross(count: usize, rows: &[PlannedRow], rng: &mut impl Rng) -> Vec<Outlier> {
    let mut out: Vec<Outlier> = Vec::new();
    while out.len() < count {
        let held_out = rng.random_bool(GROSS_HELD_OUT);
        let of: Vec<usize> = (0..rows.len())
            .filter(|&i| rows[i].speed_mm_s == 0.0 && rows[i].holdout == held_out)
            .collect();
        let row = of[rng.random_range(0..of.len())];
        let mut one =
            || log_uniform(rng, 0.05, 10.0) * if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let (first, second) = (one(), one());
        let error_nm = [[first, 0.0], [0.0, second], [first, second]][rng.random_range(0..3_usize)];
        if out.iter().all(|g| g.row != row) {
            out.push(Outlier { row, error_nm });
        }
    }
    out
}

/// Number of the visit that each row belongs to: settled readings in turn at one stage position are
/// one visit.
pub fn visits(rows: &[PlannedRow]) -> Vec<usize> {
    let mut visit = 0;
    (0..rows.len())
        .map(|i| {
            let stays = i > 0 && {
                let (a, b) = (&rows[i - 1], &rows[i]);
                a.trajectory == b.trajectory
                    && a.commanded_mm == b.commanded_mm
                    && a.speed_mm_s == 0.0
                    && b.speed_mm_s == 0.0
                    && a.role != "rest"
                    && b.role != "rest"
            };
            visit += usize::from(i > 0 && !stays);
            visit
        })
        .collect()
}

/// The noise of a session: reading = scale x normal + add, in pm, per channel.
pub struct Series {
    /// White part.
    pub scale_pm: Vec<[f64; 2]>,
    /// Drift and pose.
    pub add_pm: Vec<[f64; 2]>,
}

/// The true covariance of one channel over the rows of points.csv, as its Cholesky factor.
pub struct Covariance {
    rows: Vec<usize>,
    factor: Option<Cholesky<f64, Dyn>>,
}

impl Covariance {
    /// Of the compensated readings under `law`. What the reference adds is counted in each channel
    /// by itself.
    pub fn new(law: &Law, bench: &Bench, rows: &[PlannedRow], trajectories: &[Trajectory]) -> Self {
        let points: Vec<usize> = (0..rows.len()).filter(|&i| !rows[i].holdout).collect();
        let visits = visits(rows);
        let matrix = DMatrix::from_fn(points.len(), points.len(), |i, j| {
            let (a, b) = (points[i], points[j]);
            let mut sum = 0.0;
            if a == b {
                sum += law
                    .white_pm(&rows[a], trajectories[rows[a].trajectory].reach_mm)
                    .powi(2);
                sum += 2.0 * law.reading_pm(bench, &rows[a]).powi(2);
                sum += if law.gross.iter().any(|g| g.row == a) {
                    NO_WEIGHT_PM2
                } else {
                    0.0
                };
            }
            if visits[a] == visits[b] && rows[a].role != "rest" {
                sum += law.pose_pm.powi(2);
            }
            if let Some(d) = law.drift {
                sum += d.sd_pm.powi(2)
                    * (-(rows[a].t_s - rows[b].t_s).abs() / d.time_constant_s).exp();
            }
            sum
        });
        Self {
            rows: points,
            factor: matrix.cholesky(),
        }
    }

    /// Rows it speaks of, in order.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Columns with unit white noise; NaN where the covariance has no factor.
    pub fn whiten(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor
            .as_ref()
            .and_then(|f| f.l_dirty().solve_lower_triangular(columns))
            .unwrap_or_else(|| DMatrix::from_element(columns.nrows(), columns.ncols(), f64::NAN))
    }

    /// Norm of what `base` (whitened) leaves of a column, in noises.
    pub fn left_over(&self, base: &DMatrix<f64>, column: DVector<f64>) -> f64 {
        let y = self
            .whiten(&DMatrix::from_columns(&[column]))
            .column(0)
            .into_owned();
        if !y.iter().all(|v| v.is_finite()) {
            return f64::NAN;
        }
        let Ok(x) = base.clone().svd(true, true).solve(&y, 1e-12) else {
            return f64::NAN;
        };
        (y - base * x).norm()
    }
}
