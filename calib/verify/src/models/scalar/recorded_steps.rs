//! A stimulus that moved while it was recorded in steps (whole degrees): between its changes it is
//! known better than its record.
//!
//! ```text
//! x = (x_k + x_k+1) / 2 midway between the last reading of one value and the first of the next,   evenly from reading to reading in between
//! ```
//!
//! A record that is cut to its digits lies half a step off throughout, which the zero takes up. An
//! operator with memory smooths the steps, too: it is no finding where the moving stimulus does as
//! well.

use super::system::ScalarSystem;
use crate::method::{Hypothesis, REFIT_STEPS, fit};

/// Readings of a value of the stimulus, on average, from which on its record has steps.
const MIN_RUN: f64 = 1.5;
/// Share of a gain below which it is next to nothing.
const NEXT_TO_NOTHING: f64 = 1.0 / 3.0;
/// Squares that are left beside another description's, up to which it is as good.
const AS_WELL: f64 = 1.5;

impl ScalarSystem {
    /// The same readings at a stimulus that moved evenly between the changes of its record; none
    /// where that has no steps.
    fn moving_between_steps(&self) -> Option<Self> {
        let (frame, n) = (&self.frame, self.frame.u.len());
        let runs: Vec<&[usize]> = frame.setting.chunk_by(|a, b| a == b).collect();
        if !frame.ordered || !frame.sloped() || (n as f64) < MIN_RUN * runs.len() as f64 {
            return None;
        }
        // Before the first change and after the last one nothing says how fast it moved.
        let (mut u, mut first) = (frame.u.clone(), 0);
        for run in runs {
            let end = first + run.len();
            if first > 0 && end < n {
                let [from, to] = [first, end].map(|k| 0.5 * (frame.u[k - 1] + frame.u[k]));
                // Readings stand in the middle of equal parts of the run.
                let share = |k: usize| (k as f64 + 0.5) / run.len() as f64;
                (0..run.len()).for_each(|k| u[first + k] = from + (to - from) * share(k));
            }
            first = end;
        }
        let mut moving = self.clone();
        (moving.frame.read_u, moving.frame.u) = (u.clone(), u);
        Some(moving)
    }

    /// A term that follows the clock or the way of the stimulus gains next to nothing where that
    /// moved between the steps of its record, and without it the readings are explained as well.
    pub(super) fn smooths_steps(&self, h: &Hypothesis, without: &Hypothesis) -> bool {
        let Some(moving) = self.moving_between_steps() else {
            return false;
        };
        let left =
            |h: &Hypothesis| fit(&moving, &h.fit.terms, &h.weights, REFIT_STEPS).map(|fit| fit.ssr);
        left(h).zip(left(without)).is_some_and(|(with, plain)| {
            plain < AS_WELL * h.fit.ssr
                && plain - with < NEXT_TO_NOTHING * (without.fit.ssr - h.fit.ssr)
        })
    }
}
