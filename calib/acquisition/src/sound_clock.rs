//! Which scans of a recording came before a fault of the interrogator's clock.

use crate::clock_watch::ClockWatch;
use crate::clocks::ClockPair;
use crate::message::Scan;

/// The scans of a recording up to the first fault of the interrogator's clock: the clocks are
/// aligned by these alone.
pub(crate) struct SoundClock {
    watch: ClockWatch,
    count: usize,
    /// Scans of which it is not certain yet whether they came after a fault.
    held: Vec<(f64, f64)>,
    /// Number of the first scan, and of the first event, from after the fault.
    pub(crate) broken: Option<(usize, usize)>,
}

impl SoundClock {
    pub(crate) fn new(clock_scale: f64) -> Self {
        Self {
            watch: ClockWatch::new(clock_scale),
            count: 0,
            held: Vec::new(),
            broken: None,
        }
    }

    /// Takes the next scan, after that many events; good ones go to `clocks`, what the clock did to
    /// `faults`.
    pub(crate) fn take(
        &mut self,
        scan: &Scan,
        clocks: &mut ClockPair,
        events: usize,
        faults: &mut Vec<String>,
    ) {
        let fault = self.watch.take(scan.serial, scan.host_s, scan.device_s);
        if let Some(fault) = fault {
            faults.push(fault.to_string());
            self.broken
                .get_or_insert((self.count - self.held.len(), events));
            self.held.clear();
        }
        self.count += 1;
        if self.broken.is_some() {
            return;
        }
        self.held.push((scan.host_s, scan.device_s));
        if !self.watch.is_unsure() {
            self.settle(clocks);
        }
    }

    /// What was held is good, but for single wrong stamps.
    pub(crate) fn settle(&mut self, clocks: &mut ClockPair) {
        let good = self
            .held
            .drain(..)
            .filter(|(host_s, device_s)| self.watch.is_plausible(*host_s, *device_s));
        good.for_each(|(host_s, device_s)| clocks.add(host_s, device_s));
    }
}
