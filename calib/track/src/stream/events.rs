//! Onset, release, slip, snap and jump from moments at the interrogator's rate.
//!
//! Two tests run on blocks of 2 ms, both with limits that follow from the noise of the no-contact prefix and a stated rate of false
//! alarms (`noise`): the level against the baseline (contact or none) and an abrupt change against the line through what came before.
//!
//! ```text
//! baseline    b += (m_old - b) / N while the wire is free (running mean over 1 s, 0.25 s late)
//! level       covariance S_level (1 + 10 / N) + (drift * age of the baseline)^2 I
//! onset       T^2_level > limit      release: T^2_level < limit_back for 0.3 s, and still
//! ```
//!
//! An abrupt change is named by what follows it: free and ringing in the wire's first mode: snap; free: release; contact and ringing: jump;
//! contact, no ring: slip. Times are those of `change_point`.

use super::change_point::Ring;
use super::event::{ContactEvent, EventSettings};
use super::noise::{
    BLOCK_S, BLOCKS_AFTER, BLOCKS_BEFORE, Block, LEVEL_BLOCKS, Noise, Thresholds, contrast, distance, quiet,
};
use nalgebra::{Matrix2, Vector2};
use std::collections::VecDeque;

mod classify;

/// Blocks to wait for after an onset by level: its time needs part of the ramp.
const ONSET_WAIT: usize = 20;
/// Blocks to wait for after an abrupt change: five periods at 34 Hz.
const RING_WAIT: usize = 75;
/// Blocks at the baseline, and still, that make a release.
const BACK_HOLD: usize = 150;
/// Blocks kept: the longest window for the beginning of a ramp.
const MAX_BLOCKS: usize = 600;
/// First window for it, blocks; doubled until the ramp's beginning lies inside.
const LOOK_BACK: usize = 150;
/// Age of the blocks that enter the baseline: the beginning of an undetected onset must not, blocks.
const BASELINE_DELAY: usize = 125;
/// Time constant of the baseline, s: a moment that grows more slowly than the level's limit in this time counts as drift.
const BASELINE_S: f64 = 1.0;
/// Time over which the drift is estimated, s.
const DRIFT_S: f64 = 60.0;

#[derive(Debug, Clone, Copy)]
struct Pending {
    abrupt: bool,
    statistic: f64,
    limit: f64,
    at_s: f64,
    left: usize,
    /// Level (N mm) before.
    before: Vector2<f64>,
}

/// Watches the moments of one whisker.
#[derive(Debug, Clone)]
pub struct EventDetector {
    settings: EventSettings,
    per_block: usize,
    sum: (usize, f64, Vector2<f64>),
    prefix: Vec<Block>,
    noise: Option<(Noise, Thresholds)>,
    whiten: Matrix2<f64>,
    kept: VecDeque<Block>,
    baseline: Vector2<f64>,
    /// Blocks that the baseline averages.
    baseline_blocks: f64,
    contact: bool,
    /// Baseline of the free wire now and then, s and N mm, and the drift that follows from it, N mm/s.
    anchors: VecDeque<(f64, Vector2<f64>)>,
    drift_nmm_s: f64,
    /// Since when the baseline does not follow, s.
    frozen_s: f64,
    back: usize,
    pending: Option<Pending>,
    ring: Option<Ring>,
    quiet_until_s: f64,
    gap_s: f64,
    lost_pending: u64,
}

impl EventDetector {
    /// A detector that still has to see its prefix.
    pub fn new(settings: EventSettings) -> Self {
        Self {
            per_block: ((BLOCK_S * settings.rate_hz).round() as usize).max(1),
            settings,
            sum: (0, 0.0, Vector2::zeros()),
            prefix: Vec::new(),
            noise: None,
            whiten: Matrix2::identity(),
            kept: VecDeque::with_capacity(MAX_BLOCKS + 1),
            baseline: Vector2::zeros(),
            baseline_blocks: 1.0,
            contact: false,
            anchors: VecDeque::new(),
            drift_nmm_s: 0.0,
            frozen_s: 0.0,
            back: 0,
            pending: None,
            ring: None,
            quiet_until_s: f64::NEG_INFINITY,
            gap_s: 0.0,
            lost_pending: 0,
        }
    }

    /// Noise and limits, once the prefix is over.
    pub fn noise(&self) -> Option<(Noise, Thresholds)> {
        self.noise
    }

