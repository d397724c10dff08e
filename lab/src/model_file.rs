//! What a training writes: `model.safetensors` with the weights and `model.json`, the card that
//! says what it is and what made it. `wcal_network::model_file` reads what a tracker needs of it.

use crate::LabError;
use crate::network::TrainableNet;
use crate::train::settings::{Pass, TRAINING_RANGES, TrainSettings};
use crate::train_model::cost::TrainingCost;
use burn::store::{ModuleSnapshot, SafetensorsStore};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::document::from_json;
use wcal_core::files::write_atomic;
use wcal_core::observation::{WHISKER_RANGES, WhiskerSpec};
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges::Range;
use wcal_network::Tracker;
use wcal_network::filter::FILTER_RANGES;
use wcal_network::inverse::{GRID_RANGES, InverseGrid, StaticInverse};
use wcal_network::model_file::{CARD, CARD_RANGES, FORMAT, OTHER_RANGES, WEIGHTS};
use wcal_network::network::{FeatureExtractor, NETWORK_RANGES, NetworkConfig, WhiskerNet, knots};
use wcal_network::sd_factors::SdFactors;

/// Numbers of a card that tell how it was trained.
const RANGES: &[Range] = &[
    Range::whole("objects", 0.0, 1e9),
    Range::whole("epoch", 0.0, 1e9),
    Range::whole("cores", 0.0, 1e6),
    Range::whole("sweeps_trained", 0.0, 1e15),
];

/// What a model is and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Card {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    pub format: String,
    /// Always true: the network has seen simulated sweeps only.
    #[schemars(extend("const" = true))]
    pub trained_on_simulation: bool,
    /// SHA-256 of `model.safetensors`.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub weights_sha256: String,
    /// Sizes.
    pub network: NetworkConfig,
    /// Curve of solutions.
    pub inverse: InverseGrid,
    /// Whisker of the sweeps.
    pub whisker: WhiskerSpec,
    /// Factors on the stated standard deviations, from objects that were held out: base's speed not
    /// known, and known.
    pub sd_factors: [f64; 2],
    /// The same as a bench has it: held-out objects under wires that are not quite the declared
    /// one, with friction, weight, noise, drift and errors of the gains, by the network's own
    /// spread. A stream's regions are stated with them.
    pub sd_on_bench: [SdFactors; 2],
    /// How it was trained.
    pub training: TrainSettings,
    /// Learning curve.
    pub passes: Vec<Pass>,
    /// Objects trained on, held out for the early stop and the spread, and kept for the evaluation.
    pub objects: Split,
    /// SHA-256 of what each object's sweeps follow from.
    pub data: BTreeMap<String, String>,
    /// The same of each folder of other sweeps (friction, weight, ...) that were trained on as
    /// well.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub data_beside: Vec<BTreeMap<String, String>>,
    /// SHA-256 of the weights that the training began with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub began_with: Option<String>,
    /// Sweeps over an object that were trained on: those from here on are kept for the evaluation
    /// of seen objects.
    pub sweeps_trained: u64,
    /// The command that made it, as it was typed; models of before 2026-11-25 have neither this nor
    /// the cost.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub command: Vec<String>,
    /// What it took to make.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<TrainingCost>,
}

impl Card {
    /// Whether a sweep over an object that was trained on was kept back for the evaluation.
    pub fn kept_back(&self, sweep: u64) -> bool {
        sweep >= self.sweeps_trained
    }
}

/// Objects by their use.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct Split {
    /// Trained on.
    pub training: Vec<String>,
    /// Early stop and spread.
    pub held_out: Vec<String>,
    /// Not used in training.
    pub unseen: Vec<String>,
}

impl Split {
    /// Draws how many objects to hold out and to keep unseen; the rest is trained on.
    ///
    /// # Errors
    /// Where none is left to train on, or none is held out.
    pub fn draw(
        mut names: Vec<String>,
        [held_out, unseen]: [usize; 2],
        seed: u64,
    ) -> Result<Self, LabError> {
        if held_out == 0 || held_out + unseen >= names.len() {
            let found = format!("{held_out} held out and {unseen} unseen of {}", names.len());
            return Err(LabError::value(
                "objects",
                "1 or more held out and 1 or more left to train on",
                found,
            ));
        }
        names.shuffle(&mut ChaCha8Rng::seed_from_u64(seed));
        let mut training = names.split_off(held_out + unseen);
        let mut unseen = names.split_off(held_out);
        for part in [&mut training, &mut unseen, &mut names] {
            part.sort_unstable();
        }
        Ok(Self {
            training,
            held_out: names,
            unseen,
        })
    }
}

