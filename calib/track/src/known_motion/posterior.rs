//! Posterior of an episode's state: a grid along the wire, Gaussian in onset and gap at each of its
//! nodes.

use super::EpisodeContact;
use super::contact_path::{ContactPath, State, creep_mm};
use crate::arc_posterior::{ArcDensity, REGION, Region, normal_share};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector2, Vector3};

/// A node of the grid: onset and gap given the arc length.
#[derive(Debug, Clone, Copy)]
pub struct Node {
    /// Mean of onset and gap at this arc length.
    pub state: State,
    /// Covariance of onset and gap, mm^2.
    pub covariance_mm2: Matrix2<f64>,
    /// What is known of the two shares of a creeping contact; none where it stays.
    creep: Option<Creep>,
    /// Logarithm of the mass per arc length, not normalised.
    ln: f64,
    /// Mass that the node stands for.
    pub mass: f64,
    /// Length that it stands for, mm.
    length_mm: f64,
}

/// The two shares of a creeping contact in units of their prior's standard deviation.
#[derive(Debug, Clone, Copy)]
pub struct Creep {
    /// Mean.
    pub mean: Vector2<f64>,
    /// Covariance.
    pub covariance: Matrix2<f64>,
    /// Covariance of onset and gap (rows, mm) with them.
    pub with_state: Matrix2<f64>,
}

impl Node {
    /// A node whose mass follows from its neighbours; `ln` is the logarithm of the mass per arc
    /// length.
    pub(crate) fn new(
        (state, covariance_mm2): (State, Matrix2<f64>),
        creep: Option<Creep>,
        ln: f64,
    ) -> Self {
        Self {
            state,
            covariance_mm2,
            creep,
            ln,
            mass: 0.0,
            length_mm: 0.0,
        }
    }
}

/// Posterior of the state.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// Nodes by arc length; masses sum to 1.
    pub nodes: Vec<Node>,
    /// Density (1/mm^3) on the rim of the 95 % region.
    threshold: f64,
    /// See [`super::Settings::creep_sd`].
    creep_sd: f64,
}

impl Posterior {
    /// Of nodes by arc length whose masses are not normalised yet.
    pub(crate) fn of_nodes(mut nodes: Vec<Node>, creep_sd: f64) -> Self {
        // Logarithms relative to the largest: the exponentials neither overflow nor all underflow.
        let best = nodes.iter().map(|n| n.ln).fold(f64::NEG_INFINITY, f64::max);
        let places: Vec<f64> = nodes.iter().map(|n| n.state.s_mm).collect();
        let last = nodes.len().saturating_sub(1);
        for (k, node) in nodes.iter_mut().enumerate() {
            // Trapezoids.
            node.length_mm =
                0.5 * (places[(k + 1).min(last)] - places[k.saturating_sub(1)]).max(1e-9);
            node.mass = node.length_mm * (node.ln - best).exp();
        }
        let total: f64 = nodes.iter().map(|n| n.mass).sum();
        nodes.iter_mut().for_each(|n| n.mass /= total);
        let threshold = threshold(&nodes);
        Self {
            nodes,
            threshold,
            creep_sd,
        }
    }

    /// Density at a state, 1/mm^3.
    pub fn density(&self, state: &State) -> f64 {
        let at = self.nodes.partition_point(|n| n.state.s_mm <= state.s_mm);
        let (Some(a), Some(b)) = (
            at.checked_sub(1).and_then(|k| self.nodes.get(k)),
            self.nodes.get(at).or(self.nodes.last()),
        ) else {
            return 0.0;
        };
        let width = b.state.s_mm - a.state.s_mm;
        if state.s_mm > b.state.s_mm + 1e-9 {
            return 0.0;
        }
        let u = if width > 0.0 {
            (state.s_mm - a.state.s_mm) / width
        } else {
            0.0
        };
        let mix = |p: f64, q: f64| p + (q - p) * u;
        let mean = Vector2::new(
            mix(a.state.onset_mm, b.state.onset_mm),
            mix(a.state.gap_mm, b.state.gap_mm),
        );
        let covariance = a.covariance_mm2 * (1.0 - u) + b.covariance_mm2 * u;
        // A normal density in onset and gap, its peak by the mass over the arc length.
        let off = Vector2::new(state.onset_mm, state.gap_mm) - mean;
        let Some(inverse) = covariance.try_inverse() else {
            return 0.0;
        };
        // From node to node the peak changes by orders of magnitude: its logarithm is interpolated.
        mix(peak(a).max(1e-300).ln(), peak(b).max(1e-300).ln()).exp()
            * (-0.5 * off.dot(&(inverse * off))).exp()
    }

    /// Counts displacements along the push from a reading `by_mm` earlier on the way.
    pub(crate) fn move_onset(&mut self, by_mm: f64) {
        self.nodes
            .iter_mut()
            .for_each(|n| n.state.onset_mm += by_mm);
    }

