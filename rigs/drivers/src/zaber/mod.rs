//! Zaber stages: the ASCII protocol through `zproto`, the binary protocol of T-series units.

mod axis;
mod binary;
mod binary_line;
mod chain;
pub(crate) mod checksum;
pub(crate) mod flags;
mod mount;
mod open;
mod stage;
pub mod units;
pub mod wire;

use std::time::Duration;

pub use binary::ZaberBinary;
pub use binary_line::BinaryLine;
pub use chain::Chain;
pub(crate) use open::ZaberLines;
pub use stage::ZaberStage;
pub use wire::Port;

/// Longest wait for standstill after a stop.
const HALT: Duration = Duration::from_secs(3);
/// Pause between polls: the line carries some 500 questions a second.
const POLL: Duration = Duration::from_millis(5);
