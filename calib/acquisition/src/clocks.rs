//! Relation of two clocks: offset and drift from the pairs that arrived with least delay. Nothing
//! is stretched: device times stay as they are, host times of other devices are mapped onto them.
//!
//! A delay only ever makes a reading late, so the line lies above all pairs and as close to them as
//! it can: with x the host time and y the device time less x,
//!
//! ```text
//! min over a, b of sum_i (a + b x_i - y_i)   subject to   a + b x_i >= y_i
//! ```
//!
//! whose solution is the edge of the pairs' upper convex hull over the mean of x (Moon, Skelly,
//! Towsley, "Estimation and removal of clock skew from network delay measurements", 1999). Arrivals
//! seconds late carry no information on the clocks and are left out of the line: a stream that
//! falls behind for half a recording would tilt it.

use wcal_core::clock::late_s;
use wcal_core::order_statistics::mad_sd;

/// Pairs are thinned to the best of each interval of this length, s.
const INTERVAL_S: f64 = 1.0;
/// Intervals that count as recent: a crystal drifts by a millisecond in them, a busy host recovers.
const RECENT: usize = 10;

/// Tolerated error of the clocks' alignment (wall time), s: the delay of a busy host.
const ALIGNED_S: f64 = 0.02;

/// Host and device time of one stream.
#[derive(Debug, Clone)]
pub struct ClockPair {
    clock_scale: f64,
    origin: Option<(f64, f64)>,
    /// The least delayed pair of all.
    earliest: (f64, f64),
    best: Vec<(f64, f64)>,
    current: Option<(i64, f64, f64)>,
}

/// device = host + offset + drift * (host - origin).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockFit {
    /// Host time of `offset_s`, s.
    pub origin_host_s: f64,
    /// Device minus host time there, s.
    pub offset_s: f64,
    /// Drift of the device clock, s/s.
    pub drift: f64,
    /// Standard error of the drift, s/s.
    pub drift_sd: f64,
    /// Scatter of the best pairs, s.
    pub scatter_s: f64,
}

/// Largest drift of a working quartz clock, s/s: above it the clock is broken or the recording is
/// inconsistent.
pub(crate) const BROKEN_CLOCK: f64 = 300e-6;

impl ClockFit {
    /// Whether the device clock drifts more than any working clock does, its own error counted
    /// against that.
    pub fn broken(&self) -> bool {
        self.drift.abs() > BROKEN_CLOCK + 4.0 * self.drift_sd
    }

    /// Device time at a host time, s.
    pub fn device_s(&self, host_s: f64) -> f64 {
        host_s + self.offset_s + self.drift * (host_s - self.origin_host_s)
    }

    /// Host time at a device time, s.
    pub fn host_s(&self, device_s: f64) -> f64 {
        self.origin_host_s + (device_s - self.offset_s - self.origin_host_s) / (1.0 + self.drift)
    }
}

impl Default for ClockPair {
    fn default() -> Self {
        Self::new(1.0)
    }
}

impl ClockPair {
    /// No pair yet; host times run `clock_scale` times as fast as real time.
    pub fn new(clock_scale: f64) -> Self {
        Self {
            clock_scale,
            origin: None,
            earliest: (0.0, f64::NEG_INFINITY),
            best: Vec::new(),
            current: None,
        }
    }

    /// Adds the arrival of a reading.
    pub fn add(&mut self, host_s: f64, device_s: f64) {
        let (host0, device0) = *self.origin.get_or_insert((host_s, device_s));
        let x = host_s - host0;
        let y = device_s - device0 - x;
        // A delay makes y small, never large.
        if y > self.earliest.1 {
            self.earliest = (x, y);
        }
        let interval = (x / INTERVAL_S).floor() as i64;
        match &mut self.current {
            // The least delayed arrival has the largest device minus host time. An arrival of the
            // interval before the newest one changes nothing about when that began.
            Some((current, best_x, best_y)) if *current >= interval => {
                if y > *best_y {
                    (*best_x, *best_y) = (x, y);
                }
            }
            _ => {
                if let Some((_, bx, by)) = self.current.replace((interval, x, y)) {
                    self.best.push((bx, by));
                }
            }
        }
    }

    /// Device time at a host time, s: the later of the line's and the recent pairs' times; `None`
    /// without any pair. Late rather than early: delays, however long they last, only make a clock
    /// seem to lag.
    pub fn device_s(&self, host_s: f64) -> Option<f64> {
        let (host0, device0) = self.origin?;
        let recent = self.best.iter().rev().take(RECENT).map(|p| p.1);
        let recent = recent.chain(self.current.map(|c| c.2));
        let offset = recent.fold(f64::NEG_INFINITY, f64::max);
        let by_line = self.fit()?.device_s(host_s);
        Some(by_line.max(host_s - host0 + device0 + offset))
    }

