//! What a training leaves after every pass, so that it can be taken up again.

use super::settings::{Pass, TrainSettings};
use crate::LabError;
use crate::network::TrainableNet;
use burn::module::Module;
use burn::optim::ModuleOptimizer;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use wcal_network::network::NetworkConfig;

/// Where a training stands after a pass.
pub(super) struct State {
    pub net: TrainableNet,
    pub best: TrainableNet,
    pub optimizer: ModuleOptimizer,
    pub passes: Vec<Pass>,
}

#[derive(Serialize, Deserialize, JsonSchema)]
struct CheckpointState {
    network: NetworkConfig,
    settings: TrainSettings,
    passes: Vec<Pass>,
}

fn files(folder: &Path) -> [PathBuf; 4] {
    ["state.json", "net.bpk", "best.bpk", "optimizer.bpk"].map(|f| folder.join(f))
}

/// Writes network, best network and optimizer, and last what they belong to.
pub(super) fn save(
    folder: &Path,
    network: &NetworkConfig,
    settings: &TrainSettings,
    state: &State,
) -> Result<(), LabError> {
    std::fs::create_dir_all(folder).map_err(LabError::file("creating", folder))?;
    let [state_file, net, best, optimizer] = files(folder);
    state
        .net
        .clone()
        .save_file(&net)
        .map_err(LabError::file("writing", &net))?;
    state
        .best
        .clone()
        .save_file(&best)
        .map_err(LabError::file("writing", &best))?;
    state
        .optimizer
        .save(&optimizer)
        .map_err(LabError::file("writing", &optimizer))?;
    let made = CheckpointState {
        network: *network,
        settings: *settings,
        passes: state.passes.clone(),
    };
    let text =
        serde_json::to_string_pretty(&made).map_err(LabError::file("writing", &state_file))?;
    std::fs::write(&state_file, text).map_err(LabError::file("writing", &state_file))
}

/// The state in a folder, or the one given where there is none.
pub(super) fn resume(
    folder: &Path,
    network: &NetworkConfig,
    settings: &TrainSettings,
    fresh: State,
) -> Result<State, LabError> {
    let [state_file, net, best, optimizer] = files(folder);
    if !state_file.exists() {
        return Ok(fresh);
    }
    let text = wcal_core::files::read_text(&state_file)?;
    let made: CheckpointState =
        wcal_core::document::json_as(&text).map_err(LabError::file("reading", &state_file))?;
    if made.network != *network || made.settings != *settings {
        let what = format!("{}: network and settings", state_file.display());
        return Err(LabError::value(
            what,
            "those of this training (or another folder)",
            "others",
        ));
    }
    Ok(State {
        net: fresh
            .net
            .try_load_file(&net)
            .map_err(LabError::file("reading", &net))?,
        best: fresh
            .best
            .try_load_file(&best)
            .map_err(LabError::file("reading", &best))?,
        optimizer: fresh
            .optimizer
            .load(&optimizer)
            .map_err(LabError::file("reading", &optimizer))?,
        passes: made.passes,
    })
}
