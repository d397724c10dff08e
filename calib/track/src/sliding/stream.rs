//! A sliding contact reading by reading: the smoother's paths, each drawn on by a block of readings
//! at a time.
//!
//! ```text
//! each block        the states of all blocks so far, from the last ones on (a few steps: only the newest is new)
//! 4, 8, 16, ...     blocks: all paths and coefficients of friction anew; what was unlikely early may be the likeliest now
//! dropped           weights below 1e-3 of the best, and all but eight
//! ```
//!
//! A reading within a block that is not complete goes on from the last two. What comes later mends
//! a contact's beginning; a filter cannot.

use super::blocks::Means;
use super::first_path::candidates;
use super::smooth::{Smoothed, descend};
use super::{Chain, Ends, Hypothesis, TouchedWire};
use super::{DISCOUNT, LOST, MIN_WEIGHED, hypotheses, of_one_surface, place};
use crate::known_motion::{EpisodeContact, MotionRow};
use rayon::prelude::*;

/// Weight of a path, and number of them, that are followed.
const MIN_WEIGHT: f64 = 1e-3;
const MAX_PATHS: usize = 8;
/// Blocks of a contact, and steps that a reading lies past the last but one of its blocks, at most.
const MAX_BLOCKS: usize = 200;
const MAX_SHARE: f64 = 2.7;
/// Nothing slips off while it is followed.
const GOING_ON: Ends = Ends {
    from_free: true,
    slips_off: false,
};

/// Follows a contact from its first loaded reading on.
pub(crate) struct SlidingStream {
    wire: TouchedWire,
    /// Blocks that the paths go through.
    solved: usize,
    /// Blocks at which all paths are looked for anew, at each doubling.
    search_at: usize,
    paths: Vec<Hypothesis>,
}

impl SlidingStream {
    /// Before any reading.
    pub(crate) fn new(wire: TouchedWire) -> Self {
        Self {
            wire,
            solved: 0,
            search_at: MIN_WEIGHED,
            paths: Vec::new(),
        }
    }

    /// Takes a loaded reading that is the last one in the blocks of its contact; its place, where
    /// some path explains the readings so far.
    pub(crate) fn push(&mut self, row: &MotionRow, means: &Means) -> Option<EpisodeContact> {
        if means.len() > MAX_BLOCKS {
            return None;
        }
        if means.len() > self.solved && means.len() >= MIN_WEIGHED {
            self.follow(means);
        }
        let [.., a, b] = &means.rows[..self.solved] else {
            return None;
        };
        // As far as the object has gone on since.
        let step = b.moved_mm - a.moved_mm;
        // Projection on the last step of the motion.
        let share = (row.moved_mm - a.moved_mm).dot(&step) / step.norm_squared().max(1e-12);
        let at = (0, share.clamp(0.0, MAX_SHARE));
        // Nothing is sure before the end is seen.
        (!self.paths.is_empty()).then(|| place(&self.wire, &self.paths, at, (row, LOST)))
    }

    /// ln p(m) of so many blocks; none where no path could be made through them.
    pub(crate) fn ln_evidence(&self, blocks: usize) -> Option<f64> {
        let own = self.paths.iter().filter(|_| self.solved == blocks);
        own.map(|p| p.ln_evidence).reduce(f64::max)
    }

    /// Draws the paths on to the newest block.
    fn follow(&mut self, means: &Means) {
        let blocks = means.len();
        let searched = blocks >= self.search_at;
        let chain = Chain::new(&self.wire, &means.rows, GOING_ON);
        // The next readings lie beside the last two blocks, whose posterior is enough.
        let last = blocks - 2..blocks;
        let mut paths: Vec<Hypothesis> = if searched || self.paths.is_empty() {
            let contacts = candidates(&self.wire, &means.rows);
            let frictions = self.wire.friction.coefficients();
            hypotheses(&chain, &contacts, (&frictions, 0), last)
        } else {
            let on = |p: &Hypothesis| {
                let found = drawn_on(&chain, p, self.solved);
                Hypothesis::new(&chain, (p.friction, p.weight, found), last.clone())
            };
            self.paths.par_iter().filter_map(on).collect()
        };
        paths.sort_by(|a, b| a.cost().total_cmp(&b.cost()));
        let best = paths.first().map_or(f64::INFINITY, Hypothesis::cost);
        paths.retain(|p| (-DISCOUNT * (p.cost() - best)).exp() >= MIN_WEIGHT);
        paths.truncate(MAX_PATHS);
        self.paths = of_one_surface(paths, blocks);
        self.solved = blocks;
        while self.search_at <= self.solved {
            self.search_at *= 2;
        }
    }
}

/// A path through the blocks that are new, too.
fn drawn_on(chain: &Chain<'_>, path: &Hypothesis, solved: usize) -> Smoothed {
    let mut x = path.found.x.clone();
    for row in &chain.rows[solved..] {
        let last = x[x.len() - 1];
        // The newest contact goes on along the wire as the last ones did.
        let slid = x.len().checked_sub(2).map_or(0.0, |k| last[0] - x[k][0]);
        let moment = nalgebra::Vector2::from(row.moment_nmm);
        let next = chain
            .wire
            .frictionless(last[0] + slid, &moment, Some(last))
            .unwrap_or(last);
        x.push(next);
    }
    let from = Smoothed {
        x,
        common: path.found.common.clone(),
        cost: f64::INFINITY,
        starts: 1,
    };
    descend(&mut chain.clone(), from, path.friction, true, true)
}