    /// Whether the wire is in contact; `None` during the prefix.
    pub fn contact(&self) -> Option<bool> {
        self.noise.map(|_| self.contact)
    }

    /// Changes that a gap cut off before they could be named.
    pub fn cut_off(&self) -> u64 {
        self.lost_pending
    }

    /// The stream was interrupted for `gap_s`: windows are reset, the baseline stays.
    pub fn gap(&mut self, gap_s: f64) {
        self.sum = (0, 0.0, Vector2::zeros());
        self.kept.clear();
        self.lost_pending += u64::from(self.pending.take().is_some());
        (self.ring, self.back) = (None, 0);
        self.gap_s += gap_s;
        if self.noise.is_none() {
            // A prefix with a hole is no prefix.
            self.prefix.clear();
        }
    }

    /// Takes a sample: time (s) and moments (N mm).
    pub fn push(&mut self, t_s: f64, moment_nmm: [f64; 2]) -> Option<ContactEvent> {
        let (n, t, m) = self.sum;
        self.sum = (n + 1, t + t_s, m + Vector2::from(moment_nmm));
        if n + 1 < self.per_block {
            return None;
        }
        let (n, t, m) = std::mem::replace(&mut self.sum, (0, 0.0, Vector2::zeros()));
        self.block(Block { t_s: t / n as f64, moment: m / n as f64 })
    }

    fn block(&mut self, block: Block) -> Option<ContactEvent> {
        let Some((noise, limits)) = self.noise else {
            self.learn(block);
            return None;
        };
        self.kept.push_back(block);
        if self.kept.len() > MAX_BLOCKS {
            self.kept.pop_front();
        }
        let envelope = self.ring.map_or(0.0, |r| r.envelope(block.t_s));
        if envelope < noise.block.trace().sqrt() / 10.0 {
            self.ring = None;
        }
        self.follow();
        if let Some(pending) = &mut self.pending {
            pending.left = pending.left.saturating_sub(1);
            if pending.left == 0 {
                let pending = *pending;
                self.pending = None;
                return if pending.abrupt {
                    self.classify(&pending, &noise, &limits)
                } else {
                    self.onset(&pending, &noise)
                };
            }
        }
        if !self.pending.is_some_and(|p| p.abrupt) {
            self.watch_abrupt(&noise, &limits, envelope);
        }
        self.watch_level(&noise, &limits, envelope)
    }

    fn learn(&mut self, block: Block) {
        let since = self.prefix.first().map_or(block.t_s, |b| b.t_s);
        self.prefix.push(block);
        if block.t_s - since < self.settings.prefix_s {
            return;
        }
        if !quiet(&self.prefix) {
            // Something happened in it: the prefix begins later.
            self.prefix.drain(..self.prefix.len() / 4);
            return;
        }
        if let Some(noise) = Noise::of(&self.prefix) {
            self.noise = Some((noise, noise.thresholds(self.settings.false_alarms_per_hour)));
            self.whiten = noise.block.cholesky().and_then(|c| c.l().try_inverse()).unwrap_or_default();
            self.baseline = noise.baseline;
            self.drift_nmm_s = noise.drift_nmm_s;
            self.baseline_blocks = (self.prefix.len() as f64).min(BASELINE_S / BLOCK_S);
            self.frozen_s = block.t_s - BASELINE_S;
            self.prefix = Vec::new();
        }
    }

    /// The baseline follows the free wire slowly, and late.
    fn follow(&mut self) {
        if self.contact || self.pending.is_some() || self.ring.is_some() || self.kept.len() <= BASELINE_DELAY
        {
            return;
        }
        let old = self.kept[self.kept.len() - 1 - BASELINE_DELAY];
        if old.t_s <= self.quiet_until_s {
            return;
        }
        let max_blocks = BASELINE_S / BLOCK_S;
        self.baseline_blocks = (self.baseline_blocks + 1.0).min(max_blocks);
        self.baseline += (old.moment - self.baseline) / self.baseline_blocks;
        // Age of the running mean: its newest block's plus its length.
        self.frozen_s = old.t_s - BASELINE_S;
        self.learn_drift();
    }

