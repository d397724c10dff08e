//! A contact that slides over a rigid object whose motion is known in three dimensions; any
//! direction, turns, holds and reversals.
//!
//! The object stands still in its own frame, so the contacts of all readings lie on one surface:
//! from reading to reading the point goes on within the tangent plane. With the wire's statics for
//! every reading (`contact_state`: place along the wire, force, its azimuth, friction along and
//! across) all states theta are found at once from first touch to release (`factors`, `smooth`):
//!
//! ```text
//! J(theta, c | h) = sum of squares of: moments, surface, friction, slip rate, first touch, slipping off          (factors)
//! p(theta | m)    = sum_h P(h | m) N(theta_h, H_h^-1),   P(h | m) ~ exp(-d J_h)                                   h: first path, friction
//! ```
//!
//! H is the curvature of J with the common errors c integrated out (`banded`); d < 1/2 for errors
//! of the model that readings share. Hypotheses h: the best paths that begin on the wire, at its
//! tip from the side and from ahead (`first_path`), each at several friction coefficients. A step
//! says about the same at any rate: readings count as means over 0.7 mm of the motion (`blocks`).
//!
//! A sweep one way says little of the friction: J changes by a few over 0 to 0.3, while the places
//! change by a few mm for one of the coefficient. So the hypotheses' spread is most of the stated
//! uncertainty. It can be stated (`friction`). Where the motion turns back J tells it: there the
//! hypotheses grow denser around the best (`smooth`).
//!
//! Where the contact slips to another place of the object at once, the moments leap (`slips`). The
//! path ends there; the next one begins anywhere.
//!
//! The motion has to be this object's: its readings have more evidence than with the motion's sign
//! reversed, both at the least friction, and J is not more than a few for each of n blocks. J alone
//! does not tell: a surface bends to the reversed motion, too, by more of its prior.
//!
//! ```text
//! E = ln p(m | motion) > E_reversed = ln p(m | -motion),     J <= 3 n        (Laplace, smooth)
//! ```
//!
//! An answer is sure where the motion goes one way and its evidence is clearly more, J <= 1.5 n,
//! the surface has no gap, and more than one start leads to the least J. Else the contact may be
//! lost: in simulated tracks a quarter of such readings lay outside, so that with this probability
//! l nothing is known, `(1 - l) p + l uniform`.
//!
//! What this cannot tell: a surface of which nothing is known takes up most errors of gain, and a
//! clock that is wrong in a steady motion; only an object that is known shows them.
//!
//! Answers are places of the wire's axis: the point of the object and the wire's radius along its
//! normal.

mod banded;
mod blocks;
mod contact_state;
mod factors;
mod first_path;
mod friction;
mod slips;
mod smooth;
mod stream;

pub use contact_state::TouchedWire;
pub use friction::FrictionPrior;
pub(crate) use stream::SlidingStream;

use crate::arc_posterior::{ArcDensity, mixed_place};
use crate::known_motion::contact_path::loaded;
use crate::known_motion::{EpisodeContact, LN_ANYTHING, MotionRow};
use blocks::blocks;
pub use blocks::{Blocks, Means};
pub(crate) use factors::model_nmm2;
use factors::{Chain, Ends};
use first_path::{Candidate, candidates, first_paths};
use nalgebra::{Matrix3, Vector2};
use rayon::prelude::*;
use slips::{LEAPS, parts};
use smooth::{
    BlockPosterior, HALVINGS, SAME_COST, Smoothed, ln_evidence, mm_by_gain, posterior, refined,
};
use std::ops::Range;

/// Weight of a hypothesis by its sum of squares: 1/2 for independent residuals.
const DISCOUNT: f64 = 0.4;
/// Standard deviations added for what the model leaves out: along the wire, and in space, mm.
const MODEL_SD_MM: f64 = 0.05;
/// Largest sum of squares for each block.
const MAX_COST: f64 = 3.0;
/// The same from which on an answer is not sure: simulated sweeps that are followed have 0.3 to
/// 0.9, lost ones 2 and more.
const SURE_COST: f64 = 1.5;
/// Largest sum of squares of the surface of an answer that is sure: those that are followed have
/// less than 2, lost ones 10 and more.
const MAX_GAPS: f64 = 6.0;
/// Evidence by which the motion has to be more probable than the reversed one, natural logarithm:
/// twenty times.
const CLEARLY: f64 = 3.0;
/// Probability that a contact is lost where the answer is not sure (`tests/sliding.rs`).
const LOST: f64 = 0.3;
/// Fewer blocks support nothing.
const MIN_BLOCKS: usize = 8;
/// Fewer blocks have no change of slip.
pub(crate) const MIN_MEANS: usize = 3;
/// Fewer blocks of a contact are no evidence of a slide: without two changes of slip its course is
/// that of the priors.
const MIN_WEIGHED: usize = 4;
/// A load that would last for more than so many readings as it falls is lost at once.
const LOST_AT_ONCE: f64 = 3.0;
/// A motion that comes back by more than this has turned, mm: above the noise of an arm's log.
const TURNED_MM: f64 = 0.5;