    /// How much later a reading arrived than the least delayed one, s, less what a working clock
    /// may have drifted between the two.
    pub fn delay_s(&self, host_s: f64, device_s: f64) -> f64 {
        let Some((host0, device0)) = self.origin else {
            return 0.0;
        };
        let x = host_s - host0;
        self.delay_of((x, device_s - device0 - x))
    }

    fn delay_of(&self, (x, y): (f64, f64)) -> f64 {
        self.earliest.1 - y - BROKEN_CLOCK * (x - self.earliest.0).abs()
    }

    /// Whether a reading came so late that the bench or this computer had fallen behind.
    pub(crate) fn is_late(&self, host_s: f64, device_s: f64) -> bool {
        self.delay_s(host_s, device_s) > late_s(self.clock_scale)
    }

    /// Whether host times cannot be converted to device times: the line drifts more than a working
    /// clock does, by a harmful amount. A stream that falls behind steadily has the same effect: it
    /// cannot be distinguished from a slow clock.
    pub(crate) fn is_unaligned(&self) -> bool {
        let Some(fit) = self.fit() else { return false };
        let last_s = self.current.map_or(0.0, |(_, x, _)| x);
        // Half the length: from the middle, a wrong drift is off by it at both ends.
        (fit.drift.abs() - BROKEN_CLOCK) * last_s / 2.0 > ALIGNED_S * self.clock_scale
    }

    /// The fit; `None` without any pair.
    pub fn fit(&self) -> Option<ClockFit> {
        let (host0, device0) = self.origin?;
        let mut points = self.best.clone();
        points.extend(self.current.map(|(_, x, y)| (x, y)));
        points.retain(|p| self.delay_of(*p) <= late_s(self.clock_scale));
        let n = points.len() as f64;
        // About the mean time: there offset and drift do not trade.
        let mean_x = points.iter().map(|p| p.0).sum::<f64>() / n;
        let sxx: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
        let scatter_s = scatter(&points);
        let highest = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
        // Fewer pairs do not separate a drift from delays.
        let (drift, at_zero, drift_sd) = match points.len() {
            ..5 => (0.0, highest, f64::INFINITY),
            _ => {
                let (slope, at_zero) = upper_line(&points, mean_x);
                (slope, at_zero, scatter_s / sxx.sqrt())
            }
        };
        Some(ClockFit {
            origin_host_s: host0,
            offset_s: device0 - host0 + at_zero,
            drift,
            drift_sd,
            scatter_s,
        })
    }
}

/// Slope and value at 0 of the edge of the upper convex hull above `middle`; points in order of x.
fn upper_line(points: &[(f64, f64)], middle: f64) -> (f64, f64) {
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for &p in points {
        while let [.., a, b] = hull[..]
            && (b.1 - a.1) * (p.0 - a.0) <= (p.1 - a.1) * (b.0 - a.0)
        {
            hull.pop();
        }
        hull.push(p);
    }
    let after = hull
        .partition_point(|p| p.0 < middle)
        .clamp(1, hull.len() - 1);
    let (a, b) = (hull[after - 1], hull[after]);
    let slope = (b.1 - a.1) / (b.0 - a.0);
    (slope, a.1 - slope * a.0)
}

/// Scatter of neighbouring pairs by their second differences, in which a piecewise linear course of
/// the clock cancels.
fn scatter(points: &[(f64, f64)]) -> f64 {
    let second = points.windows(3).map(|w| w[0].1 - 2.0 * w[1].1 + w[2].1);
    // A second difference has the variance 1 + 4 + 1.
    mad_sd(second, 0.0).map_or(0.0, |sd| sd / 6_f64.sqrt())
}

#[cfg(test)]
mod tests {
    use super::ClockPair;

    #[test]
    fn offset_and_drift_are_found_behind_irregular_delays() {
        let mut pair = ClockPair::default();
        for k in 0..60_000_u64 {
            let host = 1.7e9 + k as f64 * 5e-4;
            let device = 1000.0 + (host - 1.7e9) * (1.0 + 50e-6);
            // Arrival is late by 0 to 16 ms.
            let late = ((k * 7919) % 97) as f64 / 97.0 * 0.016;
            pair.add(host + late, device);
        }
        let fit = pair.fit().unwrap();
        assert!(
            (fit.drift - 50e-6).abs() < 5e-6 && fit.drift_sd < 5e-6 && !fit.broken(),
            "{fit:?}"
        );
        assert!((fit.host_s(fit.device_s(1.7e9 + 20.0)) - (1.7e9 + 20.0)).abs() < 1e-6);
        assert!(
            (fit.device_s(1.7e9 + 20.0) - (1000.0 + 20.0 * (1.0 + 50e-6))).abs() < 1e-3,
            "{fit:?}"
        );
    }

