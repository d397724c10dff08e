//! The posterior of an episode's contact reading by reading: a Rao-Blackwellised point-mass filter.
//!
//! The arc length s of first touch lies on a grid; given s, all else,
//! `z = (x, g, c_1 .. c_n, tau, b)` (onset, gap, the calibration's common unknowns, clock, noise of
//! the pose), is Gaussian with mean z^ and covariance C. A reading is linearised at the mean
//! (iterated), with P_k and m(P) as in the parent module, D = dm/dP and B the covariance of the
//! pose's noise:
//!
//! ```text
//! y_k = m(P_k) + sum_j H_kj c_j + D v_k tau + F_k b_k + n_k,    H_kj = h_kj + D w_kj + m_j(P_k) - m(P_k)
//! A   = dy/dz = [-D Q_k u,  D Q_k n,  H_k1 ..,  D v_k,  F_k]            zero but for h and F while the wire is free
//! b_k = rho b_(k-1) + e_k,   cov e_k = (1 - rho^2) B
//!       by pose: rho = exp(-|d_k - d_(k-1)| / l), F_k = 1;   in time: rho = exp(-|t_k - t_(k-1)| / tau), F_k F_k' = q R_k, B = 1
//! S   = A C A' + R_k,   z^ += C A' S_w^-1 i,   C -= C A' S_w^-1 A C,   i = y_k - y(z^),   S_w = A C A' + R_k / w
//! w_s ~ w_s [p0 + p1 + p2],   p0 = (1 - eps) N(i; 0, S),  p1 = eps N(i; 0, S + 99 R_k),  p2 = eps / (pi M^2),  M = 3 N mm
//! w   = (p0 + p1 / 100) / (p0 + p1 + p2)                                expected inverse variance: regular, noisy, or anything
//! chi2 = sum_k i' S^-1 i ~ chi-squared(2 n - 3)                         at the node of most mass
//! ```
//!
//! First touch is a kink (a step where g is not 0). A loaded reading is held; one that is not and
//! lies within 4 sd of first touch is taken both ways,
//! `w_s ~ w_s [Phi(-q) p(y | free) + Phi(q) p(y | held)]`, q the depth over its standard deviation,
//! and the two Gaussians are joined by their moments: so free readings bound the onset.
//!
//! Grid: where a reading parts two neighbouring nodes by more than 1 in ln w (in its regular part,
//! where all nodes take it for an outlier), a new node between them takes all readings so far;
//! nodes 14 below the best in ln w go, and there are at most [`MAX_NODES`]. Nothing is interpolated
//! between nodes: where ln w falls by hundreds from one to the next, no polynomial follows it.
//! Friction: the play operator of the parent module, carried node by node at the mean; its slope is
//! that without friction.
//!
//! Sources: R. S. Bucy, K. D. Senne, Automatica 7 (1971) 287 (point masses); A. Doucet, N. de
//! Freitas, K. Murphy, S. Russell, UAI 2000, 176 (Rao-Blackwellised filters); B. M. Bell, F. W.
//! Cathey, IEEE Trans. Automat. Contr. 38 (1993) 294 (iterated update as Gauss-Newton step);
//! decomposition of the likelihood into innovations: F. C. Schweppe, IEEE Trans. Inf. Theory 11
//! (1965) 61; correlated noise as a state: A. E. Bryson, L. J. Henrikson, J. Spacecr. Rockets 5
//! (1968) 1327; expected weights of outliers: A. P. Dempster, N. M. Laird, D. B. Rubin, J. R. Stat.
//! Soc. B 39 (1977) 1, the uniform part: D. W. Hogg, J. Bovy, D. Lang, arXiv:1008.4686, 3.

use super::contact_path::{BEFORE_MM, ContactPath, creep_mm, loaded};
use super::episode::{CorrelatedNoise, TABLE_MM};
use super::node::{NodeFilter, Reading};
use super::posterior;
use super::segmenter::Beginning;
use super::{EpisodeContact, Innovations, MomentField, MotionRow, Posterior, Settings};
use nalgebra::{Matrix2, Vector3};
use rayon::prelude::*;

