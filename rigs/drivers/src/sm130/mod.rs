//! Micron Optics sm130 (x30 core): command replies and streamed frames over TCP.
//!
//! Layout and the places where sources disagree: firmware-notes/sm130.md.

pub mod client;
pub mod frame;
pub mod stream;

pub use client::Sm130;