/// Where a sliding contact is at each reading.
#[derive(Debug, Clone)]
pub struct SlidingContact {
    /// Places, one a reading.
    pub places: Vec<EpisodeContact>,
    /// Means of the readings over a step of the motion, by which contacts are weighed.
    pub means: Means,
    /// ln p(m) of them along the motion and along the reversed one, natural units of 1/(N mm)^2 a
    /// block; none where no path could be made.
    pub ln_evidence: Option<[f64; 2]>,
    /// ln p(m) at the least friction: along the motion.
    pub evidence: f64,
    /// The same along the motion with its sign reversed.
    pub reversed_evidence: f64,
    /// Sum of squares of the best hypothesis.
    pub cost: f64,
    /// Blocks of readings that the motion was held against.
    pub predicted: usize,
    /// Whether the motion comes back on itself while the wire is loaded: along the wire regions are
    /// too narrow then, where the object has edges.
    pub turns_back: bool,
    /// Whether more than one start leads to each part's least sum of squares.
    pub agreed: bool,
    /// Sum of squares by which the contacts are not on one surface; of the part between slips where
    /// it is largest.
    pub gaps: f64,
    /// First readings after slips of the contact to another place at once.
    pub slips: Vec<usize>,
    /// Whether all parts between slips are explained.
    pub whole: bool,
    /// How far moments that are larger by 1 % move it, mm; of the part where it is most.
    pub mm_by_gain: f64,
}

impl SlidingContact {
    /// Whether the motion is the object's, and a surface explains the readings.
    pub fn supported(&self) -> bool {
        self.predicted >= MIN_BLOCKS
            && self.evidence > self.reversed_evidence
            && self.cost <= MAX_COST * self.predicted as f64
    }

    /// Whether the stated regions are those of the fit alone: it leaves no more than noise, starts
    /// agree, and nothing speaks against the motion.
    pub fn sure(&self) -> bool {
        self.supported()
            && self.whole
            && self.agreed
            && !self.turns_back
            && self.evidence > self.reversed_evidence + CLEARLY
            && self.cost <= SURE_COST * self.predicted as f64
            && self.gaps <= MAX_GAPS
    }

    /// One that is nowhere.
    pub(crate) fn nothing(readings: usize) -> Self {
        Self {
            places: vec![EpisodeContact::default(); readings],
            means: Means::default(),
            ln_evidence: None,
            evidence: f64::NEG_INFINITY,
            reversed_evidence: f64::NEG_INFINITY,
            cost: f64::INFINITY,
            predicted: 0,
            turns_back: false,
            agreed: false,
            gaps: f64::INFINITY,
            slips: Vec::new(),
            whole: false,
            mm_by_gain: 0.0,
        }
    }
}

/// Whether a motion comes back toward where it was, along its main direction.
fn turns_back(rows: &[MotionRow]) -> bool {
    let from = rows[0].moved_mm;
    let Some(far) = rows.iter().max_by(|a, b| {
        (a.moved_mm - from)
            .norm()
            .total_cmp(&(b.moved_mm - from).norm())
    }) else {
        return false;
    };
    let Some(along) = (far.moved_mm - from).try_normalize(1e-9) else {
        return false;
    };
    let mut reached = f64::NEG_INFINITY;
    rows.iter().any(|r| {
        // The way along the main direction falls behind the farthest so far.
        let way = (r.moved_mm - from).dot(&along);
        reached = reached.max(way);
        way < reached - TURNED_MM
    })
}

/// A hypothesis: a smoothed path under a coefficient of friction, its ln p(m), what of its sum of
/// squares is of the surface, and its posterior.
struct Hypothesis {
    friction: f64,
    /// Of its friction before the record.
    weight: f64,
    found: Smoothed,
    ln_evidence: f64,
    gaps: f64,
    blocks: Vec<BlockPosterior>,
}

