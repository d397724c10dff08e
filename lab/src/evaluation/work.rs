//! How much work each part of an evaluation is, for the time left. The costs are seconds on one core of a machine of 2026, by a run of the
//! whole; only their ratios matter.

use crate::evaluate::Method;
use std::cell::Cell;

/// The time of one sample.
pub const STREAMING: f64 = 3.0;
/// Calibrating the virtual bench.
pub const BENCH: f64 = 20.0;
/// A sweep that is drawn on the spot and tracked.
pub const SWEEP: f64 = 0.8;
/// The same on the virtual bench.
pub const ON_BENCH: f64 = 1.2;
/// A sweep of an ablation, already drawn.
pub const ABLATION: f64 = 0.5;

/// Cost of a sweep by a method.
pub fn cost(method: &Method<'_>) -> f64 {
    match method {
        Method::Network(..) => 0.5,
        Method::Bayes(..) => 2.0,
        Method::Static(..) => 0.1,
        Method::Constant(..) => 0.05,
    }
}

/// The parts of an evaluation, one after the other.
pub struct EvaluationProgress<'a> {
    progress: &'a dyn Fn(&str, f64),
    all: f64,
    done: Cell<f64>,
    now: Cell<f64>,
}

impl<'a> EvaluationProgress<'a> {
    /// Of `sweeps` sweeps by methods that cost `methods` together, and the tables that the arguments ask for.
    pub fn new(progress: &'a dyn Fn(&str, f64), sweeps: f64, methods: f64, tables: f64) -> Self {
        let all = sweeps * methods + STREAMING + tables;
        Self { progress, all, done: Cell::new(0.0), now: Cell::new(0.0) }
    }

    /// A part begins, and with it ends the one before.
    pub fn next(&self, stage: &str, cost: f64) {
        self.done.set(self.done.get() + self.now.replace(cost));
        (self.progress)(stage, (self.done.get() / self.all).min(0.99));
    }
}
