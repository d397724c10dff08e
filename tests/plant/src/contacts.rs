//! Contacts of a session by the plant's own rod: an examiner's check of what a program says of its
//! tracker. SIMULATED.
//!
//! ```text
//! fit          y_i = z + A s_i(0) + D_i a                 readings of the other trajectories; s: noise-free shifts with the groove where it is stated
//! locate       min over d of  sum |R_i (y_i - z - A s_i(d) - D_i a)|^2 + (d . n)^2 / s_g^2        readings of the trajectory left out
//! ```
//!
//! d moves the groove off its stated place, n is across wire and push, D are the slopes of the
//! shifts by the parameters of the effects. Without effects it is the declared model. Gauss-Newton
//! by differences; the program's rod and tracker have no part in it.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::PlantError;
use crate::bench::Trajectory;
use crate::case::Case;
use crate::effects::{Effect, Kind};
use crate::layout::PlannedRow;
use crate::noise::samples;
use crate::simulate::Plant;

type V3 = Vector3<f64>;
type Pair = Vector2<f64>;

/// Standard deviation of the gap between free wire and groove that is assumed, mm.
const GAP_SD_MM: f64 = 0.5;
/// Step of differences, mm, and of an effect's number, as a share of it.
const STEP_MM: f64 = 0.02;
const STEP_SHARE: f64 = 0.02;
/// Steps of Gauss-Newton, and the longest of them, mm.
const STEPS: usize = 8;
const LONGEST_MM: f64 = 1.0;

/// A contact on a trajectory that the fit left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocatedContact {
    /// Identifier of the trajectory.
    pub trajectory: usize,
    /// Distance from where the groove is, mm.
    pub error_mm: f64,
    /// Loaded readings.
    pub readings: usize,
}

/// Root mean square over readings, mm.
pub fn rms_mm(all: &[LocatedContact]) -> f64 {
    let sum = |of: fn(&LocatedContact) -> f64| all.iter().map(of).sum::<f64>();
    (sum(|c| c.readings as f64 * c.error_mm.powi(2)) / sum(|c| c.readings as f64)).sqrt()
}

/// The open readings of a session under effects whose numbers are fitted, too.
struct Examined<'a> {
    case: &'a Case,
    effects: &'a [Effect],
    rows: Vec<PlannedRow>,
    trajectories: Vec<Trajectory>,
    /// R with R' R the inverse covariance of a reading's channels, which share the noise of the
    /// reference.
    roots: Vec<Matrix2<f64>>,
    /// Shifts with the groove where it is stated, pm.
    stated: Vec<Pair>,
    /// Slopes of the shifts by each number of the effects.
    slopes: Vec<Vec<Pair>>,
}

/// Coefficients of a fold: zero, mixture of the shifts, numbers of the effects less the true ones.
struct Coefficients {
    zero: Pair,
    mixture: Matrix2<f64>,
    numbers: Vec<f64>,
}

impl<'a> Examined<'a> {
    fn new(case: &'a Case, effects: &'a [Effect]) -> Result<Self, PlantError> {
        let open = case.readings.iter().filter(|r| !r.planned.holdout);
        let rows: Vec<PlannedRow> = open.map(|r| r.planned.clone()).collect();
        let trajectories = case.bench.trajectories();
        let root = |r: &PlannedRow| {
            let white = case
                .truth
                .noise
                .white_pm(r, trajectories[r.trajectory].reach_mm);
            let blur2 = case.bench.sample_sd_pm.powi(2) / samples(r) as f64;
            let covariance = Matrix2::identity() * (white * white + blur2) + Matrix2::repeat(blur2);
            let lower = covariance.cholesky().and_then(|c| c.l().try_inverse());
            lower.unwrap_or_else(Matrix2::identity)
        };
        let roots = rows.iter().map(root).collect();
        let mut own = Self {
            case,
            effects,
            rows,
            trajectories,
            roots,
            stated: Vec::new(),
            slopes: Vec::new(),
        };
        let still = vec![V3::zeros(); own.trajectories.len()];
        own.stated = own.shifts(effects, &still)?;
        for (changed, by) in neighbours(effects) {
            let moved = own.shifts(&changed, &still)?;
            own.slopes.push(
                moved
                    .iter()
                    .zip(&own.stated)
                    .map(|(a, b)| (a - b) / by)
                    .collect(),
            );
        }
        Ok(own)
    }

    /// Noise-free shifts with the groove moved on each trajectory, pm.
    fn shifts(&self, effects: &[Effect], by_mm: &[V3]) -> Result<Vec<Pair>, PlantError> {
        let mut trajectories = self.trajectories.clone();
        for (t, by) in trajectories.iter_mut().zip(by_mm) {
            t.path.offset_mm += by;
        }
        let mut plant = Plant::new(
            self.case.bench.clone(),
            trajectories,
            self.rows.clone(),
            &self.case.truth.noise,
        );
        Ok(plant
            .clean(effects)?
            .iter()
            .map(|c| Pair::from(c.shift_pm))
            .collect())
    }