impl Hypothesis {
    /// With the posterior at some blocks; none where the sum has no curvature.
    fn new(
        chain: &Chain<'_>,
        (friction, weight, found): (f64, f64, Smoothed),
        blocks: Range<usize>,
    ) -> Option<Self> {
        let chain = chain.under(friction);
        let blocks = posterior(&chain, &found, blocks)?;
        let ln_evidence = ln_evidence(&chain, &found)?;
        Some(Self {
            friction,
            weight,
            ln_evidence,
            gaps: chain.gaps(&found.x, &found.common),
            blocks,
            found,
        })
    }

    fn cost(&self) -> f64 {
        self.found.cost
    }
}

/// Tracks a contact over the readings of one episode. Leaps of the moments are slips where that
/// makes the answer sure: each part has a start of its own, which only moments that are right can
/// find; else one surface from first touch to release tells more.
pub fn locate_sliding(wire: &TouchedWire, rows: &[MotionRow]) -> SlidingContact {
    let Some([first, last]) = touching(rows) else {
        return SlidingContact::nothing(rows.len());
    };
    let held = &rows[first..=last];
    // Often two sizes of leap part the readings alike, or not at all.
    let mut known: Vec<(Vec<Range<usize>>, SlidingContact)> = Vec::new();
    let mut located = |leap: f64| {
        let ranges = parts(held, leap);
        if let Some(same) = known.iter().find(|k| k.0 == ranges) {
            return same.1.clone();
        }
        let found = locate_parts(wire, rows, [first, last], &ranges);
        known.push((ranges, found.clone()));
        found
    };
    let sure = LEAPS
        .into_iter()
        .map(&mut located)
        .find(SlidingContact::sure);
    let supported = || {
        [f64::INFINITY]
            .into_iter()
            .chain(LEAPS)
            .map(&mut located)
            .find(SlidingContact::supported)
    };
    sure.or_else(supported)
        .unwrap_or_else(|| located(f64::INFINITY))
}

/// With a path for each of these ranges of the loaded readings `first ..= last`.
fn locate_parts(
    wire: &TouchedWire,
    rows: &[MotionRow],
    [first, last]: [usize; 2],
    ranges: &[Range<usize>],
) -> SlidingContact {
    let mut all = SlidingContact::nothing(rows.len());
    let held = &rows[first..=last];
    // A record that ends under load does not show how it ends.
    let lost_at_end = last + 1 < rows.len() && lost_at_once(held);
    let ends = |r: &Range<usize>| Ends {
        from_free: r.start == 0,
        slips_off: lost_at_end && r.end == held.len(),
    };
    let found: Vec<Option<Part>> = ranges
        .par_iter()
        .map(|r| Part::find(wire, &held[r.clone()], ends(r)))
        .collect();
    ranges
        .iter()
        .for_each(|r| all.means.extend(blocks(&held[r.clone()]).0));
    let each = || found.iter().flatten();
    if each().count() == 0 {
        return all;
    }
    all.evidence = each().map(|p| p.by_motion[0]).sum();
    all.reversed_evidence = each().map(|p| p.by_motion[1]).sum();
    all.cost = each().map(Part::cost).sum();
    all.turns_back = turns_back(held);
    all.agreed = each().all(Part::agreed);
    all.predicted = each().map(|p| p.count).sum();
    // Parts that no path explains are anything, along either motion.
    let anything = (all.means.len() - all.predicted) as f64 * LN_ANYTHING;
    let ln_evidence = [0, 1].map(|k| anything + each().map(|p| p.ln_evidence[k]).sum::<f64>());
    all.ln_evidence = Some(ln_evidence).filter(|_| all.means.len() >= MIN_WEIGHED);
    all.gaps = each().map(|p| p.best().gaps).fold(0.0, f64::max);
    all.mm_by_gain = each().map(|p| p.mm_by_gain).fold(0.0, f64::max);
    all.slips = ranges[1..].iter().map(|r| first + r.start).collect();
    all.whole = found.iter().all(Option::is_some);
    let lost = if all.sure() { 0.0 } else { LOST };
    for (range, part) in ranges.iter().zip(&found) {
        let Some(part) = part else { continue };
        for (k, at) in range.clone().zip(&part.at) {
            all.places[first + k] = place(wire, &part.hypotheses, *at, (&held[k], lost));
        }
    }
    all
}

