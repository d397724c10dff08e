//! Devices of a whisker bench: stage, interrogators and cameras, real, virtual and replayed.
//!
//! What is known of each device, what is assumed, and the test that pins it: `firmware-notes/`.

pub mod bench;
pub mod bench_files;
pub mod cameras;
pub mod host;
pub mod hyperion;
pub mod record;
pub mod replay;
pub mod sm130;
pub mod zaber;

pub use host::HostClock;
