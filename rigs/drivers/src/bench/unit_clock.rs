//! What is wrong with a unit's clock: drift, steps, standstill.

/// Faults of a clock, in bench time, s.
#[derive(Debug, Clone, Default)]
pub(crate) struct UnitClock {
    /// Since when it drifts, and by how many ppm.
    drift: (f64, f64),
    /// When it was set, and by how much.
    steps: Vec<(f64, f64)>,
    /// Since when it stands still.
    stopped_s: Option<f64>,
}

impl UnitClock {
    /// What it shows at bench time `t_s`, s.
    pub(crate) fn at(&self, t_s: f64) -> f64 {
        // A clock that stands neither drifts nor steps.
        let t_s = self.stopped_s.map_or(t_s, |stopped_s| t_s.min(stopped_s));
        let (since_s, ppm) = self.drift;
        let steps_s: f64 = self
            .steps
            .iter()
            .filter(|(at_s, _)| t_s >= *at_s)
            .map(|(_, step_s)| step_s)
            .sum();
        t_s + (t_s - since_s).max(0.0) * ppm * 1e-6 + steps_s
    }

    /// Drifts from now on.
    pub(crate) fn drift(&mut self, t_s: f64, ppm: f64) {
        self.drift = (t_s, ppm);
    }

    /// Is set now.
    pub(crate) fn step(&mut self, t_s: f64, step_s: f64) {
        self.steps.push((t_s, step_s));
    }

    /// Stands still from now on, or goes on from where it stood.
    pub(crate) fn stop(&mut self, t_s: f64, on: bool) {
        match (on, self.stopped_s) {
            (true, None) => self.stopped_s = Some(t_s),
            (false, Some(stopped_s)) => {
                // It goes on from where it stood: from now on it is late by the standstill.
                self.stopped_s = None;
                self.step(t_s, stopped_s - t_s);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::UnitClock;

    #[test]
    fn a_clock_is_set_stands_and_goes_on() {
        let mut clock = UnitClock::default();
        assert_eq!(clock.at(5.0), 5.0, "control");
        clock.step(10.0, -3.0);
        assert_eq!((clock.at(9.0), clock.at(11.0)), (9.0, 8.0));
        clock.stop(20.0, true);
        assert_eq!((clock.at(20.0), clock.at(50.0)), (17.0, 17.0));
        clock.stop(50.0, false);
        assert_eq!(clock.at(51.0), 18.0);
        clock.drift(60.0, 1e6);
        assert_eq!(clock.at(61.0), 29.0);
    }
}
