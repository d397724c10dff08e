//! Hyperion (si155): commands, and peaks streamed on a port of their own.
//!
//! Layout: firmware-notes/hyperion.md.

pub mod client;
pub mod frame;

pub use client::Hyperion;
