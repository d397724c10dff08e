//! Averaging windows that a sweep's events state, and samples of one: mean, spread, marked
//! outliers.
//!
//! ```text
//! outlier   |x - med| > 8 * 1.4826 * median |x - med|        the factor makes the deviation that of a normal distribution
//! ```
//!
//! Source: F. R. Hampel, "The Influence Curve and Its Role in Robust Estimation", J. Am. Stat.
//! Assoc. 69 (1974) 383.

use crate::message::SweepEvent;
use wcal_core::order_statistics::{mad_sd, median};

/// Length of the window of a row on the fly, s.
const MOVING_WINDOW_S: f64 = 0.02;
/// A sample farther than this many robust standard deviations from the median is marked, not
/// averaged.
const OUTLIER_SIGMA: f64 = 8.0;

/// Samples of one window: scan number, reference and sensing gratings, nm.
#[derive(Debug, Clone, Default)]
pub(crate) struct Samples {
    /// Scan numbers.
    pub serials: Vec<u64>,
    /// Times since the window's begin, s.
    pub times_s: Vec<f64>,
    /// Reference grating; NaN where it has no peak.
    pub reference_nm: Vec<f64>,
    /// Sensing gratings.
    pub sensing_nm: [Vec<f64>; 2],
    /// Scans without both sensing gratings.
    pub unusable: u32,
}

/// Mean of a window.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WindowMean {
    /// Reference grating, nm, where there is one.
    pub reference_nm: Option<f64>,
    /// Spread of its single samples, pm.
    pub reference_sd_pm: f64,
    /// Sensing gratings, nm.
    pub sensing_nm: [f64; 2],
    /// Spread of single samples, pm.
    pub sensing_sd_pm: [f64; 2],
    /// Mean time of the samples since the window's begin, s: in motion half a scan from the
    /// window's centre is another place.
    pub time_s: f64,
    /// Samples averaged.
    pub samples: usize,
    /// Indices of marked samples.
    pub outliers: Vec<usize>,
}

impl Samples {
    /// The mean; `None` without two samples.
    pub(crate) fn mean(&self) -> Option<WindowMean> {
        let mut marked = vec![false; self.serials.len()];
        // A scan counts for both gratings or for neither: both see one moment.
        for values in &self.sensing_nm {
            mark(values, &mut marked);
        }
        let keep = |values: &[f64]| -> Vec<f64> {
            values
                .iter()
                .zip(&marked)
                .filter(|(v, m)| !**m && v.is_finite())
                .map(|(v, _)| *v)
                .collect()
        };
        let sensing = [keep(&self.sensing_nm[0]), keep(&self.sensing_nm[1])];
        if sensing[0].len() < 2 {
            return None;
        }
        let (a, b) = (mean_sd(&sensing[0]), mean_sd(&sensing[1]));
        let reference = keep(&self.reference_nm);
        let r = (reference.len() >= 2).then(|| mean_sd(&reference));
        Some(WindowMean {
            reference_nm: r.map(|r| r.0),
            reference_sd_pm: r.map_or(0.0, |r| r.1 * 1e3),
            sensing_nm: [a.0, b.0],
            sensing_sd_pm: [a.1 * 1e3, b.1 * 1e3],
            time_s: mean_sd(&keep(&self.times_s)).0,
            samples: sensing[0].len(),
            outliers: (0..marked.len()).filter(|k| marked[*k]).collect(),
        })
    }
}

fn mark(values: &[f64], marked: &mut [bool]) {
    let Some(centre) = median(values.iter().copied()) else {
        return;
    };
    // Quantised data can have a deviation of zero: then no sample is marked.
    let limit = OUTLIER_SIGMA * mad_sd(values.iter().copied(), centre).unwrap_or(0.0);
    if limit > 0.0 {
        for (value, mark) in values.iter().zip(marked) {
            *mark |= (value - centre).abs() > limit;
        }
    }
}

fn mean_sd(values: &[f64]) -> (f64, f64) {
    // About the first value: absolute wavelengths leave few digits for picometres.
    let first = values[0];
    let n = values.len() as f64;
    let mean = values.iter().map(|v| v - first).sum::<f64>() / n;
    let variance = values
        .iter()
        .map(|v| (v - first - mean).powi(2))
        .sum::<f64>()
        / (n - 1.0);
    (first + mean, variance.sqrt())
}