    /// Compensated readings, pm.
    fn measured(&self) -> Vec<Pair> {
        let bench = &self.case.bench;
        let open = self.case.readings.iter().filter(|r| !r.planned.holdout);
        open.map(|r| {
            let warm_pm = 1e3 * (r.reference_nm - bench.reference_nominal_nm);
            Pair::from([0, 1].map(|c| 1e3 * (r.fbg_nm[c] - bench.nominal_nm[c]) - warm_pm))
        })
        .collect()
    }

    /// By the readings that are not on a trajectory.
    fn fit(&self, measured: &[Pair], left_out: usize) -> Option<Coefficients> {
        let kept: Vec<usize> = (0..self.rows.len())
            .filter(|&i| self.rows[i].trajectory != left_out)
            .collect();
        let numbers = self.slopes.len();
        let mut design = DMatrix::zeros(2 * kept.len(), 6 + numbers);
        let mut values = DVector::zeros(2 * kept.len());
        for (k, &i) in kept.iter().enumerate() {
            let mut block = DMatrix::zeros(2, 6 + numbers);
            for c in 0..2 {
                block[(c, 3 * c)] = 1.0;
                (0..2).for_each(|j| block[(c, 3 * c + 1 + j)] = self.stated[i][j]);
                self.slopes
                    .iter()
                    .enumerate()
                    .for_each(|(j, slope)| block[(c, 6 + j)] = slope[i][c]);
            }
            design
                .rows_mut(2 * k, 2)
                .copy_from(&(self.roots[i] * block));
            values
                .rows_mut(2 * k, 2)
                .copy_from(&(self.roots[i] * measured[i]));
        }
        // Columns of one size: numbers of the effects have units of their own.
        let sizes: Vec<f64> = design.column_iter().map(|c| c.norm().max(1e-300)).collect();
        design
            .column_iter_mut()
            .zip(&sizes)
            .for_each(|(mut c, size)| c /= *size);
        let found = design.svd(true, true).solve(&values, 1e-9).ok()?;
        let b = |k: usize| found[k] / sizes[k];
        Some(Coefficients {
            zero: Pair::new(b(0), b(3)),
            mixture: Matrix2::new(b(1), b(2), b(4), b(5)),
            numbers: (0..numbers).map(|j| b(6 + j)).collect(),
        })
    }

    /// Along the push, along the wire, across both.
    fn axes(&self, trajectory: usize) -> [V3; 3] {
        let path = &self.trajectories[trajectory].path;
        let (_, tangent) = self.case.bench.wire().rest(path.arclength_mm);
        [
            path.direction,
            tangent,
            tangent.cross(&path.direction).normalize(),
        ]
    }

    /// Trajectories of the open readings.
    fn visited(&self) -> Vec<usize> {
        let mut visited: Vec<usize> = self.rows.iter().map(|r| r.trajectory).collect();
        visited.sort_unstable();
        visited.dedup();
        visited
    }

    /// One step of Gauss-Newton on a trajectory, in its axes.
    fn step(
        &self,
        (trajectory, coefficients): (usize, &Coefficients),
        measured: &[Pair],
        (here, slopes): (&[Pair], &[Vec<Pair>; 3]),
        gap_mm: f64,
    ) -> Option<V3> {
        let Coefficients {
            zero,
            mixture,
            numbers,
        } = coefficients;
        let mut information = Matrix3::zeros();
        let mut score = V3::zeros();
        for i in (0..self.rows.len()).filter(|&i| self.rows[i].trajectory == trajectory) {
            let effect: Pair = self
                .slopes
                .iter()
                .zip(numbers)
                .map(|(s, a)| s[i] * *a)
                .sum();
            let left = self.roots[i] * (measured[i] - zero - mixture * here[i] - effect);
            let columns = slopes.each_ref().map(|s| self.roots[i] * mixture * s[i]);
            for (a, column) in columns.iter().enumerate() {
                score[a] += column.dot(&left);
                (0..3).for_each(|b| information[(a, b)] += column.dot(&columns[b]));
            }
        }
        information[(2, 2)] += GAP_SD_MM.powi(-2);
        score[2] -= gap_mm * GAP_SD_MM.powi(-2);
        Some(information.try_inverse()? * score)
    }

