//! Two clocks side by side: offset and drift from the pairs that arrived with least delay. Nothing is stretched: device
//! times stay as they are, host times of other devices are mapped onto them.

/// Pairs are thinned to the best of each interval of this length, s.
const INTERVAL_S: f64 = 1.0;

/// Host and device time of one stream.
#[derive(Debug, Clone, Default)]
pub struct ClockPair {
    origin: Option<(f64, f64)>,
    best: Vec<(f64, f64)>,
    current: Option<(i64, f64, f64)>,
}

/// device = host + offset + drift * (host - origin).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockFit {
    /// Host time at which `offset_s` holds, s.
    pub origin_host_s: f64,
    /// Device minus host time there, s.
    pub offset_s: f64,
    /// Drift of the device clock, s/s.
    pub drift: f64,
    /// Standard error of the drift, s/s.
    pub drift_sd: f64,
    /// Scatter of the best pairs about the line, s.
    pub scatter_s: f64,
}

/// A drift above this is no crystal's, s/s: the clock is broken or the recording is not what it says.
const BROKEN_CLOCK: f64 = 300e-6;

impl ClockFit {
    /// Whether the device clock drifts more than any working clock does, its own error counted against that.
    #[must_use]
    pub fn broken(&self) -> bool {
        self.drift.abs() > BROKEN_CLOCK + 4.0 * self.drift_sd
    }

    /// Device time at a host time, s.
    #[must_use]
    pub fn device_s(&self, host_s: f64) -> f64 {
        host_s + self.offset_s + self.drift * (host_s - self.origin_host_s)
    }
}

impl ClockPair {
    /// Adds the arrival of a reading.
    pub fn add(&mut self, host_s: f64, device_s: f64) {
        let (host0, device0) = *self.origin.get_or_insert((host_s, device_s));
        let (x, y) = (host_s - host0, device_s - device0 - (host_s - host0));
        let interval = (x / INTERVAL_S).floor() as i64;
        match &mut self.current {
            // The least delayed arrival has the largest device minus host time.
            // An arrival of the interval before the newest one changes nothing about when that began.
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

    /// The fit; `None` without any pair.
    #[must_use]
    pub fn fit(&self) -> Option<ClockFit> {
        let (host0, device0) = self.origin?;
        let mut points = self.best.clone();
        points.extend(self.current.map(|(_, x, y)| (x, y)));
        let n = points.len() as f64;
        let mean_x = points.iter().map(|p| p.0).sum::<f64>() / n;
        let mean_y = points.iter().map(|p| p.1).sum::<f64>() / n;
        let sxx: f64 = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
        let sxy: f64 = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
        // A drift needs some length of recording to stand out from delays.
        let drift = if points.len() >= 5 { sxy / sxx } else { 0.0 };
        let scatter = points.iter().map(|p| (p.1 - mean_y - drift * (p.0 - mean_x)).powi(2)).sum::<f64>();
        let drift_sd = if points.len() >= 5 { (scatter / (n - 2.0) / sxx).sqrt() } else { f64::INFINITY };
        Some(ClockFit {
            origin_host_s: host0,
            offset_s: device0 - host0 + mean_y - drift * mean_x,
            drift,
            drift_sd,
            scatter_s: (scatter / n).sqrt(),
        })
    }
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
        assert!((fit.drift - 50e-6).abs() < 5e-6 && fit.drift_sd < 5e-6 && !fit.broken(), "{fit:?}");
        assert!((fit.device_s(1.7e9 + 20.0) - (1000.0 + 20.0 * (1.0 + 50e-6))).abs() < 1e-3, "{fit:?}");
    }

    #[test]
    fn a_clock_that_runs_away_is_called_broken_and_a_short_recording_never_is() {
        let run = |drift: f64, seconds: u64| {
            let mut pair = ClockPair::default();
            (0..seconds * 100).for_each(|k| pair.add(k as f64 / 100.0, k as f64 / 100.0 * (1.0 + drift)));
            pair.fit().unwrap().broken()
        };
        assert!(run(1e-3, 60) && !run(1e-4, 60) && !run(1e-3, 3));
    }

    #[test]
    fn without_readings_there_is_no_fit() {
        assert!(ClockPair::default().fit().is_none());
    }
}
