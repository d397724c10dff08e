//! Everything that is known of a session after a stage: stages take it and add to it, nothing else carries state.

use super::session_model::SessionModel;
use crate::error::TraceError;
use crate::method::fit::Weights;
use crate::method::hypothesis::{Hypothesis, Rejection, SearchResult};
use crate::method::noise::{CORRELATED_GAIN, Noise};
use crate::method::omnibus::OmnibusTest;
use crate::method::options::Options;
use crate::method::search::Search;
use wcal_core::verify_document::WitnessTest;

/// What is known of a session.
pub struct Evidence<M> {
    /// Open readings, as the noise and the instrument make them.
    pub model: M,
    /// Settings of the search; the tails of the noise are those of the last round.
    pub options: Options,
    /// Noise under which the search is made.
    pub weights: Weights,
    /// Gain from which a part of the noise that is correlated in time is taken up.
    pub correlated_gain: f64,
    /// Explanations under that noise.
    pub search: Search,
    /// What independent readings would follow.
    pub plain_test: OmnibusTest,
    /// Nothing but rounding is left by the declared model: structure in it means nothing.
    pub exact: bool,
    /// What each witness says of each hypothesis.
    pub tests: Vec<WitnessTest>,
    /// Effects that a witness refutes.
    pub refuted: Vec<String>,
    /// Explanations that a witness refutes.
    pub rejections: Vec<Rejection>,
}

/// The search, its rivals and the noise of both models, when nothing changes any more.
pub struct Explained {
    /// Search under the final noise.
    pub found: SearchResult,
    /// Noise of the accepted model's residuals.
    pub noise: Noise,
    /// Noise of the declared model's residuals.
    pub declared_noise: Noise,
    /// Nothing but rounding is left by the declared model: structure in it means nothing.
    pub exact: bool,
    /// What each witness says of each hypothesis.
    pub tests: Vec<WitnessTest>,
}

impl<M: SessionModel> Evidence<M> {
    /// Nothing but the declared model under independent readings.
    ///
    /// # Errors
    /// Where it has no solution at the readings.
    pub fn new(model: M, options: Options) -> Result<Self, TraceError> {
        let weights = independent(&model);
        let search = Search::new(&model, &weights, &options).ok_or(TraceError::NoSolution)?;
        let (plain_test, correlated_gain) = (search.first_test.clone(), CORRELATED_GAIN);
        Ok(Self {
            model,
            options,
            weights,
            correlated_gain,
            search,
            plain_test,
            exact: false,
            tests: Vec::new(),
            refuted: Vec::new(),
            rejections: Vec::new(),
        })
    }

    /// Begins anew under `weights`; false where the declared model has no solution then, and everything stays.
    pub(super) fn restart(&mut self, weights: Weights) -> bool {
        let search = Search::new(&self.model, &weights, &self.options);
        let Some(search) = search else { return false };
        (self.weights, self.search) = (weights, search);
        true
    }

    /// Identifiers of an explanation's terms.
    pub fn names(&self, h: &Hypothesis) -> Vec<String> {
        h.fit.terms.iter().map(|t| self.model.catalogue()[t.effect].id.to_owned()).collect()
    }
}

/// Readings that share nothing, each as good as it is known to be.
pub(super) fn independent<M: SessionModel>(model: &M) -> Weights {
    Weights::independent(model.noise_inputs().own(0.0))
}
