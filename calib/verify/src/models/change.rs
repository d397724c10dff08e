//! What changed since a calibration, by readings that it was not fitted to.
//!
//! ```text
//! e = y - f(x),     V = N + S                                  noise of each reading, and what the calibration has wrong in all of them
//! d = c' V^-1 e / c' V^-1 c,     sd(d)^2 = 1 / c' V^-1 c       of a change d along the column c
//! z_k^2 = fall of e' V^-1 e by column k ~ F(1, nu)             beside those that are named
//! p = 1 - (1 - p_max)^M,     M = (sum sqrt l)^2 / sum l        l: eigenvalues of the columns' correlation (N. W. Galwey, Genet. Epidemiol. 33 (2009) 559)
//! ```
//!
//! Named changes are fitted together. One is named where no other one explains the readings nearly as
//! well.

use crate::levels::{NORMAL_95, z};
use crate::method::Basis;
use crate::method::distributions::{f_tail, sd_interval95};
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Serialize;

/// Chance that a unit that did not change is said to have.
const CHANGED: f64 = 0.03;
/// The same of its scatter.
const SCATTER: f64 = 0.01;
/// Of a second change beside the first.
const FURTHER: f64 = 0.01;
/// Quantile of a normal for a power of 90 %.
const POWER_90: f64 = 1.2816;
/// Chance that another change seems better than the one that was, by more than it is believed.
const WRONG: f64 = 0.02;
/// Fewest readings that say anything.
const LEAST: usize = 3;
/// Most changes that are named: more of them are no explanation.
const MOST: usize = 4;
/// What is said beside a name where something is left that no change takes up.
const UNEXPLAINED: &str = "a change that is none of these";
/// Steps of a fit, the shortest share of one, and how far off a prediction may be that is linear, in
/// standard deviations of the readings together.
const STEPS: usize = 8;
const SHORTEST: f64 = 0.05;
const LINEAR: f64 = 0.3;
/// Share of a column below which the others leave nothing of it.
const SAME: f64 = 1e-9;

/// A change since the calibration.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CalibrationChange {
    /// `zero`, `sensitivity`, an accepted effect, `temperature`, `hysteresis`, `scatter`; of a
    /// whisker also `gain`, `groove depth` and others, of one grating where it says so.
    pub name: String,
    /// Size.
    pub value: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
    /// Unit of both.
    pub unit: String,
    /// What it costs at most within the range, in the unit of the quantity that is measured; of a
    /// whisker the contact's displacement, root mean square over the loaded readings.
    pub cost: f64,
    /// Changes that explain the readings nearly as well: which one it was is not known.
    pub or: Vec<String>,
}

/// What the readings can show of a change.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Tested {
    /// Change.
    pub name: String,
    /// Standard deviation of its size by these readings, were it the only one; null where they show
    /// none of it.
    pub sd: Option<f64>,
    /// Cost of the smallest change that is seen in nine of ten such tests; null where none is.
    pub smallest: Option<f64>,
    /// That is no more than the stated uncertainty of one reading.
    pub is_tested: bool,
    /// No calibration is said to hold without it.
    pub is_required: bool,
    /// Readings that would be needed, spread as these are; null where none are enough.
    pub readings_needed: Option<usize>,
}

/// What readings say of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CalibrationCheck {
    /// Readings.
    pub readings: usize,
    /// Chance of readings as far off along one of the changes, had nothing changed.
    pub p: f64,
    /// What changed; empty where nothing did.
    pub changes: Vec<CalibrationChange>,
    /// What the readings can show.
    pub tested: Vec<Tested>,
    /// Expanded uncertainty of one reading that the calibration states.
    pub stated: f64,
    /// Unit of costs.
    pub unit: String,
    /// Zero that was taken from the readings themselves; null without --tare.
    pub tare: Option<TaredZero>,
}

/// The zero of readings that were tared.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct TaredZero {
    /// Unloaded readings.
    pub readings: usize,
    /// Their mean error: how far the zero is from the calibration's.
    pub zero: f64,
    /// Unit of the zero.
    pub unit: String,
}

impl CalibrationCheck {
    /// The readings would show each change that matters.
    pub fn is_tested(&self) -> bool {
        self.tested.iter().all(|t| t.is_tested || !t.is_required)
    }
}

/// What a change by 1 does to the readings.
pub(crate) struct Column {
    pub(crate) name: String,
    pub(crate) unit: String,
    pub(crate) values: DVector<f64>,
    pub(crate) cost: f64,
    /// It cannot be negative.
    pub(crate) one_sided: bool,
    /// See [`Tested::is_required`].
    pub(crate) is_required: bool,
}

