//! The wire in the pictures: found by a beam search in space, measured in short pieces across its
//! image.

pub mod appearance;
mod bar;
pub(crate) mod beam;
pub mod piece;
pub mod ridge;
pub mod scene;
pub(crate) mod search;
pub mod tip;
