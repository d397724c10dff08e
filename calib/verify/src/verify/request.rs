//! A request to `verify`.

use crate::method::options::Options;
use wcal_core::Ledger;

/// A request to verify a session.
#[derive(Clone, Default)]
pub struct VerifyRequest {
    /// Settings of the search.
    pub search: Options,
    /// Effects of a surviving explanation to be accepted; empty leaves the choice to the verdict.
    pub accept: Vec<String>,
    /// Hashes of calibrations that are judged on the sealed readings, too.
    pub claims: Vec<String>,
    /// Where it is written down that the holdout is opened.
    pub ledger: Ledger,
}
