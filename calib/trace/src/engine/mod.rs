//! The engine shared by every kind of session: fit, screen, refit, compare. It knows systems and candidates, not whiskers.

pub mod atoms;
mod cone;
pub mod drivers;
pub mod explain;
pub mod fit;
pub mod gate;
pub mod inference;
pub mod lack_of_fit;
pub mod lasso;
pub mod linear;
pub mod noise;
pub mod noise_parts;
pub mod null;
pub mod outliers;
mod refine;
pub mod rivalry;
pub mod search;
pub mod share;
pub mod spread;
pub mod subsets;
pub mod tails;
