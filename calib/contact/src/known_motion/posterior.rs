//! Posterior of an episode's state: a grid along the wire, Gaussian in onset and gap at each of its nodes.

use super::contact_path::{ContactPath, State};
use super::likelihood::{Likelihood, moved};
use super::{EpisodeContact, Settings};
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};
use std::cell::OnceCell;
use wcal_core::least_squares::{Damping, Linearised, NormalEquations, minimise};

/// First grid along the wire, mm.
pub(crate) const SCAN_MM: f64 = 1.0;
/// Trial onsets of the scan at each arc length.
const TRIALS: usize = 8;
/// Onset is looked for so far before the first loaded reading where no free one stands before it, mm.
const UNSEEN_MM: f64 = 10.0;
/// Steps of the Levenberg-Marquardt iteration.
const MAX_STEPS: usize = 30;
/// Damping past which no shorter step is tried.
const MAX_DAMPING: f64 = 1e4;
/// Change of the state at which it has settled, mm.
const SETTLED_MM: f64 = 1e-5;
/// Modes and nodes whose logarithm lies this far below the best have no mass.
const NO_MASS: f64 = 18.0;
/// Neighbouring nodes differ by no more than this in their logarithm where there is mass.
const MAX_STEP_LN: f64 = 0.7;
/// Nodes of the grid.
const MAX_NODES: usize = 400;
/// Mass of the stated region.
pub const REGION: f64 = 0.95;

/// A local maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mode {
    /// State.
    pub state: State,
    /// Logarithm of likelihood and prior there.
    pub ln: f64,
}

/// A node of the grid: onset and gap given the arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Mean of onset and gap at this arc length.
    pub state: State,
    /// Covariance of onset and gap, mm^2.
    pub covariance_mm2: Matrix2<f64>,
    /// Logarithm of the mass per arc length, not normalised.
    ln: f64,
    /// Mass that the node stands for.
    pub mass: f64,
    /// Length that it stands for, mm.
    length_mm: f64,
}

impl Node {
    /// A node whose mass follows from its neighbours; `ln` is the logarithm of the mass per arc length.
    pub(crate) fn new(state: State, covariance_mm2: Matrix2<f64>, ln: f64) -> Self {
        Self { state, covariance_mm2, ln, mass: 0.0, length_mm: 0.0 }
    }
}

/// A piece of the 95 % region along the wire.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Region {
    /// Arc length of first touch from and to, mm.
    pub from_mm: f64,
    /// See `from_mm`.
    pub to_mm: f64,
    /// Probability of the piece.
    pub probability: f64,
}

/// Posterior of the state.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// Nodes by arc length; masses sum to 1.
    pub nodes: Vec<Node>,
    /// Density (1/mm^3) on the rim of the 95 % region.
    threshold: f64,
    /// Logarithm of the evidence: all masses before they were normalised.
    pub ln_evidence: f64,
}

/// Numbers of a state that are free in a search.
const ALL: [usize; 3] = [0, 1, 2];
const GIVEN_ARCLENGTH: [usize; 2] = [1, 2];

/// Whitened residuals at a state.
struct Whitened<'a> {
    context: (&'a ContactPath<'a>, &'a Likelihood, &'a Settings),
    free: &'a [usize],
    state: State,
    residuals: DVector<f64>,
    /// Slopes are dear: they are taken where a step goes on from.
    slopes: OnceCell<Option<DMatrix<f64>>>,
}

impl<'a> Whitened<'a> {
    fn at(
        context: (&'a ContactPath<'a>, &'a Likelihood, &'a Settings),
        free: &'a [usize],
        state: State,
    ) -> Option<Self> {
        let (path, likelihood, settings) = context;
        let residuals = likelihood.residuals(path, settings, &state)?;
        Some(Self { context, free, state, residuals, slopes: OnceCell::new() })
    }

    /// Derivatives of the residuals by the free numbers, residuals x numbers.
    fn slopes(&self) -> Option<&DMatrix<f64>> {
        let (path, likelihood, settings) = self.context;
        let column = |k: &usize| likelihood.slope(path, settings, &self.state, *k);
        let make = || {
            let columns: Vec<DVector<f64>> = self.free.iter().map(column).collect::<Option<_>>()?;
            Some(DMatrix::from_columns(&columns))
        };
        self.slopes.get_or_init(make).as_ref()
    }
}

impl Linearised for Whitened<'_> {
    type Step = DVector<f64>;

    fn cost(&self) -> f64 {
        self.residuals.norm_squared()
    }

    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let j = self.slopes()?;
        let (matrix, descent) = (j.tr_mul(j), -j.tr_mul(&self.residuals));
        NormalEquations { cost: self.cost(), matrix, descent }.step(damping)
    }
}

