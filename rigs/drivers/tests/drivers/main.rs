//! What `wcal-drivers` promises, through its public interface.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod cantilever;
mod common;
mod limits_property;
mod odd_numbers;
mod tap;
mod tapped;
/// `make test` runs these before all others in the machine's favour, and those beside them with
/// `--skip keeps_time::`.
#[path = "."]
mod keeps_time {
    mod corpus;
    mod faults;
    mod fuzz_short;
    mod interrogators;
    mod kept_safe;
    mod stage;
    mod sweep;
    mod vendor_client;
}
