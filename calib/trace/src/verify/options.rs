//! Settings of `verify`.

use crate::method::options::Options;
use wcal_core::Seal;

/// Settings of `verify`.
#[derive(Clone, Default)]
pub struct VerifyOptions {
    /// Settings of the search.
    pub search: Options,
    /// Effects of a surviving explanation to be accepted; empty leaves the choice to the verdict.
    pub accept: Vec<String>,
    /// Effects that another measurement of the instrument refutes: they are not searched for.
    pub refuted: Vec<String>,
    /// What is known of the sealed files.
    pub seal: Seal,
}
