//! The exam's orders and scores.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that fails should say where"
)]

mod orders;
mod scores;
