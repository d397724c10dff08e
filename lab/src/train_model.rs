//! From a folder of sweeps to a trained model with its card.

use crate::LabError;
use crate::dataset::read::manifests;
use crate::evaluate::{held_out_regions, regions};
use crate::model_file::{Card, Split, network_grid, preset, read_card, runnable, save};
use crate::score::{EstimateError, calibrated, calibrating_factor};
use crate::sweep_series;
use crate::sweep_series::SweepSeries;
use crate::train::{Pass, TrainingData, train};
use burn::tensor::Device;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use wcal_lab_sweeps::objects::TEST_NAMES;
use wcal_network::Tracker;
use wcal_network::filter::{BayesSettings, FilterBank};
use wcal_network::inverse::StaticInverse;
use wcal_network::model_file::FORMAT;
use wcal_network::network::NetworkConfig;
use wcal_network::sd_factors::SdFactors;

pub(crate) mod cost;
mod request;
mod shifted_sweeps;

use cost::Stopwatch;
pub use cost::{Seconds, TrainingCost};
pub use request::TrainingRequest;
use shifted_sweeps::on_shifted_sensors;

/// Share of the sweeps over an object that are trained on; the rest judges objects that were seen.
const TRAINED: f64 = 0.9;

/// Trains, states the spread from the held-out objects, and writes the model; taken up again where
/// it stopped.
///
/// # Errors
/// Where the sweeps cannot be used or the model cannot be written.
pub fn train_model(
    request: &TrainingRequest<'_>,
    device: &Device,
    on_pass: impl FnMut(&Pass),
) -> Result<Card, LabError> {
    let stopwatch = Stopwatch::start();
    for folder in
        std::iter::once(request.sweeps).chain(request.additional.iter().map(PathBuf::as_path))
    {
        refuse_test_objects(folder)?;
    }
    let SplitSeries {
        objects,
        training: all_series,
        held_out,
        sweeps_trained,
    } = SplitSeries::read(request)?;
    let inverse = StaticInverse::new(&request.whisker, network_grid())?;
    let network = preset(
        request.preset,
        &inverse,
        request.settings.filter_frictionless.is_some(),
    )?;
    let mut settings = request.settings;
    if !network.two_filters && settings.filter_frictionless.is_some() {
        // What weighs none against another has one for all objects.
        (settings.filter, settings.filter_frictionless) = (BayesSettings::multi_mu(), None);
    }
    let request = &TrainingRequest {
        settings,
        ..request.clone()
    };
    let from = request
        .from
        .map(|folder| check_start_model(folder, &network, &objects, sweeps_trained))
        .transpose()?;
    let material = TrainingData {
        all_series: &all_series,
        held_out: &held_out,
        inverse: &inverse,
        meshes: request.meshes,
        from: request.from,
    };
    let checkpoint = request.out.join("checkpoint");
    let reading = stopwatch.elapsed();
    let (net, passes) = train(
        &network,
        &request.settings,
        &material,
        Some(&checkpoint),
        device,
        on_pass,
    )?;
    let stopwatch = Stopwatch::start();
    let tracker = Tracker {
        config: network,
        net: runnable(&net, &network)?.0,
        inverse,
        filters: settings.filters(),
        sd_factors: [1.0; 2].map(SdFactors::constant),
    };
    // A network without knots states no spread.
    let shifted_sweeps = if network.nodes > 0 {
        on_shifted_sensors(request, &objects.held_out, &held_out)?
    } else {
        Vec::new()
    };
    let on_bench = [false, true].map(|known| {
        let of = |(series, filters): &(SweepSeries, FilterBank)| {
            regions(&tracker, *filters, series, known)
        };
        let all: Vec<EstimateError> = shifted_sweeps
            .par_iter()
            .flat_map_iter(of)
            .map(|r| r.1)
            .collect();
        calibrated(&all)
    });
    let held_out_regions = [false, true].map(|known| held_out_regions(&tracker, &held_out, known));
    // With these factors the 90 % regions have their coverage on held-out sweeps.
    let sd_factors = held_out_regions
        .each_ref()
        .map(|r| calibrating_factor(&r.iter().map(|r| r.1).collect::<Vec<_>>()));
    let made_from = |folder: &Path| -> Result<BTreeMap<String, String>, LabError> {
        Ok(manifests(folder)?
            .into_iter()
            .map(|(_, m)| (m.object, m.made_from))
            .collect())
    };
    // A training that was finished before took what its card says.
    let finished = read_card(request.out)
        .ok()
        .filter(|card| card.passes == passes);
    let cost = finished
        .and_then(|card| card.cost)
        .unwrap_or_else(|| TrainingCost {
            sweeps: request.sweeps_cost,
            training: reading + cost::of_passes(&passes) + stopwatch.elapsed(),
            cores: rayon::current_num_threads(),
        });
    let mut card = Card {
        format: FORMAT.to_owned(),
        trained_on_simulation: true,
        weights_sha256: String::new(),
        network,
        inverse: network_grid(),
        whisker: request.whisker.clone(),
        sd_factors,
        sd_on_bench: on_bench,
        training: request.settings,
        passes,
        objects,
        data: made_from(request.sweeps)?,
        data_beside: request
            .additional
            .iter()
            .map(|f| made_from(f))
            .collect::<Result<_, _>>()?,
        began_with: from,
        sweeps_trained,
        command: request.command.clone(),
        cost: Some(cost),
    };
    save(request.out, &net, &mut card)?;
    Ok(card)
}

