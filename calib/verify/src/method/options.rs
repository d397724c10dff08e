//! Settings of the search.

use std::sync::Arc;

/// Hears the stage that a search is in, and the part of it that is done, 0 to 1.
type Heard = dyn Fn(&str, f64) + Send + Sync;

/// Who waits for a search.
#[derive(Clone, Default)]
pub struct ProgressListener(Option<Arc<Heard>>);

impl ProgressListener {
    /// Calls `heard` with the name of the stage and the part that is done, 0 to 1.
    pub fn new(heard: impl Fn(&str, f64) + Send + Sync + 'static) -> Self {
        Self(Some(Arc::new(heard)))
    }

    pub(crate) fn at(&self, stage: &str, done: f64) {
        if let Some(heard) = &self.0 {
            heard(stage, done);
        }
    }
}

/// Settings of the loop.
#[derive(Clone)]
pub struct Options {
    /// Seed of every draw.
    pub seed: u64,
    /// Null draws a family.
    pub draws: usize,
    /// Largest number of effects in one explanation.
    pub largest: usize,
    /// Degrees of freedom of the noise's tails (Student's t) where they are heavier than a
    /// Gaussian's.
    pub tails_dof: Option<f64>,
    /// Hears how far the search is.
    pub progress: ProgressListener,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            draws: 2000,
            largest: 3,
            tails_dof: None,
            progress: ProgressListener::default(),
        }
    }
}
