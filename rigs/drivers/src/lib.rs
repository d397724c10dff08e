//! Devices of a whisker bench: stage, interrogators and cameras, real and virtual.
//!
//! What is known of each device, what is assumed, and the test that pins it: `firmware-notes/`.

pub mod bench;
pub mod cameras;
mod host;
pub mod hyperion;
mod link;
pub mod open;
pub mod sm130;
mod trouble;
pub mod zaber;

pub use open::Drivers;