/// The mode next to a state in the free numbers; the whitened slopes there come along.
fn search(
    path: &ContactPath<'_>,
    likelihood: &Likelihood,
    settings: &Settings,
    start: &State,
    free: &[usize],
) -> Option<(Mode, DMatrix<f64>)> {
    let context = (path, likelihood, settings);
    let inside = |s: &State| State {
        s_mm: s.s_mm.clamp(settings.first_mm, path.field.length_mm()),
        onset_mm: s.onset_mm.clamp(path.onset_mm[0], path.onset_mm[1]),
        ..*s
    };
    let stepped = |state: &State, _: &Whitened<'_>, step: &DVector<f64>| {
        inside(&free.iter().zip(step.iter()).fold(*state, |next, (k, d)| moved(&next, *k, *d)))
    };
    let start = inside(start);
    let first = (start, Whitened::at(context, free, start)?);
    let settled = |step: &DVector<f64>, _: [f64; 2]| step.lp_norm(1) < SETTLED_MM;
    let damping = Damping { shrink: 0.1, max: MAX_DAMPING, max_steps: MAX_STEPS, ..Damping::default() };
    let found = minimise(first, &damping, |s| Whitened::at(context, free, *s), stepped, settled);
    let ln = likelihood.ln_posterior(&found.at.residuals);
    let slopes = found.at.slopes()?.clone();
    ln.is_finite().then_some((Mode { state: found.place, ln }, slopes))
}

/// The mode next to a state.
pub(crate) fn climb(
    path: &ContactPath<'_>,
    likelihood: &Likelihood,
    settings: &Settings,
    start: &State,
) -> Option<Mode> {
    search(path, likelihood, settings, start, &ALL).map(|found| found.0)
}

/// Onset and gap at one arc length.
fn given_arclength(
    path: &ContactPath<'_>,
    likelihood: &Likelihood,
    settings: &Settings,
    start: &State,
) -> Option<Node> {
    let (mode, jacobian) = search(path, likelihood, settings, start, &GIVEN_ARCLENGTH)?;
    let normal = jacobian.transpose() * &jacobian;
    // An onset that the readings do not tell is even over the episode.
    let [low, high] = path.onset_mm;
    let mut information = Matrix2::new(normal[(0, 0)], normal[(0, 1)], normal[(1, 0)], normal[(1, 1)]);
    information[(0, 0)] += 12.0 / (high - low).powi(2);
    let covariance_mm2 = information.try_inverse()?;
    let ln = mode.ln + 0.5 * covariance_mm2.determinant().max(1e-300).ln();
    Some(Node::new(mode.state, covariance_mm2, ln))
}

/// The first grid: at each arc length the best of a few onsets, climbed.
fn scan(path: &ContactPath<'_>, likelihood: &Likelihood, settings: &Settings) -> Vec<Node> {
    let length = path.field.length_mm() - settings.first_mm;
    let count = (length / SCAN_MM).ceil().max(1.0) as usize;
    let free: Vec<f64> = (0..path.rows.len()).map(|k| path.along(k)).filter(|a| *a < 0.0).collect();
    let low = free.iter().copied().fold(f64::NEG_INFINITY, f64::max).max(path.onset_mm[0]);
    let low = if low.is_finite() && !free.is_empty() { low - 0.5 } else { -UNSEEN_MM };
    let mut nodes: Vec<Node> = Vec::with_capacity(count + 1);
    for k in 0..=count {
        let s_mm = settings.first_mm + length * k as f64 / count as f64;
        let trials = (0..TRIALS).map(|t| State {
            s_mm,
            onset_mm: low * (t as f64 + 0.5) / TRIALS as f64,
            gap_mm: 0.0,
        });
        let before = nodes.last().map(|n| State { s_mm, ..n.state });
        let best = trials
            .chain(before)
            .filter_map(|s| Some((s, likelihood.ln_posterior(&likelihood.residuals(path, settings, &s)?))))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        nodes.extend(best.and_then(|(s, _)| given_arclength(path, likelihood, settings, &s)));
    }
    nodes
}

/// Modes, best first.
pub(crate) fn modes(path: &ContactPath<'_>, likelihood: &Likelihood, settings: &Settings) -> Vec<Mode> {
    modes_of(path, likelihood, settings, &scan(path, likelihood, settings))
}

fn modes_of(
    path: &ContactPath<'_>,
    likelihood: &Likelihood,
    settings: &Settings,
    nodes: &[Node],
) -> Vec<Mode> {
    const APART_MM: f64 = 0.02;
    let ln = |k: usize| nodes.get(k).map_or(f64::NEG_INFINITY, |n| n.ln);
    let peaks = (0..nodes.len()).filter(|&k| (k == 0 || ln(k - 1) <= ln(k)) && ln(k) > ln(k + 1));
    let mut found: Vec<Mode> =
        peaks.filter_map(|k| climb(path, likelihood, settings, &nodes[k].state)).collect();
    found.sort_by(|a, b| b.ln.total_cmp(&a.ln));
    let mut apart: Vec<Mode> = Vec::new();
    for mode in found {
        if apart.iter().all(|m| (m.state.s_mm - mode.state.s_mm).abs() > APART_MM) {
            apart.push(mode);
        }
    }
    apart
}