/// Free readings before a contact that belong to it: they bound its onset.
pub(crate) const LEAD: usize = 25;
/// First grid along the wire, mm.
const SCAN_MM: f64 = 1.0;
/// Largest number of nodes: what bounds the time of a reading.
const MAX_NODES: usize = 56;
/// Halvings of the grid at one reading.
const MAX_HALVINGS: usize = 9;
/// Smallest distance of nodes, mm.
const MIN_STEP_MM: f64 = 1e-3;
/// Nodes whose logarithm lies this far below the best are not refined.
const REFINED_LN: f64 = 8.0;
/// Nodes whose logarithm lies this far below the best go.
const NO_MASS: f64 = 14.0;
/// Neighbouring nodes differ by no more than this in their logarithm where there is mass.
const MAX_STEP_LN: f64 = 1.0;

impl Settings {
    /// Whether a reading is loaded beyond its noise, the pose's included.
    pub fn is_loaded(&self, row: &MotionRow) -> bool {
        let Some(CorrelatedNoise::ByPose {
            covariance_nmm2, ..
        }) = self.correlated
        else {
            return loaded(row);
        };
        // A draw of the pose's noise moves the moments of a free wire as a load would.
        loaded(&MotionRow {
            noise_nmm2: row.noise_nmm2 + covariance_nmm2,
            ..row.clone()
        })
    }
}

/// Posterior of an episode so far.
#[derive(Debug, Clone)]
pub struct RecursivePosterior {
    settings: Settings,
    /// Unit vector of the push.
    push: Vector3<f64>,
    /// The first loaded reading, from which displacements count.
    reference: MotionRow,
    /// All readings, those of a creeping contact with its unknowns: the free ones before the first
    /// loaded one, and from that on.
    lead: Vec<MotionRow>,
    rows: Vec<MotionRow>,
    /// Width of the uniform prior of the onset, mm.
    range_mm: f64,
    nodes: Vec<NodeFilter>,
    /// Logarithm that was taken off those of all nodes.
    taken_ln: f64,
}

/// An episode after all of its readings: its state is constant, so that the last posterior is that
/// of all of them.
pub(super) struct Finished {
    pub posterior: Posterior,
    pub innovations: Innovations,
    /// Whether each reading was treated as an outlier when it came.
    pub outliers: Vec<bool>,
}

/// Takes all readings of an episode. None without a loaded reading, where the push runs along the
/// whole wire, or where no contact explains the readings.
pub(super) fn run(
    field: &MomentField,
    push: Vector3<f64>,
    rows: &[MotionRow],
    settings: &Settings,
) -> Option<Finished> {
    let first = rows.iter().position(|r| settings.is_loaded(r))?;
    let lead = &rows[first.saturating_sub(LEAD)..first];
    let mut own = RecursivePosterior::start(field, *settings, push, lead, &rows[first])?;
    let mut outliers = vec![false; first + 1];
    for row in &rows[first + 1..] {
        own.push(field, row);
        outliers.push(own.best()?.last_outlier > 0.5);
    }
    (!own.nodes.is_empty()).then(|| Finished {
        posterior: own.posterior(),
        innovations: own.innovations(),
        outliers,
    })
}

impl RecursivePosterior {
    /// With the readings by which a contact has become known; see [`Self::start`].
    pub fn begin(field: &MomentField, settings: Settings, beginning: &Beginning) -> Option<Self> {
        let Beginning { push, lead, rows } = beginning;
        let (first, others) = rows.split_first()?;
        let mut own = Self::start(field, settings, *push, lead, first)?;
        others.iter().for_each(|row| own.push(field, row));
        Some(own)
    }

    /// From the first loaded reading and the free ones before it (`lead`, in order of time); none
    /// where the push runs along the whole wire.
    pub fn start(
        field: &MomentField,
        settings: Settings,
        push: Vector3<f64>,
        lead: &[MotionRow],
        first: &MotionRow,
    ) -> Option<Self> {
        let push = push.try_normalize(1e-9)?;
        let mut own = Self {
            settings,
            push,
            reference: first.clone(),
            lead: Vec::new(),
            rows: Vec::new(),
            range_mm: 0.0,
            nodes: Vec::new(),
            taken_ln: 0.0,
        };
        own.rows = vec![own.with_creep(field, first)];
        own.lead = lead.iter().map(|row| own.with_creep(field, row)).collect();
        let along_mm = |row: &MotionRow| own.displacement_mm(field, row).dot(&push);
        // Readings of the lead lie before the reference, along_mm < 0: their way widens the prior.
        own.range_mm = BEFORE_MM - own.lead.iter().map(along_mm).fold(0.0, f64::min);
        // Equal steps over the wire, on which s is uniform.
        let length = field.length_mm() - settings.first_mm;
        let count = (length / SCAN_MM).ceil().max(1.0) as usize;
        let place = |k: usize| settings.first_mm + length * k as f64 / count as f64;
        own.nodes = (0..=count)
            .filter_map(|k| own.node(field, place(k)))
            .collect();
        own.normalise();
        (!own.nodes.is_empty()).then_some(own)
    }

