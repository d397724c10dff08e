//! Zaber stages: the ASCII protocol through `zproto`, the binary protocol of T-series units.

pub mod binary;
pub mod chain;
pub mod checksum;
pub mod flags;
pub mod stage;
pub mod units;
pub mod wire;

pub use binary::ZaberBinary;
pub use chain::Chain;
pub use stage::ZaberStage;
pub use wire::Port;