/// The sweeps of a request, divided.
struct SplitSeries {
    objects: Split,
    training: Vec<SweepSeries>,
    held_out: Vec<SweepSeries>,
    /// Sweeps of each object that are trained on.
    sweeps_trained: u64,
}

impl SplitSeries {
    fn read(request: &TrainingRequest<'_>) -> Result<Self, LabError> {
        let mut all = sweep_series::read_sweep_series(request.sweeps, &[])?;
        let eighth = (all.len() / 8).max(1);
        let counts = [
            request.held_out.unwrap_or(eighth),
            request.unseen.unwrap_or(eighth),
        ];
        let objects = Split::draw(all.keys().cloned().collect(), counts, request.settings.seed)?;
        let sweeps = all
            .values()
            .flatten()
            .map(|c| c.sweep + 1)
            .max()
            .unwrap_or(0);
        let sweeps_trained = (sweeps as f64 * TRAINED) as u64;
        let mut of = |names: &[String]| -> Vec<SweepSeries> {
            names
                .iter()
                .flat_map(|name| all.remove(name).unwrap_or_default())
                .collect()
        };
        let (mut training, held_out) = (of(&objects.training), of(&objects.held_out));
        training.retain(|c| c.sweep < sweeps_trained);
        for folder in request.additional {
            let more = sweep_series::read_sweep_series(folder, &objects.training)?;
            training.extend(more.into_values().flatten());
        }
        Ok(Self {
            objects,
            training,
            held_out,
            sweeps_trained,
        })
    }
}

/// Objects that are set aside for tests are not trained on: a number on them must stay one on
/// objects that chose no design.
fn refuse_test_objects(folder: &Path) -> Result<(), LabError> {
    let objects = manifests(folder)?.into_iter().map(|(_, m)| m.object);
    let set_aside: BTreeSet<String> = objects
        .filter(|name| TEST_NAMES.contains(&name.as_str()))
        .collect();
    if set_aside.is_empty() {
        return Ok(());
    }
    let found = set_aside.into_iter().collect::<Vec<_>>().join(", ");
    let expected = "none of the test objects, which no training may see (fixtures/test_objects)";
    Err(LabError::value(
        format!("{}: objects", folder.display()),
        expected,
        found,
    ))
}

/// SHA-256 of the weights of a model from which a training may start: the sweeps held out for
/// evaluation must not be in its training.
fn check_start_model(
    folder: &Path,
    network: &NetworkConfig,
    objects: &Split,
    sweeps_trained: u64,
) -> Result<String, LabError> {
    let card = read_card(folder)?;
    let refuse = |what: &str, expected: &str, found: String| {
        Err(LabError::value(
            format!("{}: {what}", folder.display()),
            expected,
            found,
        ))
    };
    if card.network != *network {
        return refuse(
            "network",
            "that of this training",
            format!("{:?}", card.network),
        );
    }
    if card.objects != *objects {
        return refuse(
            "objects",
            "split as in this training",
            format!("unseen: {}", card.objects.unseen.join(", ")),
        );
    }
    if card.sweeps_trained > sweeps_trained {
        let expected = format!("{sweeps_trained} trained on or fewer");
        return refuse("sweeps", &expected, card.sweeps_trained.to_string());
    }
    Ok(card.weights_sha256)
}