/// Readings of a contact without a slip between them, with their hypotheses.
struct Part {
    hypotheses: Vec<Hypothesis>,
    /// ln p(m) along the motion and along the reversed one: of the best, and at the least friction.
    ln_evidence: [f64; 2],
    by_motion: [f64; 2],
    /// Blocks, and where each reading lies among them.
    count: usize,
    at: Vec<(usize, f64)>,
    /// Of the best of the hypotheses, see [`SlidingContact`].
    mm_by_gain: f64,
}

impl Part {
    /// None where nothing explains the readings.
    fn find(wire: &TouchedWire, rows: &[MotionRow], ends: Ends) -> Option<Self> {
        let (means, at) = blocks(rows);
        let means = means.rows;
        if means.len() < MIN_MEANS {
            return None;
        }
        let contacts = candidates(wire, &means);
        let frictions = wire.friction.coefficients();
        let chain = Chain::new(wire, &means, ends);
        let all = 0..means.len();
        // The control: a surface bends to any motion, so the reversed one says by how much.
        let backward = reversed(&means);
        let (hypotheses, control) = rayon::join(
            || hypotheses(&chain, &contacts, (&frictions, HALVINGS), all.clone()),
            || {
                let chain = Chain::new(wire, &backward, ends);
                hypotheses(&chain, &contacts, (&frictions[..1], HALVINGS), all.clone())
            },
        );
        let most = |all: &[Hypothesis], which: &dyn Fn(&&Hypothesis) -> bool| {
            let those = all.iter().filter(which).map(|h| h.ln_evidence);
            those.fold(f64::NEG_INFINITY, f64::max)
        };
        // The law of friction is a separate prior at each coefficient: their evidence compares at
        // one alone.
        let frictions = hypotheses.iter().map(|h| h.friction);
        let least = frictions.fold(f64::INFINITY, f64::min);
        let by_motion = [&hypotheses, &control].map(|all| most(all, &|h| h.friction <= least));
        let hypotheses = of_one_surface(hypotheses, means.len());
        // A surface that leaves more than this explains nothing, whatever its evidence beside worse
        // ones.
        let explains = |h: &&Hypothesis| h.cost() <= MAX_COST * means.len() as f64;
        let ln_evidence = [&hypotheses, &control].map(|all| most(all, &explains));
        let count = means.len();
        let mut own = Self {
            hypotheses,
            ln_evidence,
            by_motion,
            count,
            at,
            mm_by_gain: 0.0,
        };
        let best = (!own.hypotheses.is_empty()).then(|| own.best())?;
        own.mm_by_gain =
            mm_by_gain(&chain.under(best.friction), &best.found).unwrap_or(f64::INFINITY);
        Some(own)
    }

    fn best(&self) -> &Hypothesis {
        let first = &self.hypotheses[0];
        self.hypotheses
            .iter()
            .fold(first, |a, b| if b.cost() < a.cost() { b } else { a })
    }

    fn cost(&self) -> f64 {
        self.best().cost()
    }

    /// Whether more than one start leads to the best.
    fn agreed(&self) -> bool {
        let best = self.best();
        let same = |h: &&Hypothesis| {
            h.friction == best.friction && (h.cost() - best.cost()).abs() <= SAME_COST
        };
        self.hypotheses
            .iter()
            .filter(same)
            .map(|h| h.found.starts)
            .sum::<usize>()
            > 1
    }
}

/// Without those that go on to another surface, where one without a gap explains the readings:
/// heavy tails make a gap cheap, and a wrong friction buys one where the motion turns back.
fn of_one_surface(mut all: Vec<Hypothesis>, blocks: usize) -> Vec<Hypothesis> {
    let whole = |h: &Hypothesis| h.gaps <= MAX_GAPS;
    if all
        .iter()
        .any(|h| whole(h) && h.cost() <= SURE_COST * blocks as f64)
    {
        all.retain(whole);
    }
    all
}

/// First and last of the readings that are loaded, each with a neighbour that is, too.
fn touching(rows: &[MotionRow]) -> Option<[usize; 2]> {
    // One loaded reading alone may be an outlier.
    let first = (1..rows.len()).find(|k| loaded(&rows[*k]) && loaded(&rows[k - 1]))? - 1;
    let last = (1..rows.len())
        .rev()
        .find(|k| loaded(&rows[*k]) && loaded(&rows[k - 1]))?;
    Some([first, last])
}

/// Whether the load at the last reading is more than its fall would have left in a few readings:
/// then the wire slipped off at its tip.
fn lost_at_once(rows: &[MotionRow]) -> bool {
    let size = |k: usize| Vector2::from(rows[k].moment_nmm).norm();
    let last = rows.len() - 1;
    let noise = rows[last].noise_nmm2.trace().sqrt();
    // A load that falls evenly is gone after size / fall readings.
    last > 0 && size(last) > LOST_AT_ONCE * ((size(last) - size(last - 1)).abs() + noise)
}

