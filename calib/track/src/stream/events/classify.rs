//! Kind and time of an event, from the blocks around a test's detection.

use super::super::change_point::{EventTime, Ring, hinge, level, ramp_part, ring, step};
use super::super::event::{ContactEvent, EventKind};
use super::super::noise::{
    BLOCKS_AFTER, BLOCKS_BEFORE, Block, LEVEL_BLOCKS, Noise, Thresholds, chi2_4, distance,
};
use super::{BACK_HOLD, EventDetector, LOOK_BACK, MAX_BLOCKS, Pending, RING_WAIT};
use nalgebra::Vector2;

/// Blocks between an abrupt change and the fit of its ring: the change itself is over.
const RING_SKIP: usize = 2;
/// Probability, for each change, that noise is called a ring.
const RING_CHANCE: f64 = 1e-4;
/// A slip's own vibration, of the wire held at both ends, is up to this many times the first mode (clamped and pinned: 4.4).
const MAX_MODE_RATIO: f64 = 6.0;

impl EventDetector {
    /// The wire is back at the baseline: time of the ramp's end.
    pub(super) fn release(
        &mut self,
        noise: &Noise,
        statistic: f64,
        limit: f64,
        now: f64,
    ) -> Option<ContactEvent> {
        let after = self.mean(BACK_HOLD / 2)?;
        let far = |count: usize| {
            let b = self.newest(count);
            let head = b.len().min(LEVEL_BLOCKS);
            b[..head].iter().map(|b| b.moment).sum::<Vector2<f64>>() / head.max(1) as f64 - after
        };
        let when = self.in_the_gap(noise, false).or_else(|| self.ramp(noise, false, far));
        let before = self.kept.iter().rev().nth(BACK_HOLD + LOOK_BACK).or(self.kept.front())?.moment;
        self.free(after, now);
        Some(self.event(EventKind::Release, when?, now, [before, after], (statistic, limit), None))
    }

    fn free(&mut self, level: Vector2<f64>, now: f64) {
        (self.contact, self.back) = (false, 0);
        (self.baseline, self.baseline_blocks) = (level, (BACK_HOLD / 2) as f64);
        (self.quiet_until_s, self.frozen_s) = (now, now);
        // A contact may shift the wire in its clamp: the drift is estimated from here on only.
        self.anchors.clear();
    }

    pub(super) fn onset(&mut self, pending: &Pending, noise: &Noise) -> Option<ContactEvent> {
        let now = self.kept.back()?.t_s;
        let after = self.mean(LEVEL_BLOCKS)?;
        self.contact = true;
        self.back = 0;
        let baseline = self.baseline;
        let when = self.in_the_gap(noise, true).or_else(|| self.ramp(noise, true, |_| after - baseline))?;
        let moments = [pending.before, after];
        Some(self.event(EventKind::Onset, when, now, moments, (pending.statistic, pending.limit), None))
    }

    /// Where the state had changed already when the stream resumed: uniform over the gap.
    fn in_the_gap(&self, noise: &Noise, contact: bool) -> Option<EventTime> {
        let first = self.kept.front().filter(|_| self.gap_s > 0.0 && self.kept.len() < MAX_BLOCKS)?;
        let head =
            self.kept.iter().take(LEVEL_BLOCKS).map(|b| b.moment).sum::<Vector2<f64>>() / LEVEL_BLOCKS as f64;
        let away = distance(&(head - self.baseline), &self.level_covariance(noise, first.t_s));
        let limits = self.noise?.1;
        let new = if contact { away > limits.level } else { away < 4.0 * limits.back };
        new.then(|| EventTime { t_s: first.t_s - self.gap_s / 2.0, sd_s: self.gap_s / 12.0_f64.sqrt() })
    }

