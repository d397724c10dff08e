//! A trained network on disk: `model.safetensors` with the weights and `model.json`, the card that
//! says what it is. `wcal-lab train` writes both; the card tells more than what is read here: how
//! the network was trained, on what, and at which cost.

use crate::error::NetworkError;
use crate::filter::{BayesSettings, FILTER_RANGES, FilterBank};
use crate::inverse::{GRID_RANGES, InverseGrid, StaticInverse};
use crate::network::{NETWORK_RANGES, NetworkConfig, WhiskerNet};
use crate::sd_factors::SdFactors;
use crate::tracker::Tracker;
use serde::{Deserialize, Serialize};
use std::path::Path;
use wcal_core::document::from_json;
use wcal_core::observation::{WHISKER_RANGES, WhiskerSpec};
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges::Range;

/// Version of the card.
pub const FORMAT: &str = "wcal-model/1";
/// Weights of a network.
pub const WEIGHTS: &str = "model.safetensors";
/// What they are.
pub const CARD: &str = "model.json";

/// Numbers of a card itself.
pub const CARD_RANGES: &[Range] = &[
    Range::real("sd_factors", 0.0, 1e6),
    Range::real("at_mm", 0.0, 1e6),
    Range::real("factors", 0.0, 1e6),
    Range::real("training.time_factor", 1e-3, 1e3),
    Range::real("training.noise_nmm", 0.0, 1e3),
];
/// Everything else tells how the network came to be: counts, losses, seconds.
pub const OTHER_RANGES: &[Range] = &[Range::real("", -1e18, 1e18)];

/// What a model is, as far as a tracker needs it.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Card {
    /// Format and version.
    pub format: String,
    /// Always true: it has seen simulated sweeps only.
    pub trained_on_simulation: bool,
    /// SHA-256 of `model.safetensors`.
    pub weights_sha256: String,
    /// Sizes.
    pub network: NetworkConfig,
    /// Curve of solutions.
    pub inverse: InverseGrid,
    /// Whisker of the sweeps.
    pub whisker: WhiskerSpec,
    /// Factors on the stated standard deviations, base's speed not known, and known: from held-out
    /// objects under wires that are not quite the declared one, with friction, weight, noise, drift
    /// and errors of the gains, by the network's own spread.
    pub sd_on_bench: [SdFactors; 2],
    /// What of its training says where it may be used.
    pub training: TrainedOn,
}

/// The motion that a network was trained on, and the filters below it.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct TrainedOn {
    /// Bounds of the factor on time (the wire is quasi-static: a faster sweep is the same one in
    /// less time).
    pub time_factor: [f64; 2],
    /// What the filter below the network assumes.
    pub filter: BayesSettings,
    /// A second one, which the network weighs against it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub filter_frictionless: Option<BayesSettings>,
}

impl TrainedOn {
    /// The filters below the network.
    pub fn filters(&self) -> FilterBank {
        FilterBank {
            frictional: self.filter,
            frictionless: self.filter_frictionless,
        }
    }

    /// Speeds of the base along its +z in training, mm/s: those of the sweeps, stretched in time.
    pub fn speed_mm_s(&self) -> [f64; 2] {
        // A sweep that takes longer by a factor is slower by it.
        let ([low, high], [short, long]) = (self.filter.speed_mm_s, self.time_factor);
        [low / long, high / short]
    }
}

/// Reads a model's card, which is checked against the weights; the network is not made.
///
/// # Errors
/// Where a file is missing, truncated, of another version, or differs from the card.
pub fn read_card(folder: &Path) -> Result<Card, NetworkError> {
    Ok(read_files(folder)?.0)
}

/// Card and weights.
fn read_files(folder: &Path) -> Result<(Card, Vec<u8>), NetworkError> {
    let path = folder.join(CARD);
    let text = wcal_core::files::read_text(&path)?;
    let ranges = [
        CARD_RANGES,
        NETWORK_RANGES,
        GRID_RANGES,
        FILTER_RANGES,
        WHISKER_RANGES,
        OTHER_RANGES,
    ];
    let card: Card =
        from_json(&text, FORMAT, &ranges).map_err(NetworkError::file("reading", &path))?;
    let filters = card.training.filters();
    let checked = card.network.check();
    let checked = checked.and_then(|()| card.network.check_filters(&filters));
    checked.map_err(NetworkError::file("reading", &path))?;
    let checked = card.whisker.check();
    checked.map_err(NetworkError::file("reading", &path))?;
    let weights = folder.join(WEIGHTS);
    let bytes = wcal_core::files::read(&weights)?;
    let found = sha256_hex(&bytes);
    if found != card.weights_sha256 {
        let what = format!("{}: SHA-256", weights.display());
        return Err(NetworkError::value(what, card.weights_sha256, found));
    }
    Ok((card, bytes))
}

/// Reads a model; its card is checked against the weights. Regions are stated with the factors of a
/// bench.
///
/// # Errors
/// Where a file is missing, truncated, of another version, or differs from the card.
pub fn load(folder: &Path) -> Result<(Tracker, Card), NetworkError> {
    let (card, bytes) = read_files(folder)?;
    let weights = folder.join(WEIGHTS);
    let net =
        WhiskerNet::read(&card.network, &bytes).map_err(NetworkError::file("reading", &weights))?;
    let inverse = StaticInverse::new(&card.whisker, card.inverse)?;
    let tracker = Tracker {
        config: card.network,
        net,
        inverse,
        filters: card.training.filters(),
        sd_factors: card.sd_on_bench.clone(),
    };
    tracker.check()?;
    Ok((tracker, card))
}
