//! What the repository says of itself is true: README and pages, schemas, layers, versions,
//! licences.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod docs;
mod file_circles;
mod keeps_time;
mod layering;
mod readme;
mod results;
mod schemas;
mod stated_versions;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;
mod third_party;