    #[test]
    fn a_clock_that_runs_away_is_called_broken_and_a_short_recording_never_is() {
        let run = |drift: f64, seconds: u64| {
            let mut pair = ClockPair::default();
            (0..seconds * 100)
                .for_each(|k| pair.add(k as f64 / 100.0, k as f64 / 100.0 * (1.0 + drift)));
            pair.fit().unwrap().broken()
        };
        assert!(run(1e-3, 60) && !run(1e-4, 60) && !run(1e-3, 3));
    }

    /// Two of three seconds late by up to half a second: least squares would be off by a quarter of
    /// a second.
    #[test]
    fn a_busy_host_does_not_move_the_line() {
        let mut pair = ClockPair::default();
        for k in 0..6000_u32 {
            let device = f64::from(k) * 0.01;
            let second = k / 100;
            let late = if second % 3 == 0 {
                0.0
            } else {
                0.1 + 0.4 * f64::from(second * 7 % 10) / 10.0
            };
            pair.add(device + late, device);
        }
        let fit = pair.fit().unwrap();
        assert!(
            fit.drift.abs() < 1e-4 && (fit.device_s(30.0) - 30.0).abs() < 2e-3,
            "{fit:?}"
        );
        assert!((pair.device_s(61.0).unwrap() - 61.0).abs() < 1e-2);
        // Half a minute of late arrivals only: the earlier fit remains.
        (6000..9000).for_each(|k| pair.add(f64::from(k) * 0.01 + 4.0, f64::from(k) * 0.01));
        assert!(
            (pair.device_s(94.0).unwrap() - 94.0).abs() < 0.1,
            "{:?}",
            pair.device_s(94.0)
        );
    }

    #[test]
    fn a_clock_that_breaks_in_mid_recording_is_seen() {
        let mut pair = ClockPair::default();
        for k in 0..4000_u32 {
            let host = f64::from(k) * 0.01;
            pair.add(
                host + f64::from(k * 37 % 11) * 2e-3,
                host + (host - 25.0).max(0.0) * 0.02,
            );
        }
        assert!(pair.fit().unwrap().broken());
    }

    /// A bench that falls behind for the second half of a recording: the line stays that of the
    /// first, and every late reading is known.
    #[test]
    fn a_stream_that_falls_behind_moves_neither_the_line_nor_hides() {
        let mut pair = ClockPair::new(1.0);
        let late = |k: u32| {
            if k < 5000 {
                0.0
            } else {
                5.0 + f64::from(k - 5000) * 0.005
            }
        };
        let at = |k: u32| {
            (
                f64::from(k) * 0.01 + late(k),
                f64::from(k) * 0.01 * (1.0 + 50e-6),
            )
        };
        (0..10_000).for_each(|k| pair.add(at(k).0, at(k).1));
        let fit = pair.fit().unwrap();
        assert!((fit.drift - 50e-6).abs() < 5e-6, "{fit:?}");
        let found = (0..10_000).filter(|k| pair.is_late(at(*k).0, at(*k).1));
        assert!(found.eq(5000..10_000));
        // Control: what a working clock drifts in three hours is no delay.
        let mut good = ClockPair::new(1.0);
        (0..10_800).for_each(|s| good.add(f64::from(s), f64::from(s) * (1.0 - 250e-6)));
        assert!((0..10_800).all(|s| !good.is_late(f64::from(s), f64::from(s) * (1.0 - 250e-6))));
    }

    #[test]
    fn a_stream_that_falls_behind_more_and_more_cannot_be_aligned() {
        let run = |behind: f64| {
            let mut pair = ClockPair::new(60.0);
            (0..13_000)
                .map(|k| f64::from(k) * 0.01)
                .for_each(|t| pair.add(t * (1.0 + behind), t));
            pair.is_unaligned()
        };
        assert!(run(0.6) && run(0.1));
        // Controls: nothing behind, and what a crystal may drift.
        assert!(!run(0.0) && !run(200e-6));
    }

    #[test]
    fn without_readings_there_is_no_fit() {
        assert!(ClockPair::default().fit().is_none());
    }
}
