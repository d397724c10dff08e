//! Two cameras from pairs of pictures of a board, and the files in which they are kept and
//! exchanged.
//!
//! In the order of the work: corners ([`chessboard`], [`corner`], or [`markers`]), one camera alone
//! (`initial`), both together ([`bundle`], [`solution`]), what may be wrong (`checks`,
//! `statements`), the document ([`document`], [`export`], [`import`]).

mod alternatives;
pub mod board;
pub mod bundle;
mod checks;
pub mod chessboard;
pub mod corner;
pub mod document;
pub mod export;
pub mod folders;
pub mod import;
pub(crate) mod initial;
pub mod markers;
mod noise;
pub mod solution;
mod statements;
mod views;