/// Readings whose motion has the other sign.
pub(crate) fn reversed(rows: &[MotionRow]) -> Vec<MotionRow> {
    let mut rows = rows.to_vec();
    for row in &mut rows {
        (row.moved_mm, row.turn) = (-row.moved_mm, row.turn.inverse());
        row.velocity_mm_s = -row.velocity_mm_s;
    }
    rows
}

/// All paths under all friction coefficients, between which `halvings` more are looked for, with
/// their posteriors at some blocks; those that explain the readings and have a curvature.
fn hypotheses(
    chain: &Chain<'_>,
    contacts: &[Vec<Candidate>],
    (frictions, halvings): (&[f64], usize),
    blocks: Range<usize>,
) -> Vec<Hypothesis> {
    let one = |path: Vec<_>| {
        let found = refined(&mut chain.clone(), path, frictions, halvings);
        let frictions: Vec<f64> = found.iter().map(|f| f.0).collect();
        let weights = chain.wire.friction.weights(&frictions);
        let each = found.into_iter().zip(weights);
        let each = each.map(|((mu, found), weight)| (mu, weight, found));
        each.filter_map(|each| Hypothesis::new(chain, each, blocks.clone()))
            .collect::<Vec<_>>()
    };
    first_paths(chain, contacts)
        .into_par_iter()
        .flat_map_iter(one)
        .collect()
}

/// A share of the way from a block to the next.
fn between(blocks: &[BlockPosterior], k: usize, share: f64) -> BlockPosterior {
    let (a, b) = (&blocks[k], &blocks[(k + 1).min(blocks.len() - 1)]);
    // Places go on past the blocks' middles at the ends; spreads do not.
    let inner = share.clamp(0.0, 1.0);
    BlockPosterior {
        axis_mm: a.axis_mm.lerp(&b.axis_mm, share),
        covariance_mm2: a.covariance_mm2 * (1.0 - inner) + b.covariance_mm2 * inner,
        arclength_mm: a.arclength_mm + (b.arclength_mm - a.arclength_mm) * share,
        sd_mm: a.sd_mm + (b.sd_mm - a.sd_mm) * inner,
    }
}

/// What the hypotheses state together of a reading that lies a share of the way from a block to the
/// next, base frame; the contact may be `lost` with this probability, and is anywhere on the wire
/// then.
fn place(
    wire: &TouchedWire,
    all: &[Hypothesis],
    (block, share): (usize, f64),
    (row, lost): (&MotionRow, f64),
) -> EpisodeContact {
    let best = all
        .iter()
        .map(Hypothesis::cost)
        .fold(f64::INFINITY, f64::min);
    let at = |h: &Hypothesis| {
        // Weight of a hypothesis: its prior times the likelihood to a power below 1/2.
        let weight = h.weight * (-DISCOUNT * (h.cost() - best)).exp();
        (weight, between(&h.blocks, block, share))
    };
    let (each, length_mm): (Vec<_>, f64) = (all.iter().map(at).collect(), wire.length_mm);
    let Some((mean, covariance)) =
        mixed_place(each.iter().map(|(w, b)| (*w, b.axis_mm, b.covariance_mm2)))
    else {
        return EpisodeContact::default();
    };
    // Independent of the hypotheses: what the model leaves out, and a uniform share of the wire
    // (variance L^2 / 12).
    let lost_mm2 = lost * length_mm.powi(2) / 12.0;
    let covariance = covariance + Matrix3::identity() * (MODEL_SD_MM * MODEL_SD_MM + lost_mm2);
    let normal = |(w, b): &(f64, BlockPosterior)| (*w, b.arclength_mm, b.sd_mm.hypot(MODEL_SD_MM));
    let own = ArcDensity::of_normals(&each.iter().map(normal).collect::<Vec<_>>(), length_mm);
    // The hypotheses are places on the object; the base sees them at Q p + d.
    let turn = row.turn.matrix();
    EpisodeContact {
        place_mm: Some(row.turn * mean + row.moved_mm),
        covariance_mm2: turn * covariance * turn.transpose(),
        contact: 1.0,
        outlier: false,
        arc: match lost > 0.0 {
            true => {
                ArcDensity::mixture([(1.0 - lost, &own), (lost, &ArcDensity::uniform(length_mm))])
            }
            false => own,
        },
    }
}
