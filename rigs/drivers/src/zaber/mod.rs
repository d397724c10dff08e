//! Zaber stages: the ASCII protocol through `zproto`, the binary protocol of T-series units.

pub mod checksum;
pub mod units;