    /// Beginning or end of a ramp along the direction of the moment's change; the window is doubled until it lies inside.
    fn ramp(&self, noise: &Noise, rising: bool, change: impl Fn(usize) -> Vector2<f64>) -> Option<EventTime> {
        // A release is known only when the wire has been still for a while.
        let mut window = if rising { LOOK_BACK } else { LOOK_BACK + BACK_HOLD };
        loop {
            let blocks = self.newest(window);
            let direction = change(window).try_normalize(1e-12)?;
            let projected: Vec<(f64, f64)> =
                blocks.iter().map(|b| (b.t_s, direction.dot(&b.moment))).collect();
            let variance = (direction.transpose() * noise.block * direction)[0];
            let found = hinge(ramp_part(&projected, rising), rising, variance);
            let span_s = blocks.last()?.t_s - blocks[0].t_s;
            let early = found.is_none_or(|w| w.t_s - 2.0 * w.sd_s < blocks[0].t_s + 0.15 * span_s);
            if early && window < MAX_BLOCKS && self.kept.len() > window {
                window *= 2;
                continue;
            }
            if early {
                // Only an interval is known: that of the blocks kept.
                return Some(EventTime {
                    t_s: blocks.last()?.t_s - span_s / 2.0,
                    sd_s: span_s / 12.0_f64.sqrt(),
                });
            }
            return found;
        }
    }

    /// Names an abrupt change by what followed it.
    pub(super) fn classify(
        &mut self,
        pending: &Pending,
        noise: &Noise,
        limits: &Thresholds,
    ) -> Option<ContactEvent> {
        let whitened: Vec<Block> = self
            .newest(RING_WAIT + BLOCKS_BEFORE + BLOCKS_AFTER)
            .iter()
            .map(|b| Block { moment: self.whiten * b.moment, ..*b })
            .collect();
        let detected = whitened.partition_point(|b| b.t_s < pending.at_s);
        let band = [0.6 * self.settings.first_mode_hz, MAX_MODE_RATIO * self.settings.first_mode_hz];
        let tail = &whitened[(detected + RING_SKIP).min(whitened.len())..];
        // Chi-square with 4 degrees of freedom at the chance shared by some 300 frequencies and quality factors.
        let rung = ring(tail, band, chi2_4(RING_CHANCE / 300.0));
        let first = rung.is_some_and(|r| r.hz < 1.5 * self.settings.first_mode_hz);
        let around = [detected.saturating_sub(2 * BLOCKS_AFTER + 6), detected + 2];
        let when = step(&whitened, around, rung.as_ref(), first, limits.abrupt)?;
        let now = self.kept.back()?.t_s;
        let scale = (noise.block.trace() / 2.0).sqrt();
        let rung_nmm = rung.map(|r| Ring { amplitude: r.amplitude * scale, ..r });
        let settled = level(&whitened[whitened.len() - 3 * LEVEL_BLOCKS..], rung.as_ref())?;
        let after = self.whiten.try_inverse()? * settled;
        // A line and a ring through three windows know its end no better than one window its mean.
        let away = distance(&(after - self.baseline), &self.level_covariance(noise, now));
        let free = away < limits.level.min(4.0 * limits.back);
        let kind = match (self.contact, free) {
            // A tap, a bump of the mount or a flow: the wire was free and is free.
            (false, true) => {
                self.ring = rung_nmm;
                return None;
            }
            (false, false) => EventKind::Onset,
            (true, true) if first => EventKind::Snap,
            (true, true) => EventKind::Release,
            (true, false) if rung.is_some() => EventKind::Jump,
            (true, false) => EventKind::Slip,
        };
        self.ring = rung_nmm;
        self.contact = !free;
        self.back = 0;
        if free {
            self.free(after, now);
        }
        let moments = [pending.before, after];
        let shown = rung_nmm.map(|r| [r.hz, r.q, r.envelope(when.t_s)]);
        Some(self.event(kind, when, now, moments, (pending.statistic, pending.limit), shown))
    }

    fn event(
        &mut self,
        kind: EventKind,
        when: EventTime,
        known_s: f64,
        moments: [Vector2<f64>; 2],
        (statistic, limit): (f64, f64),
        ring: Option<[f64; 3]>,
    ) -> ContactEvent {
        self.gap_s = 0.0;
        let moments_nmm = moments.map(Into::into);
        ContactEvent { kind, t_s: when.t_s, sd_s: when.sd_s, known_s, moments_nmm, statistic, limit, ring }
    }
}
