//! What is evaluated on what, and what the caller supplies for it.

use crate::LabError;
use crate::model_file::Card;
use crate::sweep_series::SweepSeries;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use wcal_calibration::CalibrationModel;
use wcal_core::provenance::Provenance;
use wcal_core::verify_document::{GrooveTracking, Verdict};
use wcal_lab_sweeps::objects;
use wcal_mesh::Mesh;
use wcal_network::Tracker;
use wcal_network::filter::FilterBank;

/// What is evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Model<'a> {
    /// Network.
    pub tracker: &'a Tracker,
    /// Its card.
    pub card: &'a Card,
}

/// Series of the objects that were trained on (sweeps that were kept back) and of those that were
/// not.
#[derive(Debug, Clone)]
pub struct Sets {
    /// Seen objects.
    pub seen: BTreeMap<String, Vec<SweepSeries>>,
    /// Unseen objects.
    pub unseen: BTreeMap<String, Vec<SweepSeries>>,
}

impl Sets {
    pub(super) fn named(&self) -> [(&'static str, &BTreeMap<String, Vec<SweepSeries>>); 2] {
        [("seen", &self.seen), ("unseen", &self.unseen)]
    }
}

/// What is asked for.
#[derive(Debug, Clone, Copy)]
pub struct Order<'a> {
    /// Folder of the objects' STL files; built-in objects need none.
    pub meshes: Option<&'a Path>,
    /// Objects of each kind at most.
    pub objects: usize,
    /// Sweeps over each object at most.
    pub sweeps_each: usize,
    /// Seed of the virtual bench and of the sweeps that are drawn on the spot.
    pub seed: u64,
    /// No tables that draw sweeps.
    pub simulation_only: bool,
}

/// From the folder of the virtual bench's session to its calibration.
pub type Calibrate<'a> =
    dyn Fn(&Path) -> Result<BenchCalibration, Box<dyn Error + Send + Sync>> + 'a;

/// What the caller supplies: the commands that an evaluation uses, and where it speaks.
pub struct Surroundings<'a> {
    /// The virtual bench's session calibrated by `fit-gpr` and `verify`.
    pub calibrate: &'a Calibrate<'a>,
    /// Filters that know the noise of moments through a calibration.
    pub filters_for: fn(FilterBank, &CalibrationModel) -> FilterBank,
    /// Stages.
    pub progress: &'a dyn Fn(&str),
    /// Remarks.
    pub note: &'a dyn Fn(&str),
    /// Inputs and program.
    pub provenance: Provenance,
}

/// Calibrations of one session of the virtual bench.
#[derive(Debug, Clone)]
pub struct BenchCalibration {
    /// The map of `fit-gpr`, as if no effect had been found.
    pub map: CalibrationModel,
    /// The sensitivity with the effects that `verify` accepted, where it vouches for one.
    pub verified: Option<CalibrationModel>,
    /// What `verify` said.
    pub verdict: Verdict,
    /// Effects that it accepted.
    pub accepted: Vec<String>,
    /// The tracker on the groove of the session, whose motion is known, beside its bound.
    pub groove: Option<GrooveTracking>,
}

impl BenchCalibration {
    /// The one that a user would take.
    pub(super) fn best(&self) -> &CalibrationModel {
        self.verified.as_ref().unwrap_or(&self.map)
    }
}

/// The meshes of objects; remarks on them go to `note`.
pub(super) fn meshes<'a>(
    names: impl Iterator<Item = &'a String>,
    folder: Option<&Path>,
    note: &dyn Fn(&str),
) -> Result<BTreeMap<String, Mesh>, LabError> {
    names
        .map(|name| {
            let mesh = objects::named(name, folder).map_err(|source| LabError::Mesh {
                name: name.clone(),
                source,
            })?;
            for remark in &mesh.notes {
                note(&format!("warning: object {name}: {remark}"));
            }
            Ok((name.clone(), mesh))
        })
        .collect()
}