    /// The longer the wire is free, the better the drift is known.
    fn learn_drift(&mut self) {
        if self.anchors.back().is_some_and(|a| self.frozen_s - a.0 < BASELINE_S) {
            return;
        }
        self.anchors.push_back((self.frozen_s, self.baseline));
        let (first, span_s) = (self.anchors[0].1, self.frozen_s - self.anchors[0].0);
        if let Some((noise, _)) = &self.noise
            && span_s > self.settings.prefix_s
        {
            let mean_var = noise.level.trace() * LEVEL_BLOCKS as f64 * BLOCK_S / BASELINE_S;
            self.drift_nmm_s = ((self.baseline - first).norm() + 2.0 * (2.0 * mean_var).sqrt()) / span_s;
        }
        if span_s > DRIFT_S {
            self.anchors.pop_front();
        }
    }

    fn newest(&self, count: usize) -> Vec<Block> {
        self.kept.range(self.kept.len().saturating_sub(count)..).copied().collect()
    }

    fn mean(&self, count: usize) -> Option<Vector2<f64>> {
        let from = self.kept.len().checked_sub(count)?;
        Some(self.kept.range(from..).map(|b| b.moment).sum::<Vector2<f64>>() / count as f64)
    }

    /// Covariance of a level window about the baseline: the window's, the baseline's own, and what it may have drifted since.
    fn level_covariance(&self, noise: &Noise, t_s: f64) -> Matrix2<f64> {
        let drifted = self.drift_nmm_s * (t_s - self.frozen_s).max(0.0);
        noise.level * (1.0 + LEVEL_BLOCKS as f64 / self.baseline_blocks)
            + Matrix2::identity() * drifted * drifted
    }

    fn watch_abrupt(&mut self, noise: &Noise, limits: &Thresholds, envelope: f64) {
        let span = BLOCKS_BEFORE + BLOCKS_AFTER;
        let Some(from) = self.kept.len().checked_sub(span) else { return };
        let blocks: [Block; BLOCKS_BEFORE + BLOCKS_AFTER] = std::array::from_fn(|k| self.kept[from + k]);
        let mut v = contrast(&blocks);
        // The rest of a ring can cause a contrast of up to twice its envelope, which is subtracted.
        v *= (1.0 - 2.0 * envelope / v.norm().max(1e-12)).max(0.0);
        let statistic = distance(&v, &noise.abrupt);
        let now = blocks[span - 1].t_s;
        if statistic > limits.abrupt && now > self.quiet_until_s {
            let before =
                blocks[BLOCKS_BEFORE - 10..BLOCKS_BEFORE].iter().map(|b| b.moment).sum::<Vector2<f64>>()
                    / 10.0;
            self.pending = Some(Pending {
                abrupt: true,
                statistic,
                limit: limits.abrupt,
                at_s: now,
                left: RING_WAIT,
                before,
            });
        }
    }

    fn watch_level(&mut self, noise: &Noise, limits: &Thresholds, envelope: f64) -> Option<ContactEvent> {
        let now = self.kept.back()?.t_s;
        // A mean over a window of a ring deviates by at most its envelope.
        let mut v = self.mean(LEVEL_BLOCKS)? - self.baseline;
        v *= (1.0 - envelope / v.norm().max(1e-12)).max(0.0);
        let covariance = self.level_covariance(noise, now);
        let statistic = distance(&v, &covariance);
        if !self.contact {
            if statistic > limits.level && self.pending.is_none() {
                self.pending = Some(Pending {
                    abrupt: false,
                    statistic,
                    limit: limits.level,
                    at_s: now,
                    left: ONSET_WAIT,
                    before: self.baseline,
                });
            }
            return None;
        }
        self.back = if statistic < limits.back { self.back + 1 } else { 0 };
        if self.back < BACK_HOLD || self.pending.is_some() || !self.still(noise, limits) {
            return None;
        }
        self.release(noise, statistic, limits.back, now)
    }

    /// Whether the moment is constant: a slow ramp only passes through the neighbourhood of the baseline.
    fn still(&self, noise: &Noise, limits: &Thresholds) -> bool {
        let half = BACK_HOLD / 2;
        let blocks = self.newest(BACK_HOLD);
        if blocks.len() < BACK_HOLD {
            return false;
        }
        let mean = |b: &[Block]| b.iter().map(|b| b.moment).sum::<Vector2<f64>>() / b.len() as f64;
        let change = mean(&blocks[half..]) - mean(&blocks[..half]);
        // Variance of a mean of windows, not of blocks, so that correlated noise counts as such.
        distance(&change, &(noise.level * (2.0 * LEVEL_BLOCKS as f64 / half as f64))) < limits.back
    }
}

#[cfg(test)]
#[path = "events_test.rs"]
mod tests;