/// New readings beside what a calibration says of them.
pub(crate) struct NewReadings {
    pub(crate) readings: usize,
    /// Measured less predicted.
    pub(crate) errors: DVector<f64>,
    /// Covariance of their noise, and of what the calibration has wrong.
    pub(crate) noise: DMatrix<f64>,
    pub(crate) shared: DMatrix<f64>,
    /// Degrees of freedom of the noise.
    pub(crate) dof: f64,
    pub(crate) columns: Vec<Column>,
    /// What one standard deviation of the noise costs, of what is wrong, and of both 1.96.
    pub(crate) noise_cost: f64,
    pub(crate) shared_cost: f64,
    pub(crate) stated: f64,
    pub(crate) unit: String,
}

/// What changes of these sizes, one a column, do to the readings; none where they cannot be.
pub(crate) type Response<'a> = &'a dyn Fn(&[f64]) -> Option<DVector<f64>>;

/// Changes fitted together.
struct Fitted {
    sizes: Vec<f64>,
    /// What is left, and the columns there, both whitened.
    left: DVector<f64>,
    columns: Vec<DVector<f64>>,
}

/// Whitened readings beside the columns.
struct Whitened<'a> {
    root: DMatrix<f64>,
    errors: DVector<f64>,
    columns: Vec<DVector<f64>>,
    /// Where large changes are not so many times small ones.
    response: Option<Response<'a>>,
}

impl Whitened<'_> {
    fn white(&self, v: &DVector<f64>) -> DVector<f64> {
        let solved = self.root.solve_lower_triangular(v);
        solved.unwrap_or_else(|| v.clone())
    }

    /// The changes `set` fitted together, by Gauss and Newton's steps where they are not linear.
    fn fit(&self, set: &[usize]) -> Fitted {
        let mut at = Fitted {
            sizes: vec![0.0; set.len()],
            left: self.errors.clone(),
            columns: set.iter().map(|k| self.columns[*k].clone()).collect(),
        };
        let Some(response) = self.response.filter(|_| !set.is_empty()) else {
            at.advance(1.0);
            return at;
        };
        let left = |sizes: &[f64]| {
            let mut all = vec![0.0; self.columns.len()];
            set.iter().zip(sizes).for_each(|(k, size)| all[*k] = *size);
            Some(&self.errors - self.white(&response(&all)?))
        };
        for _ in 0..STEPS {
            let from = (at.sizes.clone(), at.left.clone());
            let mut share = 1.0;
            let (expected, found) = loop {
                (at.sizes, at.left) = from.clone();
                at.advance(share);
                let found = left(&at.sizes).filter(|f| f.norm() <= from.1.norm());
                if found.is_some() || share < SHORTEST {
                    break (at.left.clone(), found);
                }
                share *= 0.5;
            };
            let Some(found) = found else {
                (at.sizes, at.left) = from;
                break;
            };
            let is_linear = (&found - expected).norm() < LINEAR;
            at.left = found;
            if is_linear && share == 1.0 {
                break;
            }
            for (j, k) in set.iter().enumerate() {
                let mut sizes = at.sizes.clone();
                let step = 1.0 / self.columns[*k].norm();
                sizes[j] += step;
                if let Some(moved) = left(&sizes) {
                    at.columns[j] = (&at.left - moved) / step;
                }
            }
        }
        at
    }
}

impl Fitted {
    /// Goes so much of the way to the least squares of its columns.
    fn advance(&mut self, share: f64) {
        for (k, (step, _)) in together(&self.columns, &self.left).into_iter().enumerate() {
            self.sizes[k] += share * step;
            self.left -= &self.columns[k] * (share * step);
        }
    }
}