/// A window in device time, waiting for its samples.
pub(crate) struct Window {
    /// From, s.
    pub begin_s: f64,
    /// To, s.
    pub end_s: f64,
    /// Event that states it.
    pub event: usize,
    /// Its samples.
    pub samples: Samples,
    /// A scan of it came late.
    pub late: bool,
}

/// Share of a window that lies in gaps of the stream; `lost` in order of time.
pub(crate) fn missing_share(window: &Window, lost: &[[f64; 2]]) -> f64 {
    let from = lost.partition_point(|gap| gap[1] <= window.begin_s);
    let gaps = lost[from..].iter().take_while(|gap| gap[0] < window.end_s);
    let missing_s: f64 = gaps
        .map(|gap| gap[1].min(window.end_s) - gap[0].max(window.begin_s))
        .sum();
    missing_s / (window.end_s - window.begin_s)
}

/// Windows of the readings that events state; of a recording with so many scans.
///
/// # Errors
/// A move that states more rows than the recording has scans: two make a row.
pub(crate) fn windows_of(events: &[SweepEvent], scans: u64) -> Result<Vec<Window>, String> {
    let mut windows = Vec::new();
    let mut moving_rows = 0;
    for (index, event) in events.iter().enumerate() {
        let mut add = |begin_s: f64, end_s: f64| {
            let samples = Samples::default();
            windows.push(Window {
                begin_s,
                end_s,
                event: index,
                samples,
                late: false,
            });
        };
        match event.kind.as_str() {
            "window" => add(event.begin_s, event.end_s),
            "moving" if event.rows_hz > 0.0 => {
                // Windows on the fly may touch but never overlap: no scan counts twice.
                let half_s = MOVING_WINDOW_S.min(1.0 / event.rows_hz) / 2.0;
                let rows = ((event.end_s - event.begin_s).max(0.0) * event.rows_hz) as u64 + 1;
                moving_rows += rows;
                if moving_rows > scans {
                    return Err(format!(
                        "{moving_rows} rows on the fly of {scans} scans (step {})",
                        event.step
                    ));
                }
                let mut centre_s = event.begin_s + half_s;
                for _ in 0..rows {
                    if centre_s + half_s <= event.end_s {
                        add(centre_s - half_s, centre_s + half_s);
                    }
                    centre_s += 1.0 / event.rows_hz;
                }
            }
            _ => {}
        }
    }
    Ok(windows)
}

#[cfg(test)]
mod tests {
    use super::Samples;

    fn samples(spike_pm: f64) -> Samples {
        let wave = |k: usize, nm: f64| nm + 1e-3 * ((k * 37 % 101) as f64 / 50.0 - 1.0);
        let mut s = Samples {
            serials: (0..200).collect(),
            times_s: (0..200).map(|k| 5e-4 * f64::from(k)).collect(),
            reference_nm: (0..200).map(|k| wave(k, 1537.3)).collect(),
            sensing_nm: [1541.2, 1535.8].map(|nm| (0..200).map(|k| wave(k + 3, nm)).collect()),
            unusable: 0,
        };
        s.sensing_nm[1][50] += spike_pm * 1e-3;
        s
    }

    #[test]
    fn a_spike_is_marked_and_leaves_the_mean_alone() {
        let clean = samples(0.0).mean().unwrap();
        let spiked = samples(300.0).mean().unwrap();
        assert!(clean.outliers.is_empty());
        assert_eq!((spiked.outliers, spiked.samples), (vec![50], 199));
        // The mean is that of the others, and so is its time.
        let others_s = 5e-4 * (199.0 * 100.0 - 50.0) / 199.0;
        assert!(
            (clean.time_s - 5e-4 * 99.5).abs() < 1e-12 && (spiked.time_s - others_s).abs() < 1e-12
        );
        assert!((spiked.sensing_nm[1] - clean.sensing_nm[1]).abs() < 2e-5);
        assert!((clean.sensing_sd_pm[0] - 0.58).abs() < 0.02);
    }

    #[test]
    fn a_window_without_samples_has_no_mean() {
        assert!(Samples::default().mean().is_none());
    }
}