    /// Whether a state lies in the 95 % region of highest density.
    pub fn holds(&self, state: &State) -> bool {
        self.density(state) >= self.threshold
    }

    /// The density over the arc length of first touch.
    pub fn arc(&self) -> ArcDensity {
        let [places, ln] = [|n: &Node| n.state.s_mm, |n: &Node| n.ln]
            .map(|of| self.nodes.iter().map(of).collect::<Vec<f64>>());
        ArcDensity::of_logarithms(&places, &ln)
    }

    /// The 95 % region of first touch along the wire: one piece for each peak.
    pub fn regions(&self) -> Vec<Region> {
        self.arc().regions()
    }

    /// Mean and covariance of the point's place at a reading, and the density over the arc length
    /// at which the wire is held there (of first touch where it is free); whether the reading was
    /// treated as an outlier is not known here.
    pub(crate) fn place(&self, path: &ContactPath<'_>, row: usize) -> EpisodeContact {
        let (row, (turn, moved_mm)) = (&path.rows[row], path.rows[row].since(path.reference));
        let (mut mean, mut square, mut contact) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
        let (mut total, mut along) = (0.0, Vec::new());
        // How far the point has crept by one standard deviation of each share.
        let way = creep_mm(&path.push, &turn, &path.displacement(row), self.creep_sd);
        let way = Matrix3x2::from_columns(&way);
        for n in self.nodes.iter().filter(|n| n.mass > 1e-9) {
            let Some((touch, across)) = path.touch(&n.state) else {
                continue;
            };
            let mut at = turn * (touch - path.push * n.state.onset_mm) + moved_mm;
            let axes = Matrix3x2::from_columns(&[-path.push, across]);
            // The place is linear in onset and gap: its covariance follows from dP/d(x, g), turned
            // as the point is.
            let turn = turn.matrix() * axes;
            let mut covariance = turn * n.covariance_mm2 * turn.transpose();
            // The point has gone on by its share of the way, which the readings tell together with
            // the onset.
            if let Some(creep) = &n.creep {
                at += way * creep.mean;
                let both = turn * creep.with_state * way.transpose();
                covariance += way * creep.covariance * way.transpose() + both + both.transpose();
            }
            mean += at * n.mass;
            // Mixture over the grid: second moments add; the square of the overall mean comes off
            // below.
            square += (covariance + at * at.transpose()) * n.mass;
            // Held where the point is past first touch: the share of the onset's normal
            // distribution.
            let sd = n.covariance_mm2[(0, 0)].max(1e-18).sqrt();
            let past = (at - touch).dot(&path.push) / sd;
            // The wire's point at the place: along the wire it spreads as the place does, and with
            // the node's share of the wire.
            let held = path
                .field
                .held_and_rate(&at, 0.0)
                .filter(|_| past > 0.0 && !row.free);
            let s_mm = held.map_or(n.state.s_mm, |h| h.0.arclength_mm);
            let tangent = path.field.free(s_mm).1;
            let spread =
                tangent.dot(&(covariance * tangent)).max(0.0) * f64::from(u8::from(past > 0.0));
            along.push((n.mass, s_mm, (spread + n.length_mm.powi(2) / 12.0).sqrt()));
            if !row.free {
                contact += n.mass * normal_share(past);
            }
            total += n.mass;
        }
        if total <= 0.0 {
            return EpisodeContact::default();
        }
        let mean = mean / total;
        let motion = Matrix3::identity() * row.moved_sd_mm.powi(2);
        EpisodeContact {
            place_mm: Some(mean),
            covariance_mm2: square / total - mean * mean.transpose() + motion,
            contact: contact / total,
            outlier: false,
            arc: ArcDensity::of_normals(&along, path.field.length_mm()),
        }
    }
}

/// Density at a node's middle, 1/mm^3.
fn peak(n: &Node) -> f64 {
    // Peak of a normal density in two dimensions, 1 / (2 pi sqrt |C|), times the mass per length.
    n.mass
        / (n.length_mm * std::f64::consts::TAU * n.covariance_mm2.determinant().max(1e-300).sqrt())
}

/// Density above which 95 % of the mass lies: of a two-dimensional Gaussian the share above `t` of
/// its peak is `1 - t`.
fn threshold(nodes: &[Node]) -> f64 {
    let peaks: Vec<f64> = nodes.iter().map(peak).collect();
    // A two-dimensional Gaussian has 1 - t / peak of its mass above the level t.
    let above = |t: f64| {
        nodes
            .iter()
            .zip(&peaks)
            .map(|(n, peak)| n.mass * (1.0 - t / peak).max(0.0))
            .sum::<f64>()
    };
    let (mut low, mut high) = (0.0, peaks.iter().copied().fold(0.0, f64::max));
    // The mass above a level falls monotonically with the level: bisection cannot fail.
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if above(middle) > REGION {
            low = middle
        } else {
            high = middle
        }
    }
    low
}
