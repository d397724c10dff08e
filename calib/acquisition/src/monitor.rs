//! The signal as it arrives: rate, losses, health, clocks, and its drift.
//!
//! ```text
//! y_g = (l_g - r_g l_ref) 1e3                                     pm: grating g less the reference's temperature, r_g the temperature ratio
//! drift = sum (t - t_m)(y - y_m) / sum (t - t_m)^2,   sd^2 = RSS / (n - 2) / sum (t - t_m)^2         least squares over block means
//! ```

use crate::assign::{Assigned, ChannelMap};
use crate::clock_watch::ClockWatch;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use wcal_core::device::{DeviceError, DeviceErrorKind, FbgReading};

/// Scans are averaged over this time before the drift is judged, s.
const BLOCK_S: f64 = 0.02;
/// How much of the past is kept, s.
const KEPT_S: f64 = 30.0;
/// Consecutive scans without a usable peak that end a sweep.
const LOST_LIMIT: u32 = 20;

/// Counters of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StreamCounts {
    /// Scans received.
    pub scans: u64,
    /// Jumps of the scan number.
    pub gaps: u64,
    /// Scans missing in them.
    pub lost: u64,
    /// Scans with a lost or crossing peak.
    pub unusable: u64,
    /// Camera pairs recorded.
    pub pairs: u64,
    /// Camera pairs refused: skew past the limit, or a camera that repeats itself.
    pub pairs_refused: u64,
    /// Largest skew of a recorded pair, ms.
    pub worst_skew_ms: f64,
}

pub(crate) fn lock(monitor: &Mutex<Monitor>) -> MutexGuard<'_, Monitor> {
    monitor.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Watches a stream.
pub struct Monitor {
    map: ChannelMap,
    temperature_ratio: [f64; 2],
    counts: StreamCounts,
    next_serial: Option<u64>,
    latest_s: Option<f64>,
    latest: Assigned,
    blocks: VecDeque<Block>,
    unusable_run: u32,
    clock: ClockWatch,
    fault: Option<DeviceError>,
    /// Step whose settled pose is to be pictured, and since when, host time, s.
    pub(crate) picture: Option<(u32, f64)>,
}

struct Block {
    start_s: f64,
    count: f64,
    /// Of the times since its start.
    sum_s: f64,
    sum_pm: [f64; 2],
}

impl Monitor {
    /// `temperature_ratio`: shift of each sensing grating per shift of the reference, at constant
    /// load. `clock_scale`: host seconds per wall second.
    pub fn new(map: ChannelMap, temperature_ratio: [f64; 2], clock_scale: f64) -> Self {
        Self {
            map,
            temperature_ratio,
            counts: StreamCounts::default(),
            next_serial: None,
            latest_s: None,
            latest: Assigned::default(),
            blocks: VecDeque::new(),
            unusable_run: 0,
            clock: ClockWatch::new(clock_scale),
            fault: None,
            picture: None,
        }
    }

    /// Takes a scan.
    pub fn take(&mut self, reading: &FbgReading) {
        self.counts.scans += 1;
        if let Some(expected) = self.next_serial
            && reading.serial > expected
        {
            self.counts.gaps += 1;
            self.counts.lost = self.counts.lost.saturating_add(reading.serial - expected);
        }
        self.next_serial = Some(reading.serial.saturating_add(1));
        let host_s = reading.clocks.host_s;
        let device_s = reading.clocks.device_s.unwrap_or(host_s);
        self.latest_s = Some(device_s);
        // Every wait of a sweep counts by this clock.
        if let Some(fault) = self.clock.take(reading.serial, host_s, device_s) {
            self.fail_with(fault.error());
        }
        self.judge_health(reading);
        self.latest = self.map.assign(reading);
        match self.latest.usable() {
            Some(sensing) => {
                self.unusable_run = 0;
                self.add_block(device_s, sensing);
            }
            None => {
                self.counts.unusable += 1;
                self.unusable_run += 1;
                if self.unusable_run >= LOST_LIMIT {
                    let found = match self.latest.crossing {
                        true => "crossing peaks",
                        false => "a lost peak",
                    };
                    let kind = DeviceErrorKind::PeakLost;
                    self.fail(kind, "assign peaks", "one peak a grating", found);
                }
            }
        }
    }

