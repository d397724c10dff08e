//! What `wcal-session` promises, through its public interface.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

use wcal_core::{Decide, Ledger, Sealed};

/// The rows behind a seal.
fn opened<R: Clone>(sealed: Sealed<R>) -> Vec<R> {
    /// Nothing is decided: the rows are looked at.
    struct Undecided;
    impl Decide for Undecided {
        fn content(&self) -> serde_json::Value {
            serde_json::Value::Null
        }
    }
    sealed
        .unseal(Undecided, &Ledger::default())
        .unwrap()
        .assess(|_, rows, _| rows.to_vec())
        .1
}

mod bad_input;
mod broken;
mod fixtures;
mod looks;
mod shapes;
mod sheets;
mod writing;