impl Posterior {
    /// Of an episode under a likelihood.
    #[must_use]
    pub fn new(path: &ContactPath<'_>, likelihood: &Likelihood, settings: &Settings) -> Self {
        let mut nodes = scan(path, likelihood, settings);
        let modes = modes_of(path, likelihood, settings, &nodes);
        let best = modes.first().map_or(f64::NEG_INFINITY, |m| m.ln);
        for mode in modes.iter().filter(|m| m.ln > best - NO_MASS) {
            let Some(slopes) = likelihood.slopes(path, settings, &mode.state) else { continue };
            let information = slopes.transpose() * &slopes;
            let sd_mm = information.try_inverse().map_or(SCAN_MM, |c| c[(0, 0)].max(0.0).sqrt());
            let sd_mm = sd_mm.clamp(1e-3, SCAN_MM);
            for step in [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0] {
                for s in [mode.state.s_mm - step * sd_mm, mode.state.s_mm + step * sd_mm] {
                    let inside = s >= settings.first_mm && s <= path.field.length_mm();
                    let start = State { s_mm: s, ..mode.state };
                    nodes.extend(
                        inside.then(|| given_arclength(path, likelihood, settings, &start)).flatten(),
                    );
                }
            }
        }
        sort(&mut nodes);
        refine(path, likelihood, settings, &mut nodes);
        Self::of_nodes(nodes)
    }

    /// Of nodes by arc length whose masses are not normalised yet.
    pub(crate) fn of_nodes(mut nodes: Vec<Node>) -> Self {
        let best = nodes.iter().map(|n| n.ln).fold(f64::NEG_INFINITY, f64::max);
        let places: Vec<f64> = nodes.iter().map(|n| n.state.s_mm).collect();
        let last = nodes.len().saturating_sub(1);
        for (k, node) in nodes.iter_mut().enumerate() {
            // Trapezoids.
            node.length_mm = 0.5 * (places[(k + 1).min(last)] - places[k.saturating_sub(1)]).max(1e-9);
            node.mass = node.length_mm * (node.ln - best).exp();
        }
        let total: f64 = nodes.iter().map(|n| n.mass).sum();
        nodes.iter_mut().for_each(|n| n.mass /= total);
        let threshold = threshold(&nodes);
        Self { nodes, threshold, ln_evidence: best + total.ln() }
    }

    /// Density at a state, 1/mm^3.
    #[must_use]
    pub fn density(&self, state: &State) -> f64 {
        let at = self.nodes.partition_point(|n| n.state.s_mm <= state.s_mm);
        let (Some(a), Some(b)) =
            (at.checked_sub(1).and_then(|k| self.nodes.get(k)), self.nodes.get(at).or(self.nodes.last()))
        else {
            return 0.0;
        };
        let width = b.state.s_mm - a.state.s_mm;
        if state.s_mm > b.state.s_mm + 1e-9 {
            return 0.0;
        }
        let u = if width > 0.0 { (state.s_mm - a.state.s_mm) / width } else { 0.0 };
        let mix = |p: f64, q: f64| p + (q - p) * u;
        let mean = Vector2::new(mix(a.state.onset_mm, b.state.onset_mm), mix(a.state.gap_mm, b.state.gap_mm));
        let covariance = a.covariance_mm2 * (1.0 - u) + b.covariance_mm2 * u;
        let off = Vector2::new(state.onset_mm, state.gap_mm) - mean;
        let Some(inverse) = covariance.try_inverse() else { return 0.0 };
        mix(peak(a).max(1e-300).ln(), peak(b).max(1e-300).ln()).exp()
            * (-0.5 * off.dot(&(inverse * off))).exp()
    }

    /// Whether a state lies in the 95 % region of highest density.
    #[must_use]
    pub fn holds(&self, state: &State) -> bool {
        self.density(state) >= self.threshold
    }

    /// The 95 % region along the wire: one piece for each peak.
    #[must_use]
    pub fn regions(&self) -> Vec<Region> {
        let mut pieces: Vec<Region> = Vec::new();
        let mut open = false;
        for n in &self.nodes {
            let inside = peak(n) > self.threshold;
            let half = 0.5 * n.length_mm;
            if inside {
                let mass = n.mass * (1.0 - self.threshold / peak(n));
                match pieces.last_mut().filter(|_| open) {
                    Some(piece) => {
                        piece.to_mm = n.state.s_mm + half;
                        piece.probability += mass;
                    }
                    None => pieces.push(Region {
                        from_mm: n.state.s_mm - half,
                        to_mm: n.state.s_mm + half,
                        probability: mass,
                    }),
                }
            }
            open = inside;
        }
        pieces
    }