impl NewReadings {
    /// What they say; none without noise.
    pub(crate) fn check(self, response: Option<Response<'_>>) -> Option<CalibrationCheck> {
        let columns = &self.columns;
        let mut white = Whitened {
            root: (&self.noise + &self.shared).cholesky()?.l(),
            errors: DVector::zeros(0),
            columns: Vec::new(),
            response,
        };
        white.errors = white.white(&self.errors);
        white.columns = columns.iter().map(|c| white.white(&c.values)).collect();
        let x = &white.columns;
        let (mut named, mut falls_of) = (Vec::new(), Vec::new());
        let mut or: Vec<Vec<String>> = Vec::new();
        let (mut p, mut level) = (1.0, CHANGED);
        let mut fitted = white.fit(&named);
        loop {
            let basis = Basis::of(fitted.columns.iter().cloned());
            let before = fitted.left.norm_squared();
            let fall = |k: usize| {
                let own = basis.project_off(&x[k]);
                if own.norm_squared() <= SAME * x[k].norm_squared() {
                    return (k, 0.0, own);
                }
                let with = white.fit(&[&named[..], &[k]].concat());
                let is_none = columns[k].one_sided && with.sizes.last().is_some_and(|s| *s < 0.0);
                let fall = before - with.left.norm_squared();
                (k, if is_none { 0.0 } else { fall.max(0.0) }, own)
            };
            let free = (0..x.len()).filter(|k| !named.contains(k));
            let falls: Vec<(usize, f64, DVector<f64>)> = free.map(fall).collect();
            let Some((best, most, _)) = falls.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
                break;
            };
            let tests = effective_tests(falls.iter().map(|f| &f.2));
            let chance = self.chance(*most, tests);
            if named.is_empty() {
                p = chance;
            }
            if !(chance < level) || named.len() >= MOST {
                break;
            }
            // Of two as unlike as is worst, the wrong one leads by a with the chance Phi(-sqrt a).
            let alike = z(WRONG / tests.max(1.0)).powi(2);
            let rivals = falls.iter().filter(|f| f.0 != *best && most - f.1 < alike);
            or.push(rivals.map(|f| columns[f.0].name.clone()).collect());
            named.push(*best);
            falls_of.push(*most);
            level = FURTHER;
            fitted = white.fit(&named);
        }
        // What no column takes up.
        let basis = Basis::of(fitted.columns.iter().chain(x).cloned());
        let left_dof = (self.errors.len() as f64 - basis.rank() as f64).max(0.0);
        let left = basis.project_off(&fitted.left).norm_squared();
        let scatters = f_tail(left / left_dof, [left_dof, self.dof]).is_some_and(|p| p < SCATTER);
        let ratio = (left / left_dof).sqrt();
        let mut changes = Vec::new();
        let sds = together(&fitted.columns, &fitted.left);
        for (j, (k, mut or)) in named.iter().zip(or).enumerate() {
            let Column {
                name, unit, cost, ..
            } = &columns[*k];
            // Beside what nothing explains a name is one of several, if it stands out at all.
            if scatters {
                or.push(UNEXPLAINED.to_owned());
                if !(self.chance(falls_of[j] / ratio.powi(2), x.len() as f64) < CHANGED) {
                    continue;
                }
            }
            let (size, sd) = (fitted.sizes[j], sds.get(j).map_or(0.0, |s| s.1));
            changes.push(CalibrationChange {
                name: name.clone(),
                value: size,
                interval95: [-1.0, 1.0].map(|s| size + s * NORMAL_95 * sd),
                unit: unit.clone(),
                cost: size.abs() * cost,
                or,
            });
        }
        if scatters {
            changes.push(CalibrationChange {
                name: "scatter".to_owned(),
                value: ratio,
                interval95: sd_interval95(ratio, left_dof).unwrap_or([ratio; 2]),
                unit: "times the stated".to_owned(),
                cost: NORMAL_95 * ratio * self.noise_cost,
                or: Vec::new(),
            });
        }
        let tested = columns.iter().zip(x).map(|(c, x)| {
            let sd = 1.0 / x.norm();
            let smallest = (NORMAL_95 + POWER_90) * sd * c.cost;
            // One reading cannot distinguish a shift from a stray.
            let many = !(smallest <= self.stated) || self.readings < LEAST;
            // What all readings share is no smaller by more of them.
            let floor = (NORMAL_95 + POWER_90) * self.shared_cost;
            let needed = (self.readings as f64 * (smallest / self.stated).powi(2)).ceil() as usize;
            Tested {
                name: c.name.clone(),
                sd: Some(sd).filter(|sd| sd.is_finite()),
                smallest: Some(smallest).filter(|s| s.is_finite()),
                is_tested: !many,
                is_required: c.is_required,
                readings_needed: (many && smallest.is_finite() && floor < self.stated)
                    .then_some(needed.max(LEAST)),
            }
        });
        Some(CalibrationCheck {
            readings: self.readings,
            p,
            tested: tested.collect(),
            changes,
            stated: self.stated,
            unit: self.unit.clone(),
            tare: None,
        })
    }

    /// Chance of such a fall by one of so many columns. The noise is an estimate, too.
    fn chance(&self, fall: f64, tests: f64) -> f64 {
        let single = f_tail(fall, [1.0, self.dof]).unwrap_or(1.0);
        -(tests * (-single).ln_1p()).exp_m1()
    }
}

/// How many independent tests the columns are worth.
fn effective_tests<'a>(columns: impl Iterator<Item = &'a DVector<f64>>) -> f64 {
    let unit: Vec<DVector<f64>> = columns.filter_map(|c| c.try_normalize(0.0)).collect();
    let alike = DMatrix::from_fn(unit.len(), unit.len(), |i, j| unit[i].dot(&unit[j]));
    let roots = alike.symmetric_eigenvalues().map(|l| l.max(0.0).sqrt());
    roots.sum().powi(2) / roots.norm_squared().max(1.0)
}

/// Sizes of the columns fitted together to whitened errors, and their standard deviations.
fn together(columns: &[DVector<f64>], e: &DVector<f64>) -> Vec<(f64, f64)> {
    if columns.is_empty() {
        return Vec::new();
    }
    let x = DMatrix::from_columns(columns);
    let Some(inverse) = (x.transpose() * &x).try_inverse() else {
        return Vec::new();
    };
    let sizes = &inverse * (x.transpose() * e);
    let sd = |k: usize| inverse[(k, k)].max(0.0).sqrt();
    (0..columns.len()).map(|k| (sizes[k], sd(k))).collect()
}
