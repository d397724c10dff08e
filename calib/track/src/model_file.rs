//! A trained network on disk: `model.safetensors` with the weights and `model.json`, the card that says what it is and what made it.

use crate::classes::{ClassSpread, ObjectClasses};
use crate::error::TrackError;
use crate::filter::FILTER_RANGES;
use crate::inverse::{GRID_RANGES, InverseGrid, StaticInverse};
use crate::network::{FeatureExtractor, NETWORK_RANGES, NetworkConfig, WhiskerNet, knots};
use crate::sd_factors::SdFactors;
use crate::tracker::Tracker;
use crate::train::settings::{Pass, TRAINING_RANGES, TrainSettings};
use crate::train_model::cost::TrainingCost;
use burn::store::{ModuleSnapshot, SafetensorsStore};
use burn::tensor::Device;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::document::from_json;
use wcal_core::files::{FileError, write_atomic};
use wcal_core::observation::{WHISKER_RANGES, WhiskerSpec};
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges::Range;

/// Version of the card.
pub const FORMAT: &str = "wcal-model/1";

/// Numbers of a card itself: factors on standard deviations, and the maps of probabilities.
const RANGES: &[Range] = &[
    Range::real("sd_factors", 0.0, 1e6),
    Range::whole("objects", 0.0, 1e9),
    Range::whole("epoch", 0.0, 1e9),
    Range::whole("cores", 0.0, 1e6),
    Range::whole("sweeps_trained", 0.0, 1e15),
    Range::real("at_mm", 0.0, 1e6),
    Range::real("factors", 0.0, 1e6),
    Range::real("several_maps.slope", -1e6, 1e6),
    Range::real("several_maps.offset", -1e6, 1e6),
];
/// Everything else tells how the network came to be: counts, losses, seconds.
const REST: &[Range] = &[Range::real("", -1e18, 1e18)];

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
    /// Factors on the stated standard deviations, from objects that were held out: base's speed not known, and known.
    pub sd_factors: [f64; 2],
    /// The same as a bench has it: held-out objects under wires that are not quite the declared one, with friction, weight, noise, drift and
    /// errors of the gains, by the network's own spread. A stream's regions are stated with them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sd_on_bench: Option<[SdFactors; 2]>,
    /// Factors by class of object.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub sd_factors_by_class: BTreeMap<String, ClassSpread>,
    /// Class of each object, where it was stated.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub object_classes: ObjectClasses,
    /// How it was trained.
    pub training: TrainSettings,
    /// Learning curve.
    pub passes: Vec<Pass>,
    /// Objects trained on, held out for the early stop and the spread, and kept for the evaluation.
    pub objects: Split,
    /// SHA-256 of what each object's sweeps follow from.
    pub data: BTreeMap<String, String>,
    /// The same of each folder of other sweeps (friction, weight, ...) that were trained on as well.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub data_beside: Vec<BTreeMap<String, String>>,
    /// SHA-256 of the weights that the training began with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub began_with: Option<String>,
    /// Sweeps over an object that were trained on: those from here on are kept for the evaluation of seen objects.
    pub sweeps_trained: u64,
    /// What was split.
    #[serde(default)]
    pub split: SplitBy,
    /// The command that made it, as it was typed; models of before 2026-11-25 have neither this nor the cost.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub command: Vec<String>,
    /// What it took to make.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<TrainingCost>,
}

/// What is split into training, early stop and test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SplitBy {
    /// Whole objects: the test's are never seen.
    #[default]
    Objects,
    /// Sweeps at random, as in the paper: other sweeps over the test's objects are trained on. Objects that are kept unseen show what that hides.
    Sweeps,
}

/// Use of a sweep in a random split.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SweepUse {
    /// Trained on.
    Training,
    /// Early stop and spread.
    HeldOut,
    /// Scored as seen.
    Test,
}

/// Shares of a random split (the paper: 20 % for the test).
const TEST: f64 = 0.2;
const HELD_OUT: f64 = 0.1;

impl SweepUse {
    /// Draws it for a sweep over an object.
    #[must_use]
    pub fn draw(object: &str, sweep: u64, seed: u64) -> Self {
        let digest = sha256_hex(format!("{object}/{sweep}/{seed}").as_bytes());
        let lot = u32::from_str_radix(&digest[..8], 16).map_or(0.0, |n| f64::from(n) / f64::from(u32::MAX));
        match lot {
            lot if lot < TEST => Self::Test,
            lot if lot < TEST + HELD_OUT => Self::HeldOut,
            _ => Self::Training,
        }
    }
}