    /// A node with all readings so far; none where the push runs along the wire.
    fn node(&self, field: &MomentField, s_mm: f64) -> Option<NodeFilter> {
        // No reading came before the first one: its draw is a new one, of the whole variance.
        let first = Reading {
            correlation: 0.0,
            ..self.reading(field, &self.rows[0], &self.rows[0])
        };
        let mut node = NodeFilter::new(&first, s_mm, self.range_mm)?;
        node.start(&first);
        let correlated = self.settings.correlated.is_some();
        // Backwards in time from first touch: the state is constant, and the correlated noise is
        // reversible.
        if correlated {
            node.keep_correlated();
        }
        let mut later = &self.rows[0];
        for row in self.lead.iter().rev() {
            node.update(&self.reading(field, later, row));
            later = row;
        }
        if correlated {
            node.resume_correlated();
        }
        for pair in self.rows.windows(2) {
            node.update(&self.reading(field, &pair[0], &pair[1]));
        }
        // Older nodes lost as much when they were normalised: all logarithms count from one level.
        node.ln -= self.taken_ln;
        node.regular_ln -= self.taken_ln;
        Some(node)
    }

    /// Takes the next reading.
    pub fn push(&mut self, field: &MomentField, row: &MotionRow) {
        self.rows.push(self.with_creep(field, row));
        let mut nodes = std::mem::take(&mut self.nodes);
        if let [.., before, row] = &self.rows[..] {
            let reading = self.reading(field, before, row);
            nodes.iter_mut().for_each(|node| node.update(&reading));
        }
        // A posterior narrower than the grid lies between two nodes: halving finds it.
        for _ in 0..MAX_HALVINGS {
            let gaps = gaps(&nodes);
            let made: Vec<NodeFilter> = gaps
                .into_par_iter()
                .filter_map(|s_mm| self.node(field, s_mm))
                .collect();
            if made.is_empty() {
                break;
            }
            nodes.extend(made);
            nodes.sort_by(|a, b| a.s_mm.total_cmp(&b.s_mm));
        }
        self.nodes = nodes;
        self.normalise();
    }

    /// The reading with the two unknowns of a creeping contact, where it may creep.
    fn with_creep(&self, field: &MomentField, row: &MotionRow) -> MotionRow {
        let (mut row, creep_sd) = (row.clone(), self.settings.creep_sd);
        if creep_sd > 0.0 {
            let moved_mm = self.displacement_mm(field, &row);
            let (turn, _) = row.since(&self.reference);
            // An error of the place that grows with the way, of the map that is none.
            row.shared_displacement_mm
                .resize(row.shared_nmm.len(), Vector3::zeros());
            row.shared_displacement_mm
                .extend(creep_mm(&self.push, &turn, &moved_mm, creep_sd));
            row.shared_nmm.extend([[0.0; 2]; 2]);
        }
        row
    }

    /// Displacement of the middle of the free wire by a reading, mm.
    fn displacement_mm(&self, field: &MomentField, row: &MotionRow) -> Vector3<f64> {
        row.displacement_mm(&self.reference, &field.middle_mm())
    }

    /// Where the wire is held at a reading that was taken, in space and along the wire.
    pub fn place(&self, field: &MomentField, row: &MotionRow) -> EpisodeContact {
        let path = ContactPath {
            field,
            rows: std::slice::from_ref(row),
            reference: &self.reference,
            push: self.push,
        };
        EpisodeContact {
            outlier: self.best().is_some_and(|n| n.last_outlier > 0.5),
            ..self.posterior().place(&path, 0)
        }
    }

    /// The posterior over arc length, onset and gap.
    pub fn posterior(&self) -> Posterior {
        // The interpolated wire is off by as much at every reading: no number of them averages it
        // out.
        let table_mm2 = Matrix2::identity() * TABLE_MM.powi(2);
        let node = |n: &NodeFilter| {
            let (state, covariance_mm2) = n.state();
            let creep =
                (self.settings.creep_sd > 0.0).then(|| n.creep(self.reference.shared_nmm.len()));
            posterior::Node::new((state, covariance_mm2 + table_mm2), creep, n.ln)
        };
        Posterior::of_nodes(
            self.nodes.iter().map(node).collect(),
            self.settings.creep_sd,
        )
    }

