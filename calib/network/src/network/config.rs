//! Sizes of the network.

use crate::error::NetworkError;
use crate::filter::FilterBank;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::ranges::Range;

/// Inputs that do not belong to a node; they come first.
pub(crate) const COMMON_INPUTS: usize = 9;
/// Scale of a place that comes out of the network as it is, mm.
pub const PLACE_SCALE_MM: f64 = 30.0;

/// Size and kind of the network.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Inputs of a token.
    pub inputs: usize,
    /// Knots on the static inverse's curve; 0: the place itself comes out (the paper's head).
    pub nodes: usize,
    /// Hidden width of the encoder.
    pub encoder: usize,
    /// Layers, heads, width and hidden width of the feed-forward part.
    pub layers: usize,
    /// Heads.
    pub heads: usize,
    /// Width.
    pub width: usize,
    /// Hidden width of the feed-forward part.
    pub feed_forward: usize,
    /// Dropout.
    pub dropout: f64,
    /// Tokens in the context of an answer, its own included.
    pub context: usize,
    /// Whether there is a second filter below it, which it weighs against the first.
    #[serde(default)]
    pub two_filters: bool,
}

/// Numbers that a configuration may state.
pub const NETWORK_RANGES: &[Range] = &[
    Range::whole("network.inputs", 1.0, 65_536.0),
    Range::whole("network.nodes", 0.0, 4096.0),
    Range::whole("network.encoder", 1.0, 4096.0),
    Range::whole("network.layers", 1.0, 64.0),
    Range::whole("network.heads", 1.0, 64.0),
    Range::whole("network.width", 1.0, 4096.0),
    Range::whole("network.feed_forward", 1.0, 16_384.0),
    Range::real("network.dropout", 0.0, 0.99),
    Range::whole("network.context", 2.0, 8192.0),
];
/// The paper's network has 1.2 million, and the largest here is tried in days.
const MAX_PARAMETERS: usize = 20_000_000;

impl NetworkConfig {
    /// # Errors
    /// Where the sizes do not fit each other.
    pub fn check(&self) -> Result<(), NetworkError> {
        let sizes = [
            self.inputs,
            self.encoder,
            self.layers,
            self.heads,
            self.width,
            self.feed_forward,
        ];
        if sizes.contains(&0) || self.context < 2 || !self.width.is_multiple_of(self.heads) {
            return Err(NetworkError::value(
                "network",
                "sizes above 0, width a multiple of heads",
                format!("{self:?}"),
            ));
        }
        let parameters = self.parameters();
        if parameters > MAX_PARAMETERS {
            let expected = format!("sizes that make at most {MAX_PARAMETERS} parameters");
            return Err(NetworkError::value(
                "network",
                expected,
                format!("about {parameters}"),
            ));
        }
        Ok(())
    }

    /// Parameters, biases and norms left out.
    fn parameters(&self) -> usize {
        // w^2 each for queries, keys, values and the output, w f twice for the feed-forward.
        let layer = self.width * (4 * self.width + 2 * self.feed_forward);
        self.encoder * (self.inputs + self.width)
            + self.layers * layer
            + self.width * self.outputs()
    }

    /// # Errors
    /// Where it weights two filters and there is one, or the reverse.
    pub fn check_filters(&self, filters: &FilterBank) -> Result<(), NetworkError> {
        let found = filters.frictionless.is_some();
        if self.two_filters != found {
            let count = |two: bool| if two { "two" } else { "one" };
            let expected = format!("{}, as the network weighs", count(self.two_filters));
            let what = "training: filters below the network";
            return Err(NetworkError::value(what, expected, count(found)));
        }
        Ok(())
    }

    /// Numbers that come out for a token: logarithms of factors at the knots, a place (or what is
    /// off it), contact, several contacts, and with knots the doubt in the filter, and with two of
    /// them the logarithm of the odds of the second.
    pub fn outputs(&self) -> usize {
        let with_knots = if self.nodes > 0 {
            1 + usize::from(self.two_filters)
        } else {
            0
        };
        self.nodes + 3 + 2 + with_knots
    }
}