impl Card {
    /// Factors on the stated standard deviations of a real sensor's stream: those of a bench where the card has them.
    #[must_use]
    pub fn sd_factors_of_stream(&self) -> [SdFactors; 2] {
        self.sd_on_bench.clone().unwrap_or_else(|| self.sd_factors.map(SdFactors::constant))
    }

    /// Whether a sweep over an object that was trained on was kept back for the evaluation.
    #[must_use]
    pub fn kept_back(&self, object: &str, sweep: u64) -> bool {
        match self.split {
            SplitBy::Objects => sweep >= self.sweeps_trained,
            SplitBy::Sweeps => SweepUse::draw(object, sweep, self.training.seed) == SweepUse::Test,
        }
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
    ) -> Result<Self, TrackError> {
        if held_out == 0 || held_out + unseen >= names.len() {
            let found = format!("{held_out} held out and {unseen} unseen of {}", names.len());
            return Err(TrackError::value(
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
        Ok(Self { training, held_out: names, unseen })
    }
}

/// Writes weights and card into a folder; the card last.
///
/// # Errors
/// Where a file cannot be written.
pub fn save(folder: &Path, net: &WhiskerNet, card: &mut Card) -> Result<(), TrackError> {
    std::fs::create_dir_all(folder).map_err(TrackError::file("creating", folder))?;
    let refused =
        |e: FileError| TrackError::File { action: e.action, path: e.path, detail: e.source.to_string() };
    let weights = folder.join("model.safetensors");
    let part = folder.join("model.part.safetensors");
    // Several entries come in any order: the same weights would have several hashes.
    let mut store =
        SafetensorsStore::from_file(&part).clear_metadata().metadata("producer", "wcal").overwrite(true);
    net.save_into(&mut store).map_err(TrackError::file("writing", &weights))?;
    let bytes = wcal_core::files::read(&part).map_err(TrackError::file("reading", &part))?;
    write_atomic(&weights, &bytes).map_err(refused)?;
    std::fs::remove_file(&part).map_err(TrackError::file("removing", &part))?;
    card.weights_sha256 = sha256_hex(&bytes);
    let path = folder.join("model.json");
    let text = serde_json::to_string_pretty(card).map_err(TrackError::file("writing", &path))?;
    write_atomic(&path, text.as_bytes()).map_err(refused)
}

/// Reads a model's card, which is checked against the weights; the network is not made.
///
/// # Errors
/// Where a file is missing, truncated, of another version, or differs from the card.
pub fn read_card(folder: &Path) -> Result<Card, TrackError> {
    Ok(read_files(folder)?.0)
}

/// Card and weights.
fn read_files(folder: &Path) -> Result<(Card, Vec<u8>), TrackError> {
    let path = folder.join("model.json");
    let text = wcal_core::files::read_text(&path).map_err(TrackError::file("reading", &path))?;
    let ranges = [RANGES, NETWORK_RANGES, GRID_RANGES, TRAINING_RANGES, FILTER_RANGES, WHISKER_RANGES, REST];
    let card: Card = from_json(&text, FORMAT, &ranges).map_err(TrackError::file("reading", &path))?;
    card.network.check().map_err(TrackError::file("reading", &path))?;
    card.whisker.check().map_err(TrackError::file("reading", &path))?;
    let filters = card.training.filters();
    if card.network.check_filters(&filters).is_err() {
        let count = |two: bool| if two { "two" } else { "one" };
        let what = format!("{}: training: filters below the network", path.display());
        let (expected, found) = (count(card.network.two_filters), count(filters.frictionless.is_some()));
        return Err(TrackError::value(what, format!("{expected}, as the network weighs"), found));
    }
    let weights = folder.join("model.safetensors");
    let bytes = wcal_core::files::read(&weights).map_err(TrackError::file("reading", &weights))?;
    let found = sha256_hex(&bytes);
    if found != card.weights_sha256 {
        let what = format!("{}: SHA-256", weights.display());
        return Err(TrackError::value(what, card.weights_sha256, found));
    }
    check_finite(&bytes).map_err(TrackError::file("reading", &weights))?;
    Ok((card, bytes))
}

/// Refuses weights that are no numbers: every answer would be none.
///
/// A safetensors file: the length of its header (u64), the header (JSON: name, type and place of each tensor), the numbers, all little-endian.
fn check_finite(bytes: &[u8]) -> Result<(), String> {
    let cut_off = "expected weights in the safetensors format, found a file that is cut off";
    let (length, rest) = bytes.split_first_chunk::<8>().ok_or(cut_off)?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| cut_off)?;
    let (header, numbers) = rest.split_at_checked(length).ok_or(cut_off)?;
    let header: serde_json::Value = serde_json::from_slice(header).map_err(|e| e.to_string())?;
    for (name, about) in header.as_object().ok_or(cut_off)?.iter().filter(|(name, _)| *name != "__metadata__")
    {
        if about["dtype"] != "F32" {
            return Err(format!("{name}: expected numbers of type F32, found {}", about["dtype"]));
        }
        let at = |k: usize| about["data_offsets"][k].as_u64().and_then(|at| usize::try_from(at).ok());
        let part = at(0).zip(at(1)).and_then(|(from, to)| numbers.get(from..to)).ok_or(cut_off)?;
        let finite = |four: &[u8]| f32::from_le_bytes([four[0], four[1], four[2], four[3]]).is_finite();
        if let Some(k) = part.chunks_exact(4).position(|four| !finite(four)) {
            return Err(format!("{name}, number {}: expected a finite weight, found NaN or infinity", k + 1));
        }
    }
    Ok(())
}

/// Reads a model; its card is checked against the weights.
///
/// # Errors
/// Where a file is missing, truncated, of another version, or differs from the card.
pub fn load(folder: &Path, device: &Device) -> Result<(Tracker, Card), TrackError> {
    let (card, bytes) = read_files(folder)?;
    let mut net = WhiskerNet::new(&card.network, device)?;
    fill(&mut net, folder, bytes)?;
    let inverse = StaticInverse::new(&card.whisker, card.inverse)?;
    let tracker = Tracker {
        config: card.network,
        net,
        inverse,
        filters: card.training.filters(),
        sd_factors: card.sd_factors.map(SdFactors::constant),
        device: device.clone(),
    };
    tracker.check()?;
    Ok((tracker, card))
}

fn fill(net: &mut WhiskerNet, folder: &Path, bytes: Vec<u8>) -> Result<(), TrackError> {
    let weights = folder.join("model.safetensors");
    let mut store = SafetensorsStore::from_bytes(Some(bytes));
    net.load_from(&mut store).map_err(TrackError::file("reading", &weights)).map(|_| ())
}

/// Puts the weights of a model into a network of the same sizes; gives the first 64 bits of their hash.
///
/// # Errors
/// Where the model cannot be read or has other sizes.
pub fn put_weights(net: &mut WhiskerNet, folder: &Path) -> Result<u64, TrackError> {
    let (card, bytes) = read_files(folder)?;
    fill(net, folder, bytes)?;
    let first = card.weights_sha256.get(..16).and_then(|hex| u64::from_str_radix(hex, 16).ok());
    first.ok_or_else(|| {
        let what = format!("{}: weights_sha256", folder.join("model.json").display());
        TrackError::value(what, "64 hexadecimal digits", &card.weights_sha256)
    })
}

/// Grid of the curve that the networks are built on: a node every half millimetre.
#[must_use]
pub fn network_grid() -> InverseGrid {
    InverseGrid { step_mm: 1.0, refine: 2, tilts: 8, ..InverseGrid::default() }
}

/// Sizes of a preset on a curve; the default one weighs two filters.
///
/// # Errors
/// Names the presets.
pub fn preset(name: &str, inverse: &StaticInverse, two_filters: bool) -> Result<NetworkConfig, TrackError> {
    let nodes = inverse.nodes.len();
    let on_curve = |sizes: fn(usize, usize, bool) -> NetworkConfig| {
        sizes(FeatureExtractor::width(nodes, two_filters), knots(nodes).len(), two_filters)
    };
    match name {
        "default" => Ok(on_curve(NetworkConfig::small)),
        "compact" => Ok(on_curve(NetworkConfig::compact)),
        "paper" => Ok(NetworkConfig::paper(FeatureExtractor::width(nodes, false))),
        "baseline" => Ok(NetworkConfig::baseline()),
        _ => Err(TrackError::value("preset", "default, compact, paper or baseline", name)),
    }
}