    /// Innovations so far, at the node of highest density.
    pub fn innovations(&self) -> Innovations {
        let rows = self.lead.len() + self.rows.len();
        // Two moments a reading, three numbers fitted.
        let dof = (2.0 * rows as f64 - 3.0).max(1.0);
        self.best()
            .map_or(Innovations::unexplained(rows), |n| Innovations {
                plain: n.chi2[0],
                robust: n.chi2[1],
                dof,
                outlier: n.outlier.round() as usize,
                rows,
            })
    }

    /// ln p(y_1 .. y_n), natural units of 1/(N mm)^2 a reading: the integral over the wire, on
    /// which s is uniform.
    pub(crate) fn ln_evidence(&self, field: &MomentField) -> f64 {
        // Trapezoids over s, on which the prior is uniform.
        let width =
            |w: &[NodeFilter]| 0.5 * (w[0].ln.exp() + w[1].ln.exp()) * (w[1].s_mm - w[0].s_mm);
        // A single node spans no trapezoid: the smallest step stands for its width.
        let mass = self
            .nodes
            .windows(2)
            .map(width)
            .sum::<f64>()
            .max(MIN_STEP_MM);
        if self.nodes.is_empty() {
            f64::NEG_INFINITY
        } else {
            self.taken_ln + (mass / (field.length_mm() - self.settings.first_mm)).ln()
        }
    }

    fn best(&self) -> Option<&NodeFilter> {
        self.nodes.iter().max_by(|a, b| a.ln.total_cmp(&b.ln))
    }

    /// A reading after another one.
    fn reading<'a>(
        &'a self,
        field: &'a MomentField,
        before: &MotionRow,
        row: &'a MotionRow,
    ) -> Reading<'a> {
        let way = (self.push, &self.reference);
        Reading::new((field, &self.settings), way, before, row)
    }

    /// The best node's logarithm is zero; nodes without mass go, but for one on each side of those
    /// that have some.
    fn normalise(&mut self) {
        let best = best_ln(&self.nodes);
        self.nodes.retain(|n| n.ln.is_finite());
        self.nodes.iter_mut().for_each(|n| n.ln -= best);
        self.taken_ln += best;
        // A neighbour without mass stays: the next reading may move the mass there.
        let has: Vec<bool> = self.nodes.iter().map(|n| n.ln > -NO_MASS).collect();
        let near = |k: usize| {
            has[k.saturating_sub(1)..(k + 2).min(has.len())]
                .iter()
                .any(|h| *h)
        };
        let mut k = 0;
        self.nodes.retain(|_| {
            k += 1;
            near(k - 1)
        });
    }
}

/// Places of new nodes: half way between neighbours that differ by too much.
fn gaps(nodes: &[NodeFilter]) -> Vec<f64> {
    // Where every node takes the reading for an outlier, its place may lie between two of them.
    let missed = nodes
        .iter()
        .max_by(|a, b| a.ln.total_cmp(&b.ln))
        .is_some_and(|n| n.last_outlier > 0.5);
    let ln = |k: usize| {
        if missed {
            nodes[k].regular_ln
        } else {
            nodes[k].ln
        }
    };
    let best = (0..nodes.len()).map(ln).fold(f64::NEG_INFINITY, f64::max);
    let kept = |k: &usize| {
        let near = k.saturating_sub(1)..(k + 2).min(nodes.len());
        near.into_iter().any(|k| ln(k) > best - NO_MASS)
    };
    let split = |k: &usize| {
        ln(*k).max(ln(k + 1)) > best - REFINED_LN
            && (ln(*k) - ln(k + 1)).abs() > MAX_STEP_LN
            && nodes[k + 1].s_mm - nodes[*k].s_mm > MIN_STEP_MM
    };
    let room = MAX_NODES.saturating_sub((0..nodes.len()).filter(kept).count());
    let gaps = (0..nodes.len().saturating_sub(1)).filter(split).take(room);
    gaps.map(|k| 0.5 * (nodes[k].s_mm + nodes[k + 1].s_mm))
        .collect()
}

fn best_ln(nodes: &[NodeFilter]) -> f64 {
    nodes.iter().map(|n| n.ln).fold(f64::NEG_INFINITY, f64::max)
}