    fn judge_health(&mut self, reading: &FbgReading) {
        let (faults, code) = (reading.health.faults(), reading.health.error_code);
        // A fan that fails falsifies no wavelength yet; every other fault may.
        if faults == ["fan-fault"] || faults.is_empty() {
            return;
        }
        // By error code 9 the sm130 says that its data are invalid.
        let kind = match code {
            9 => DeviceErrorKind::DataInvalid,
            _ => DeviceErrorKind::Health,
        };
        let found = format!("{} (error code {code})", faults.join(", "));
        self.fail(kind, "read the stream", "a healthy unit", &found);
    }

    /// Counts a camera pair: its skew (ms), or `None` where it was refused.
    pub fn pair(&mut self, skew_ms: Option<f64>) {
        match skew_ms {
            Some(skew_ms) => {
                self.counts.pairs += 1;
                self.counts.worst_skew_ms = self.counts.worst_skew_ms.max(skew_ms.abs());
            }
            None => self.counts.pairs_refused += 1,
        }
    }

    /// Ends the sweep with this fault, unless there is one already.
    fn fail(&mut self, kind: DeviceErrorKind, action: &str, expected: &str, found: &str) {
        let error = DeviceError::new(kind, "interrogator", action, expected, found);
        self.fail_with(error);
    }

    /// Ends the sweep with this error, unless there is one already.
    pub(crate) fn fail_with(&mut self, error: DeviceError) {
        self.fault.get_or_insert(error);
    }

    /// The first fault.
    pub fn fault(&self) -> Option<&DeviceError> {
        self.fault.as_ref()
    }

    /// Device time of the newest scan, s.
    pub fn device_s(&self) -> Option<f64> {
        self.latest_s
    }

    /// Newest wavelengths.
    pub fn latest(&self) -> Assigned {
        self.latest
    }

    /// Counters.
    pub fn counts(&self) -> StreamCounts {
        self.counts
    }

    /// Device time at a host time, s; the stream itself may not have got there yet.
    pub(crate) fn device_s_at(&self, host_s: f64) -> Option<f64> {
        self.clock.pair.device_s(host_s)
    }

    fn add_block(&mut self, device_s: f64, sensing_nm: [f64; 2]) {
        let heat_nm = self.latest.reference_nm.unwrap_or(0.0);
        let value: [f64; 2] = std::array::from_fn(|k| {
            // The reference's absolute wavelength adds a constant only, which the slope does not
            // see.
            (sensing_nm[k] - self.temperature_ratio[k] * heat_nm) * 1e3
        });
        match self.blocks.back_mut() {
            Some(block) if device_s - block.start_s < BLOCK_S => {
                block.count += 1.0;
                block.sum_s += device_s - block.start_s;
                block.sum_pm = std::array::from_fn(|k| block.sum_pm[k] + value[k]);
            }
            _ => self.blocks.push_back(Block {
                start_s: device_s,
                count: 1.0,
                sum_s: 0.0,
                sum_pm: value,
            }),
        }
        let old = |b: &mut Block| b.start_s < device_s - KEPT_S;
        while self.blocks.pop_front_if(old).is_some() {}
    }

    /// Usable scans between two device times of the last half minute, to within a block.
    pub(crate) fn scans_between(&self, begin_s: f64, end_s: f64) -> f64 {
        let inside = |b: &&Block| (begin_s..end_s).contains(&b.start_s);
        self.blocks.iter().filter(inside).map(|b| b.count).sum()
    }