/// The network as a tracker runs it, with the bytes of its file.
///
/// # Errors
/// Where the weights cannot be written, or one is not finite.
pub fn runnable(
    net: &TrainableNet,
    config: &NetworkConfig,
) -> Result<(WhiskerNet, Vec<u8>), LabError> {
    let unwritten = |e: String| LabError::value("weights", "a network that can be written", e);
    // Several entries come in any order: the same weights would have several hashes.
    let mut store = SafetensorsStore::from_bytes(None)
        .clear_metadata()
        .metadata("producer", "wcal");
    net.save_into(&mut store)
        .map_err(|e| unwritten(e.to_string()))?;
    let bytes = store.get_bytes().map_err(|e| unwritten(e.to_string()))?;
    Ok((WhiskerNet::read(config, &bytes)?, bytes))
}

/// Writes weights and card into a folder; the card last.
///
/// # Errors
/// Where a file cannot be written.
pub fn save(folder: &Path, net: &TrainableNet, card: &mut Card) -> Result<(), LabError> {
    std::fs::create_dir_all(folder).map_err(LabError::file("creating", folder))?;
    let (_, bytes) = runnable(net, &card.network)?;
    write_atomic(&folder.join(WEIGHTS), &bytes)?;
    card.weights_sha256 = sha256_hex(&bytes);
    let path = folder.join(CARD);
    let text = serde_json::to_string_pretty(card).map_err(LabError::file("writing", &path))?;
    Ok(write_atomic(&path, text.as_bytes())?)
}

/// Reads a model's whole card.
///
/// # Errors
/// Where a file is missing, of another version, or differs from the weights.
pub fn read_card(folder: &Path) -> Result<Card, LabError> {
    wcal_network::model_file::read_card(folder)?;
    let path = folder.join(CARD);
    let text = wcal_core::files::read_text(&path)?;
    let ranges = [
        TRAINING_RANGES,
        RANGES,
        CARD_RANGES,
        NETWORK_RANGES,
        GRID_RANGES,
        FILTER_RANGES,
        WHISKER_RANGES,
        OTHER_RANGES,
    ];
    from_json(&text, FORMAT, &ranges).map_err(LabError::file("reading", &path))
}

/// Reads a model with its whole card; regions are stated with the factors of sweeps as it was
/// trained on.
///
/// # Errors
/// Where a file is missing, truncated, of another version, or differs from the card.
pub fn load(folder: &Path) -> Result<(Tracker, Card), LabError> {
    let card = read_card(folder)?;
    let (mut tracker, _) = wcal_network::model_file::load(folder)?;
    tracker.sd_factors = card.sd_factors.map(SdFactors::constant);
    Ok((tracker, card))
}

/// Puts the weights of a model into a network of the same sizes; gives the first 64 bits of their
/// hash.
///
/// # Errors
/// Where the model cannot be read or has other sizes.
pub fn put_weights(net: &mut TrainableNet, folder: &Path) -> Result<u64, LabError> {
    let card = read_card(folder)?;
    let weights = folder.join(WEIGHTS);
    let bytes = wcal_core::files::read(&weights)?;
    let mut store = SafetensorsStore::from_bytes(Some(bytes));
    net.load_from(&mut store)
        .map_err(LabError::file("reading", &weights))?;
    let first = card
        .weights_sha256
        .get(..16)
        .and_then(|hex| u64::from_str_radix(hex, 16).ok());
    first.ok_or_else(|| {
        let what = format!("{}: weights_sha256", folder.join(CARD).display());
        LabError::value(what, "64 hexadecimal digits", &card.weights_sha256)
    })
}

/// Grid of the curve that the networks are built on: a node every half millimetre.
pub fn network_grid() -> InverseGrid {
    InverseGrid {
        step_mm: 1.0,
        refine: 2,
        tilts: 8,
        ..InverseGrid::default()
    }
}

/// The paper's network (six layers, eight heads, width 128, 512, encoder 64, dropout 0.1).
pub fn paper(inputs: usize) -> NetworkConfig {
    NetworkConfig {
        inputs,
        nodes: 0,
        encoder: 64,
        layers: 6,
        heads: 8,
        width: 128,
        feed_forward: 512,
        dropout: 0.1,
        context: 128,
        two_filters: false,
    }
}

/// A network on a curve of `nodes` knots, by one filter or two: 101 thousand parameters on 33 knots
/// with two.
pub fn compact(inputs: usize, nodes: usize, two_filters: bool) -> NetworkConfig {
    NetworkConfig {
        inputs,
        nodes,
        encoder: 80,
        layers: 2,
        heads: 4,
        width: 64,
        feed_forward: 144,
        dropout: 0.0,
        context: 128,
        two_filters,
    }
}

/// Sizes of a preset on a curve; the compact one weighs two filters.
///
/// # Errors
/// Names the presets.
pub fn preset(
    name: &str,
    inverse: &StaticInverse,
    two_filters: bool,
) -> Result<NetworkConfig, LabError> {
    let nodes = inverse.nodes.len();
    match name {
        "compact" => {
            let inputs = FeatureExtractor::width(nodes, two_filters);
            Ok(compact(inputs, knots(nodes).len(), two_filters))
        }
        "paper" => Ok(paper(FeatureExtractor::width(nodes, false))),
        _ => Err(LabError::value("preset", "compact or paper", name)),
    }
}
