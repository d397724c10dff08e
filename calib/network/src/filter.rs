//! Bayes filter on a grid of arc lengths (a point-mass filter), the physical baseline of the
//! network.
//!
//! State at sample t: node k of the inverse's curve (arc length `s_k`, at the tip the tilt of the
//! force), offset x in [-1/2, 1/2] within the node, velocity `v = ds/dz` (path along the curve by
//! travel of the base), and where they are not known the coefficient of friction mu and the speed u
//! of the base, which travels along its +z:
//!
//! ```text
//! predict and update   w_t(k, mu, u)  ~  sum_j  w_{t-1}(j, mu, u)  p(k | j, mu, u)  p(m_t | k, j, mu, u)
//! constraint           g = n . (p_k - p_j + z u dt) + d(mu) slip_x  =  0  on one rigid body at rest
//! likelihood           p(m_t | ...) = N(g; 0, var_g)  Laplace(turn)  |dg/dm|  |dturn/dm|
//! transition           p(k | j) = sum_i a_i N(s_k - s_j; v_i u dt, var_i)  +  jumps
//! evidence             log p(m_t | m_1 .. m_{t-1}) = log sum w_t   (before normalisation)
//! ```
//!
//! `p_k`, `n_k`: point and direction of the force that explain the moments m at node k
//! (`StaticInverse`). Along its normal the touched point moves as the object does, and Coulomb
//! friction leans the force against the slip across the wire by `d = mu / sqrt(1 + mu^2)`. At first
//! contact the deflection is at most the base's travel. Friction along the wire, a bending object
//! and several contacts are outside the model. Offsets and velocities within a node are Gaussian
//! and merged by their moments (`GridCell`).
//!
//! Sources: R. S. Bucy, K. D. Senne, "Digital synthesis of non-linear filters", Automatica 7 (1971)
//! 287; D. Alspach, H. Sorenson, "Nonlinear Bayesian estimation using Gaussian sum approximations",
//! IEEE Trans. Automatic Control 17 (1972) 439.

mod exp;
mod grid_cell;
mod sample_geometry;
mod settings;
mod transition;

use crate::inverse::{InverseSolution, StaticInverse};
use grid_cell::GridCell;
pub use settings::{BayesSettings, FILTER_RANGES, FilterBank};
use transition::{KnownStep, TransitionModel};

/// The filter of one whisker.
#[derive(Debug, Clone)]
pub struct BayesFilter<'a> {
    inverse: &'a StaticInverse,
    settings: BayesSettings,
    /// Weights by friction, speed, then node; empty without contact.
    weights: Vec<Vec<GridCell>>,
    before: Vec<InverseSolution>,
    now: Vec<InverseSolution>,
    /// Logarithm of the predictive density of the last sample, 1/(N mm)^2; 0 where there was no
    /// prediction.
    log_evidence: f64,
}

impl<'a> BayesFilter<'a> {
    /// Without contact so far.
    pub fn new(inverse: &'a StaticInverse, settings: BayesSettings) -> Self {
        Self {
            inverse,
            settings,
            weights: Vec::new(),
            before: Vec::new(),
            now: Vec::new(),
            log_evidence: 0.0,
        }
    }

    /// Inverse solutions of the last sample, one a node.
    pub fn solutions(&self) -> &[InverseSolution] {
        &self.now
    }

    /// Posterior over the nodes at the last sample; empty without contact.
    pub fn posterior(&self) -> Vec<f64> {
        let nodes = self.inverse.nodes.len();
        let mut sum = vec![0.0; if self.weights.is_empty() { 0 } else { nodes }];
        for (k, cell) in self.weights.iter().flat_map(|row| row.iter().enumerate()) {
            // A place between two nodes is split between them by linear interpolation, which
            // conserves the mean.
            let neighbour = if cell.offset < 0.0 {
                k.checked_sub(1)
            } else {
                Some(k + 1)
            };
            let share = match neighbour {
                Some(neighbour) if neighbour < nodes => {
                    sum[neighbour] += cell.weight * cell.offset.abs();
                    cell.offset.abs()
                }
                _ => 0.0,
            };
            sum[k] += cell.weight * (1.0 - share);
        }
        sum
    }

    /// Mean velocity at each node: path of the contact along the curve by the base's travel; empty
    /// without contact.
    pub fn velocities(&self) -> Vec<f64> {
        let nodes = if self.weights.is_empty() {
            0
        } else {
            self.inverse.nodes.len()
        };
        // Mean over frictions and speeds by their weights.
        let mean = |k: usize| {
            let (weight, sum) = self.weights.iter().fold((0.0, 0.0), |(weight, sum), row| {
                (
                    weight + row[k].weight,
                    sum + row[k].weight * row[k].velocity,
                )
            });
            if weight > 0.0 { sum / weight } else { 0.0 }
        };
        (0..nodes).map(mean).collect()
    }

    /// Posterior mean of the base's speed, mm/s; none without contact or where the speed is known.
    pub fn speed_mm_s(&self) -> Option<f64> {
        if self.weights.len() <= self.settings.frictions().len() {
            return None;
        }
        let speeds = self.speeds();
        let sum: f64 = speeds
            .iter()
            .cycle()
            .zip(&self.weights)
            .map(|(v, row)| v * weight(row))
            .sum();
        let total = self.total();
        (total > 0.0).then(|| sum / total)
    }

    /// Logarithm of the predictive density of the last sample given those before, 1/(N mm)^2: low
    /// where one contact on a rigid body explains the change of the moments badly. 0 without
    /// contact and at a first contact.
    pub fn log_evidence(&self) -> f64 {
        self.log_evidence
    }

