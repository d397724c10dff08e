//! Settings of the search.

/// Settings of the loop.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Seed of every draw.
    pub seed: u64,
    /// Null draws a family.
    pub draws: usize,
    /// Largest number of effects in one explanation.
    pub largest: usize,
    /// Degrees of freedom of the noise's tails (Student's t) where they are heavier than a Gaussian's.
    pub tails_dof: Option<f64>,
}

impl Default for Options {
    fn default() -> Self {
        Self { seed: 1, draws: 2000, largest: 3, tails_dof: None }
    }
}