    /// Largest drift of the sensing gratings over the last `window_s`, temperature compensated,
    /// pm/s, with its standard error; `None` until the window is full since `since_s`.
    pub(crate) fn drift_pm_per_s(&self, since_s: f64, window_s: f64) -> Option<(f64, f64)> {
        let from_s = self.latest_s? - window_s;
        let inside = self.blocks.iter().filter(|b| b.start_s >= from_s);
        // Scans from before `since_s` belong to the move; few blocks give no error of the slope.
        if from_s < since_s || inside.clone().count() < 8 {
            return None;
        }
        let slopes = [0, 1].map(|k| {
            let mean = |b: &Block| {
                let mean_s = b.start_s - from_s + b.sum_s / b.count;
                (mean_s, b.sum_pm[k] / b.count)
            };
            slope(&inside.clone().map(mean).collect::<Vec<_>>())
        });
        let size = |slope: &(f64, f64)| slope.0.abs();
        let steeper = |a: &_, b: &_| size(a).total_cmp(&size(b));
        slopes.into_iter().max_by(steeper)
    }
}

/// Least-squares slope and its standard error.
fn slope(xy: &[(f64, f64)]) -> (f64, f64) {
    let n = xy.len() as f64;
    let mean_x = xy.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_y = xy.iter().map(|p| p.1).sum::<f64>() / n;
    let sxx: f64 = xy.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    let sxy: f64 = xy.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    let b = sxy / sxx;
    let rss: f64 = xy
        .iter()
        .map(|p| (p.1 - mean_y - b * (p.0 - mean_x)).powi(2))
        .sum();
    (b, (rss / (n - 2.0).max(1.0) / sxx).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Rig, tests::RIG};
    use wcal_core::device::{Clocks, InterrogatorHealth};

    fn monitor() -> Monitor {
        Monitor::new(
            ChannelMap::new(&Rig::parse("r", RIG).unwrap()),
            [1.0, 1.0],
            1.0,
        )
    }

    fn scan(serial: u64, drift_pm_s: f64, heat_pm_s: f64) -> FbgReading {
        let t = serial as f64 / 2000.0;
        let nm = |base: f64, rate: f64| base + rate * t * 1e-3;
        FbgReading {
            serial,
            peaks_nm: vec![vec![
                nm(1535.8, heat_pm_s),
                nm(1537.3, heat_pm_s),
                nm(1541.2, drift_pm_s + heat_pm_s),
            ]],
            health: InterrogatorHealth::default(),
            clocks: Clocks {
                host_s: t,
                device_s: Some(t),
            },
        }
    }

    #[test]
    fn drift_is_seen_and_temperature_is_not_drift() {
        let drift = |rate: f64, heat: f64| {
            let mut m = monitor();
            (0..6000).for_each(|k| m.take(&scan(k, rate, heat)));
            m.drift_pm_per_s(0.0, 1.0).unwrap().0
        };
        assert!((drift(3.0, 0.0) - 3.0).abs() < 1e-3);
        assert!(drift(0.0, 40.0).abs() < 1e-3);
        let mut early = monitor();
        (0..1000).for_each(|k| early.take(&scan(k, 0.0, 0.0)));
        assert_eq!(early.drift_pm_per_s(0.0, 1.0), None);
    }

    #[test]
    fn lost_scans_are_counted_and_none_are_invented() {
        let mut m = monitor();
        for k in (0..100).chain(107..200).chain(201..300) {
            m.take(&scan(k, 0.0, 0.0));
        }
        assert_eq!(
            (m.counts().gaps, m.counts().lost, m.counts().scans),
            (2, 8, 292)
        );
        assert!(m.fault().is_none());
    }

    #[test]
    fn faults_of_the_unit_and_lost_peaks_end_a_sweep_and_a_fan_does_not() {
        let mut m = monitor();
        let mut bad = scan(0, 0.0, 0.0);
        bad.health.fan_fault = true;
        m.take(&bad);
        assert!(m.fault().is_none());
        bad.health.error_code = 9;
        m.take(&bad);
        assert_eq!(m.fault().unwrap().kind, DeviceErrorKind::DataInvalid);
        let mut m = monitor();
        for k in 0..LOST_LIMIT {
            assert!(m.fault().is_none());
            let mut lost = scan(u64::from(k), 0.0, 0.0);
            lost.peaks_nm[0].pop();
            m.take(&lost);
        }
        assert_eq!(m.fault().unwrap().kind, DeviceErrorKind::PeakLost);
    }
}
