//! What the stages before the decision found.

use crate::method::noise::Noise;
use crate::method::search_result::SearchResult;
use wcal_core::verify_document::WitnessTest;

/// The search, its rivals and the noise of both models, when nothing changes any more.
pub struct Explained {
    /// Search under the final noise.
    pub found: SearchResult,
    /// Noise of the accepted model's residuals.
    pub noise: Noise,
    /// Noise of the declared model's residuals.
    pub declared_noise: Noise,
    /// Nothing but rounding remains by the declared model: structure in it means nothing.
    pub exact: bool,
    /// What each witness says of each hypothesis.
    pub tests: Vec<WitnessTest>,
}
