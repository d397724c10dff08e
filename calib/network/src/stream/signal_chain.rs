//! One whisker from compensated shifts to rows for the tracker: filter and map.

use super::low_pass::LowPass;
use super::noise::{BLOCK_S, Prefix};
use crate::error::NetworkError;
use nalgebra::Matrix2;
use wcal_core::stream::{Flags, MomentSpread, MomentStream, StreamMoments, WhiskerReading};

/// Rates and lag of a chain.
#[derive(Debug, Clone, Copy)]
pub struct SignalChainSettings {
    /// Scans a second.
    pub rate_hz: f64,
    /// Rows a second; the nearest whole number of scans a row is taken.
    pub out_hz: f64,
    /// Lag of the filter, s.
    pub lag_s: f64,
    /// No-contact prefix, s.
    pub prefix_s: f64,
}

/// A row: what the tracker takes, or why there is nothing to take.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    /// Scan that completed it.
    pub serial: u64,
    /// Time of validity since the first scan, s: the scan's less the filter's lag.
    pub t_s: f64,
    /// Everything that was wrong since the row before.
    pub flags: Flags,
    /// Moments; none while the filter fills.
    pub moments: Option<StreamMoments>,
}

/// The chain of one whisker.
pub struct SignalChain {
    map: Box<dyn MomentStream>,
    filter: LowPass<3>,
    prefix: Prefix,
    rate_hz: f64,
    every: u64,
    due: Option<u64>,
    since: Flags,
    broken: bool,
}

impl SignalChain {
    /// A chain at its beginning.
    ///
    /// # Errors
    /// Names the rate or the lag that cannot be used.
    pub fn new(
        settings: &SignalChainSettings,
        map: Box<dyn MomentStream>,
    ) -> Result<Self, NetworkError> {
        let SignalChainSettings {
            rate_hz,
            out_hz,
            lag_s,
            prefix_s,
        } = *settings;
        let filter = LowPass::new(rate_hz, out_hz, lag_s).ok_or_else(|| {
            let expected = "a rate up to that of the scans, and a lag of a scan or more";
            NetworkError::value(
                "filter",
                expected,
                format!("{out_hz} Hz of {rate_hz} Hz, lag {lag_s} s"),
            )
        })?;
        if !(prefix_s > 0.0 && prefix_s.is_finite()) {
            return Err(NetworkError::value(
                "prefix",
                "above 0 s",
                format!("{prefix_s} s"),
            ));
        }
        Ok(Self {
            map,
            filter,
            prefix: Prefix::new(prefix_s, rate_hz),
            rate_hz,
            every: ((rate_hz / out_hz).round() as u64).max(1),
            due: None,
            since: Flags::default(),
            broken: false,
        })
    }

    /// The filter.
    pub fn filter(&self) -> &LowPass<3> {
        &self.filter
    }

    /// Noise of the beginning.
    pub fn prefix(&self) -> &Prefix {
        &self.prefix
    }

    /// What the spread of the last row's moments is made of.
    pub fn spread(&self) -> MomentSpread {
        self.map.spread()
    }

    /// Covariance of a row's own noise as in the prefix, (N mm)^2: that of the scans through the
    /// filter; none before the prefix is over.
    pub fn row_noise_nmm2(&self) -> Option<Matrix2<f64>> {
        let block_nmm2 = self.prefix.block_nmm2()?;
        // Scans of white noise: the mean of a block has 1 / n of their variance.
        let scans = (BLOCK_S * self.rate_hz).round().max(1.0);
        Some(block_nmm2 * scans * self.filter.noise_gain().powi(2))
    }

