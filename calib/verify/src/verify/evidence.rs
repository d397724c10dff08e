//! Everything that is known of a session after a stage: stages take it and add to it, nothing else
//! carries state.

use super::session_model::SessionModel;
use crate::error::VerifyError;
use crate::method::fit::Weights;
use crate::method::hypothesis::Rejection;
use crate::method::noise::correlated_gain;
use crate::method::omnibus::OmnibusTest;
use crate::method::options::Options;
use crate::method::search::Search;
use wcal_core::verify_document::WitnessTest;

/// Searches at most: each is made under the noise and the instrument that the one before shows.
pub(crate) const MAX_ROUNDS: usize = 5;

/// What is known of a session.
pub(crate) struct Evidence<M> {
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
    /// Searches that were made.
    pub rounds: usize,
    /// Nothing but rounding remains by the declared model: structure in it means nothing.
    pub exact: bool,
    /// What each witness says of each hypothesis.
    pub tests: Vec<WitnessTest>,
    /// Effects that a witness refutes.
    pub refuted: Vec<String>,
    /// Explanations that a witness refutes.
    pub rejections: Vec<Rejection>,
}

impl<M: SessionModel> Evidence<M> {
    /// Nothing but the declared model under independent readings.
    ///
    /// # Errors
    /// Where it has no solution at the readings.
    pub(crate) fn new(model: M, options: Options) -> Result<Self, VerifyError> {
        let weights = independent(&model);
        let search = Search::new(&model, &weights, &options).ok_or(VerifyError::NoSolution)?;
        let (plain_test, correlated_gain) = (search.found.first_test.clone(), correlated_gain());
        Ok(Self {
            model,
            options,
            weights,
            correlated_gain,
            search,
            plain_test,
            rounds: 0,
            exact: false,
            tests: Vec::new(),
            refuted: Vec::new(),
            rejections: Vec::new(),
        })
    }

    /// Begins anew with another model, of whose noise nothing is known; false where its declared
    /// model has no solution, and everything stays.
    pub(super) fn begin_anew(&mut self, model: M) -> bool {
        let weights = independent(&model);
        let (before, tails) = (
            std::mem::replace(&mut self.model, model),
            self.options.tails_dof.take(),
        );
        let done = self.restart(weights);
        if done {
            self.correlated_gain = correlated_gain();
        } else {
            (self.model, self.options.tails_dof) = (before, tails);
        }
        done
    }

    /// Begins anew under `weights`; false where the declared model has no solution then, and
    /// everything stays.
    pub(super) fn restart(&mut self, weights: Weights) -> bool {
        let search = Search::new(&self.model, &weights, &self.options);
        let Some(search) = search else { return false };
        (self.weights, self.search) = (weights, search);
        true
    }
}

/// Readings that share nothing, each as good as it is known to be.
pub(super) fn independent(model: &impl SessionModel) -> Weights {
    Weights::independent(model.noise_inputs().own(0.0))
}