    /// Mean and covariance of the point's place at every reading, with the direction of the push taken from `path`.
    pub(crate) fn places(
        &self,
        path: &ContactPath<'_>,
        is_gross: impl Fn(usize) -> bool,
    ) -> Vec<EpisodeContact> {
        (0..path.rows.len())
            .map(|row| EpisodeContact { outlier: is_gross(row), ..self.place(path, row) })
            .collect()
    }

    /// The same at one reading; whether it was treated as an outlier is not known here.
    pub(crate) fn place(&self, path: &ContactPath<'_>, row: usize) -> EpisodeContact {
        let (mut mean, mut square, mut contact) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
        let mut total = 0.0;
        for n in self.nodes.iter().filter(|n| n.mass > 1e-9) {
            let Some((touch, across)) = path.touch(&n.state) else { continue };
            let at = path.carried(&(touch - path.push * n.state.onset_mm), row);
            let axes = nalgebra::Matrix3x2::from_columns(&[-path.push, across]);
            let turn = path.turned(row).matrix() * axes;
            mean += at * n.mass;
            square += (turn * n.covariance_mm2 * turn.transpose() + at * at.transpose()) * n.mass;
            let sd = n.covariance_mm2[(0, 0)].max(1e-18).sqrt();
            let past = (at - touch).dot(&path.push) / sd;
            contact += n.mass * if path.rows[row].free { 0.0 } else { normal_share(past) };
            total += n.mass;
        }
        if total <= 0.0 {
            return EpisodeContact {
                place_mm: None,
                covariance_mm2: Matrix3::zeros(),
                contact: 0.0,
                outlier: false,
            };
        }
        let mean = mean / total;
        let motion = Matrix3::identity() * path.rows[row].moved_sd_mm.powi(2);
        EpisodeContact {
            place_mm: Some(mean),
            covariance_mm2: square / total - mean * mean.transpose() + motion,
            contact: contact / total,
            outlier: false,
        }
    }
}

/// Standard normal distribution function.
pub(crate) fn normal_share(z: f64) -> f64 {
    0.5 * statrs::function::erf::erfc(-z / std::f64::consts::SQRT_2)
}

fn sort(nodes: &mut Vec<Node>) {
    nodes.sort_by(|a, b| a.state.s_mm.total_cmp(&b.state.s_mm));
    nodes.dedup_by(|a, b| (a.state.s_mm - b.state.s_mm).abs() < 1e-6);
}

/// Halves what lies between nodes of which one has mass and whose logarithms differ.
fn refine(path: &ContactPath<'_>, likelihood: &Likelihood, settings: &Settings, nodes: &mut Vec<Node>) {
    for _ in 0..8 {
        let best = nodes.iter().map(|n| n.ln).fold(f64::NEG_INFINITY, f64::max);
        let between: Vec<State> = nodes
            .windows(2)
            .filter(|w| {
                w[0].ln.max(w[1].ln) > best - 9.0
                    && (w[0].ln - w[1].ln).abs() > MAX_STEP_LN
                    && w[1].state.s_mm - w[0].state.s_mm > 1e-3
            })
            .map(|w| State {
                s_mm: 0.5 * (w[0].state.s_mm + w[1].state.s_mm),
                onset_mm: 0.5 * (w[0].state.onset_mm + w[1].state.onset_mm),
                gap_mm: 0.5 * (w[0].state.gap_mm + w[1].state.gap_mm),
            })
            .collect();
        if between.is_empty() || nodes.len() + between.len() > MAX_NODES {
            break;
        }
        let found: Vec<Node> =
            between.iter().filter_map(|s| given_arclength(path, likelihood, settings, s)).collect();
        if found.is_empty() {
            break;
        }
        nodes.extend(found);
        sort(nodes);
    }
}

/// Density at a node's middle, 1/mm^3.
fn peak(n: &Node) -> f64 {
    n.mass / (n.length_mm * std::f64::consts::TAU * n.covariance_mm2.determinant().max(1e-300).sqrt())
}

/// Density above which 95 % of the mass lies: of a two-dimensional Gaussian the share above `t` of its peak is `1 - t`.
fn threshold(nodes: &[Node]) -> f64 {
    let peaks: Vec<f64> = nodes.iter().map(peak).collect();
    let above =
        |t: f64| nodes.iter().zip(&peaks).map(|(n, peak)| n.mass * (1.0 - t / peak).max(0.0)).sum::<f64>();
    let (mut low, mut high) = (0.0, peaks.iter().copied().fold(0.0, f64::max));
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if above(middle) > REGION { low = middle } else { high = middle }
    }
    low
}