    /// Slopes of the shifts along each trajectory's own axes, about places.
    fn slopes_at(&self, places_mm: &[V3], here: &[Pair]) -> Result<[Vec<Pair>; 3], PlantError> {
        let mut all = [const { Vec::new() }; 3];
        for (k, slopes) in all.iter_mut().enumerate() {
            let moved: Vec<V3> = places_mm
                .iter()
                .enumerate()
                .map(|(t, p)| p + self.axes(t)[k] * STEP_MM)
                .collect();
            let there = self.shifts(self.effects, &moved)?;
            *slopes = there
                .iter()
                .zip(here)
                .map(|(a, b)| (a - b) / STEP_MM)
                .collect();
        }
        Ok(all)
    }

    fn located(&self, trajectory: usize, off_mm: &V3) -> LocatedContact {
        let loaded = |r: &&PlannedRow| r.trajectory == trajectory && r.role != "rest";
        LocatedContact {
            trajectory: self.trajectories[trajectory].id,
            error_mm: off_mm.norm(),
            readings: self.rows.iter().filter(loaded).count(),
        }
    }
}

/// The effects with each of their numbers changed, and by how much.
fn neighbours(effects: &[Effect]) -> Vec<(Vec<Effect>, f64)> {
    let vector = [
        Kind::OffsetGroove,
        Kind::TemperatureLinear,
        Kind::DriftLinear,
        Kind::FbgThree,
        Kind::FbgFull,
        Kind::ComplianceTwoAxes,
    ];
    let mut all = Vec::new();
    for (k, effect) in effects.iter().enumerate() {
        let mut push = |changed: Effect, by: f64| {
            let mut list = effects.to_vec();
            list[k] = changed;
            all.push((list, by));
        };
        if vector.contains(&effect.kind) {
            for j in 0..effect.shape.len() {
                let mut changed = effect.clone();
                changed.shape[j] += STEP_SHARE;
                push(changed, STEP_SHARE);
            }
        } else {
            let by = STEP_SHARE * effect.amplitude;
            push(
                Effect {
                    amplitude: effect.amplitude + by,
                    ..effect.clone()
                },
                by,
            );
        }
    }
    all
}

/// Contacts of the open trajectories, each left out of the fit, under `effects` (none: the declared
/// model); the groove is where it is stated, or off by `stated_off_mm`.
///
/// # Errors
/// [`PlantError::Wire`] when the rod does not settle.
pub fn left_out_contacts(
    case: &Case,
    effects: &[Effect],
    stated_off_mm: &V3,
) -> Result<Vec<LocatedContact>, PlantError> {
    let e = Examined::new(case, effects)?;
    let measured = e.measured();
    let visited = e.visited();
    let fits: Vec<(usize, Coefficients)> = visited
        .into_iter()
        .filter_map(|t| Some((t, e.fit(&measured, t)?)))
        .collect();
    let mut places = vec![V3::zeros(); e.trajectories.len()];
    for _ in 0..STEPS {
        let here = e.shifts(effects, &places)?;
        let slopes = e.slopes_at(&places, &here)?;
        for (t, fit) in &fits {
            let axes = e.axes(*t);
            let gap_mm = places[*t].dot(&axes[2]);
            let Some(step) = e.step((*t, fit), &measured, (&here, &slopes), gap_mm) else {
                continue;
            };
            let by = axes[0] * step[0] + axes[1] * step[1] + axes[2] * step[2];
            places[*t] += by * (LONGEST_MM / by.norm()).min(1.0);
        }
    }
    Ok(fits
        .iter()
        .map(|(t, _)| e.located(*t, &(places[*t] - stated_off_mm)))
        .collect())
}

/// Root mean square error over trajectories that is expected over the noise of the readings
/// (white), mm: `draws` of it, to first order.
///
/// # Errors
/// As [`left_out_contacts`].
pub fn expected_error_mm(case: &Case, draws: usize, seed: u64) -> Result<f64, PlantError> {
    let e = Examined::new(case, &case.effects)?;
    let places = vec![V3::zeros(); e.trajectories.len()];
    let slopes = e.slopes_at(&places, &e.stated)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut squares = 0.0;
    for _ in 0..draws {
        let mut noise = |root: &Matrix2<f64>| {
            let normal = Pair::from_fn(|_, _| StandardNormal.sample(&mut rng));
            root.try_inverse()
                .map_or_else(Pair::zeros, |inverse| inverse * normal)
        };
        let measured: Vec<Pair> = e
            .stated
            .iter()
            .zip(&e.roots)
            .map(|(s, root)| s + noise(root))
            .collect();
        let mut all = Vec::new();
        for t in e.visited() {
            let Some(fit) = e.fit(&measured, t) else {
                continue;
            };
            let Some(step) = e.step((t, &fit), &measured, (&e.stated, &slopes), 0.0) else {
                continue;
            };
            let axes = e.axes(t);
            all.push(e.located(
                t,
                &(axes[0] * step[0] + axes[1] * step[1] + axes[2] * step[2]),
            ));
        }
        squares += rms_mm(&all).powi(2);
    }
    Ok((squares / draws as f64).sqrt())
}