    /// Travel of the base at its known speed, or at each of the grid, which stands for an interval:
    /// the standard deviation of a uniform distribution is its width / sqrt(12).
    fn sweep_steps(&self, dt_s: f64, base_mm_s: Option<f64>) -> Vec<KnownStep> {
        let speeds = base_mm_s.map_or_else(|| self.speeds(), |v| vec![v]);
        let gap_mm_s = speeds.get(1).map_or(0.0, |next| next - speeds[0]);
        let step = |v: &f64| KnownStep {
            travel_mm: v * dt_s,
            travel_sd_mm: gap_mm_s * dt_s / 12.0_f64.sqrt(),
        };
        speeds.iter().map(step).collect()
    }

    /// Takes a sample `dt_s` after the one before; `base_mm_s` is the base's speed along +z where
    /// it is known. `shared`: a filter of the same onset that has taken the sample already, whose
    /// inverse solutions serve this one, too.
    pub fn step(
        &mut self,
        dt_s: f64,
        moment_nmm: [f64; 2],
        base_mm_s: Option<f64>,
        shared: Option<&Self>,
    ) {
        std::mem::swap(&mut self.before, &mut self.now);
        let steps = &self.sweep_steps(dt_s, base_mm_s)[..];
        let size = moment_nmm[0].hypot(moment_nmm[1]);
        let is_free = size < self.settings.onset_nmm;
        // A free wire's moments are noise without a direction: the solutions must not depend on it.
        let at_nmm = if is_free { FREE_NMM } else { moment_nmm };
        match shared {
            Some(other) => self.now.clone_from(&other.now),
            None => self.inverse.solutions(at_nmm, &mut self.now),
        }
        self.log_evidence = 0.0;
        if is_free {
            self.weights.clear();
            return;
        }
        let frictions = self.settings.frictions().len();
        let predicted = self.weights.len() == frictions * steps.len() && self.predict(dt_s, steps);
        if !predicted {
            // First contact, or no transition explains the sample: the posterior is reset to the
            // prior.
            // Only a wire that was free one sample ago bounds its deflection by the travel since.
            let loaded_before = !self.weights.is_empty() || self.before.is_empty();
            if !loaded_before {
                // The wire at rest: the limit of small moments in the present direction.
                self.inverse
                    .solutions(moment_nmm.map(|m| m / size * REST_NMM), &mut self.before);
            }
            let model = TransitionModel::new(&self.settings, self.inverse, &self.before, &self.now);
            let prior =
                |step: &KnownStep| model.first_contact_prior((!loaded_before).then_some(step));
            let rows: Vec<Vec<GridCell>> = steps.iter().map(prior).collect();
            self.weights = std::iter::repeat_n(rows, frictions).flatten().collect();
            self.normalise();
        }
    }

    fn speeds(&self) -> Vec<f64> {
        let ([low, high], n) = (self.settings.speed_mm_s, self.settings.speeds.max(2));
        (0..n)
            .map(|k| low + (high - low) * k as f64 / (n - 1) as f64)
            .collect()
    }

    /// Prediction and update of all rows; false where no transition explains the sample.
    fn predict(&mut self, dt_s: f64, steps: &[KnownStep]) -> bool {
        let model = TransitionModel::new(&self.settings, self.inverse, &self.before, &self.now);
        let total = self.total();
        let rows = self
            .settings
            .frictions()
            .iter()
            .flat_map(|f| steps.iter().map(move |s| (*f, s)));
        let mut next: Vec<Vec<GridCell>> = rows
            .zip(&self.weights)
            .map(|((friction, step), row)| model.predict(row, total, step, friction))
            .collect();
        // Random walk of the speed; a quarter to each neighbour at most, so that a row keeps half.
        let share = (self.settings.speed_change_per_s * dt_s).min(0.25);
        next.chunks_mut(steps.len())
            .for_each(|rows| diffuse_speeds(rows, share));
        self.weights = next;
        let total = self.total();
        self.log_evidence = total.max(f64::MIN_POSITIVE).ln();
        self.normalise()
    }

    fn total(&self) -> f64 {
        self.weights.iter().map(|row| weight(row)).sum()
    }

    fn normalise(&mut self) -> bool {
        let total = self.total();
        if total > 0.0 {
            self.weights
                .iter_mut()
                .flatten()
                .for_each(|c| c.weight /= total);
        }
        total > 0.0
    }
}

/// Moment of a wire practically at rest, N mm.
const REST_NMM: f64 = 1e-5;
/// Moments (y, z) that stand for none: those of a push against the base's travel.
const FREE_NMM: [f64; 2] = [REST_NMM, 0.0];

fn weight(row: &[GridCell]) -> f64 {
    row.iter().map(|c| c.weight).sum()
}

/// Random walk of the base's speed on its grid: a share of each row's weight goes to each
/// neighbour.
fn diffuse_speeds(rows: &mut [Vec<GridCell>], share: f64) {
    let n = rows.len();
    if n < 2 {
        return;
    }
    let old = rows.to_vec();
    for (v, row) in rows.iter_mut().enumerate() {
        // Reflecting ends: no weight leaves the grid.
        let (low, high) = (v.saturating_sub(1), (v + 1).min(n - 1));
        for (j, cell) in row.iter_mut().enumerate() {
            let parts = [
                (&old[v][j], 1.0 - 2.0 * share),
                (&old[low][j], share),
                (&old[high][j], share),
            ];
            *cell = GridCell::merged(&parts);
        }
    }
}