    /// Takes a reading. A gap or an unusable reading empties the filter: no row is made from values
    /// that were not measured.
    pub fn push(&mut self, sensed: &WhiskerReading) -> Option<Row> {
        let WhiskerReading {
            serial,
            t_s,
            shift_pm,
            rise_degc,
            flags,
        } = *sensed;
        let interrupted = Flags::GAP.with(Flags::CLOCK).with(Flags::DROPPED);
        self.broken |= flags.0 & interrupted.0 != 0 || shift_pm.is_none();
        if let Some(shift) = shift_pm {
            if std::mem::take(&mut self.broken) {
                self.filter.restart();
                self.prefix.gap();
            }
            self.filter.push(t_s, [shift[0], shift[1], rise_degc]);
            // Noise is learnt from single scans: rows of the filter are correlated.
            if self.prefix.block_nmm2().is_none() {
                self.prefix
                    .push(t_s, self.map.quick_nmm(t_s, shift, rise_degc));
            }
        }
        self.since = self.since.with(flags);
        let due = *self.due.get_or_insert(serial + self.every - 1);
        // After a gap there is one row, not one for every row that is missing; a unit that starts
        // anew counts from the bottom.
        let anew = flags.has(Flags::GAP) && serial + self.every < due;
        if serial < due && !anew {
            return None;
        }
        self.due = Some(
            if anew { serial } else { due }
                + ((serial.saturating_sub(due)) / self.every + 1) * self.every,
        );
        let answer = self.filter.answer().filter(|_| !self.broken);
        let mut flags = std::mem::take(&mut self.since);
        let moments = match answer {
            Some((at_s, [a, b, rise])) => Some((at_s, self.map.moments(at_s, [a, b], rise))),
            None => {
                flags = flags.with(Flags::FILLING);
                None
            }
        };
        // A row is true the filter's lag before the scan that completes it.
        let t_s = moments.map_or(t_s - self.filter.lag_s(), |m| m.0);
        Some(Row {
            serial,
            t_s,
            flags,
            moments: moments.map(|m| m.1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100 pm/(N mm) on both axes.
    struct Plain;

    impl MomentStream for Plain {
        fn quick_nmm(&mut self, _: f64, shift_pm: [f64; 2], _: f64) -> [f64; 2] {
            shift_pm.map(|s| s / 100.0)
        }

        fn moments(&mut self, t_s: f64, shift_pm: [f64; 2], rise: f64) -> StreamMoments {
            StreamMoments {
                moment_nmm: self.quick_nmm(t_s, shift_pm, rise),
                sd_nmm: [0.01; 2],
                valid: true,
            }
        }

        fn spread(&self) -> MomentSpread {
            MomentSpread::default()
        }
    }

    fn settings() -> SignalChainSettings {
        SignalChainSettings {
            rate_hz: 2000.0,
            out_hz: 10.0,
            lag_s: 0.1,
            prefix_s: 1.0,
        }
    }

    fn sensed(serial: u64) -> WhiskerReading {
        let t_s = serial as f64 / 2000.0;
        WhiskerReading {
            serial,
            t_s,
            shift_pm: Some([50.0 * t_s, 0.0]),
            rise_degc: 0.0,
            flags: Flags::default(),
        }
    }

    fn rows(scans: impl Iterator<Item = WhiskerReading>) -> Vec<Row> {
        let mut chain = SignalChain::new(&settings(), Box::new(Plain)).unwrap();
        scans.filter_map(|s| chain.push(&s)).collect()
    }

    #[test]
    fn rows_come_at_their_rate_and_are_true_of_their_time() {
        let rows = rows((0..4000).map(sensed));
        assert_eq!(rows.len(), 20);
        let filling = rows.iter().take_while(|r| r.moments.is_none()).count();
        assert_eq!(filling, 2, "0.2 s of scans fill the filter");
        for r in &rows[filling..] {
            let m = r.moments.unwrap().moment_nmm[0];
            assert!((m - 0.5 * r.t_s).abs() < 1e-9 && r.flags.none(), "{r:?}");
        }
    }

    #[test]
    fn a_gap_and_a_lost_peak_empty_the_filter_and_are_flagged_and_nothing_is_filled_in() {
        // 3,000 scans are missing.
        let gap = rows((0..2000).chain(5000..8000).map(|k| {
            let flags = if k == 5000 {
                Flags::GAP
            } else {
                Flags::default()
            };
            WhiskerReading { flags, ..sensed(k) }
        }));
        let first = gap.iter().position(|r| r.serial >= 5000).unwrap();
        assert_eq!(gap[first - 1].flags, Flags::default());
        assert_eq!(
            (gap[first].flags, gap[first].moments),
            (Flags::GAP.with(Flags::FILLING), None)
        );
        assert_eq!(gap[first + 1].flags, Flags::FILLING);
        assert!(gap.windows(2).all(|w| w[1].t_s > w[0].t_s));
        // Answers begin again only when every sample under the filter comes from after the gap.
        let again = gap[first..].iter().find(|r| r.moments.is_some()).unwrap();
        assert!(
            again.serial >= 5400
                && (again.moments.unwrap().moment_nmm[0] - 0.5 * again.t_s).abs() < 1e-9
        );
        let lost = rows((0..4000).map(|k| {
            if k == 2500 {
                WhiskerReading {
                    shift_pm: None,
                    flags: Flags::PEAK_LOST,
                    ..sensed(k)
                }
            } else {
                sensed(k)
            }
        }));
        let flagged: Vec<&Row> = lost
            .iter()
            .filter(|r| r.serial > 400 && !r.flags.none())
            .collect();
        assert!(
            flagged[0].flags.has(Flags::PEAK_LOST) && flagged.iter().all(|r| r.moments.is_none())
        );
        assert_eq!(flagged.len(), 2, "{flagged:?}");
        // Control: without the gap nothing is flagged.
        assert!(
            rows((0..8000).map(sensed))
                .iter()
                .skip(2)
                .all(|r| r.flags.none())
        );
    }

    #[test]
    fn rates_and_lags_that_cannot_be_are_named() {
        for (out_hz, lag_s) in [(4000.0, 0.1), (10.0, 0.0), (0.0, 0.1), (10.0, f64::NAN)] {
            let bad = SignalChainSettings {
                out_hz,
                lag_s,
                ..settings()
            };
            let error = SignalChain::new(&bad, Box::new(Plain))
                .err()
                .unwrap()
                .to_string();
            assert!(error.contains("filter"), "{error}");
        }
    }
}
