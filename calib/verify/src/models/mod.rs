//! The kinds of session: each with its forward model, its catalogue of effects and its words.

pub mod scalar;
pub mod whisker;
