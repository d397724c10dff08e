//! Evaluation of a stored map, one reading at a time: the processes of its two moments
//! ([`crate::Process`]), conditioned anew on the stored readings.

use crate::artefact::MapArtefact;
use crate::error::MapError;
use crate::process::Process;
use crate::student::half95;
use nalgebra::Matrix2;
use wcal_core::stream::{MomentSpread, MomentStream, StreamMoments};

/// Moments of one reading.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapPrediction {
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviation of the map itself, noise excluded, N mm.
    pub sd_map_nmm: [f64; 2],
    /// Standard deviation of a new label at this reading, noise included, N mm.
    pub sd_nmm: [f64; 2],
    /// Half width of the central 95 % interval, noise included, N mm.
    pub half95_nmm: [f64; 2],
    /// How far the reading lies outside the valid region, pm; 0 inside.
    pub outside_by_pm: f64,
}

impl MapPrediction {
    /// Whether the reading lies in the valid region.
    pub fn is_valid(&self) -> bool {
        self.outside_by_pm <= 0.0
    }

    /// What the spread is made of: the map's uncertainty is taken as common to all readings, one
    /// unknown for each moment.
    pub fn spread(&self) -> MomentSpread {
        const MIN_NMM2: f64 = 1e-12;
        let map = self.sd_map_nmm;
        // What the stated variance has beyond the map's is the reading's own.
        let [a, b] = [0, 1].map(|c| (self.sd_nmm[c].powi(2) - map[c].powi(2)).max(MIN_NMM2));
        MomentSpread {
            noise_nmm2: Matrix2::new(a, 0.0, 0.0, b),
            shared_nmm: vec![[map[0], 0.0], [0.0, map[1]]],
        }
    }
}

/// A map ready for use, its factors rebuilt once.
#[derive(Debug, Clone)]
pub struct MapPredictor {
    artefact: MapArtefact,
    processes: [Process; 2],
    half95: [f64; 2],
    last: MapPrediction,
}

impl MapPredictor {
    /// Checks the artefact and rebuilds its factors.
    ///
    /// # Errors
    /// As [`MapArtefact::check`], and [`MapError::NotPositiveDefinite`] where the covariance cannot
    /// be factorised.
    pub fn new(artefact: &MapArtefact) -> Result<Self, MapError> {
        artefact.check()?;
        let inputs: Vec<[f64; 2]> = artefact
            .training_pm
            .iter()
            .map(|s| artefact.scaled(*s))
            .collect();
        let [first, second] = &artefact.outputs;
        Ok(Self {
            processes: [first.process(&inputs)?, second.process(&inputs)?],
            half95: [half95(first.dof), half95(second.dof)],
            artefact: artefact.clone(),
            last: MapPrediction::default(),
        })
    }

    /// Moments (N mm) of one temperature-compensated reading (pm), with deviations and the distance
    /// from the valid region.
    pub fn predict(&self, shift_pm: [f64; 2]) -> MapPrediction {
        let z = self.artefact.scaled(shift_pm);
        let mut out = MapPrediction {
            outside_by_pm: self.artefact.valid_region.outside_by_pm(shift_pm),
            ..MapPrediction::default()
        };
        for (m, stored) in self.artefact.outputs.iter().enumerate() {
            let (mean, map, noisy) = self.processes[m].predict(z);
            out.moment_nmm[m] = stored.offset_nmm + mean;
            // The factor from left-out coverage is on standard deviations.
            out.sd_map_nmm[m] = stored.inflation * map.sqrt();
            out.sd_nmm[m] = stored.inflation * noisy.sqrt();
            out.half95_nmm[m] = self.half95[m] * out.sd_nmm[m];
        }
        out
    }

    /// Of each moment the factor of its variance: the lower triangle by rows of [L 0; G^T R], to be
    /// solved for [correlations; trend].
    pub fn factors(&self) -> [Vec<f64>; 2] {
        self.processes.each_ref().map(Process::joint_factor)
    }

    /// Moments alone, N mm: the mean without its deviation costs one pass over the readings.
    pub fn mean_nmm(&self, shift_pm: [f64; 2]) -> [f64; 2] {
        let z = self.artefact.scaled(shift_pm);
        [0, 1].map(|m| self.artefact.outputs[m].offset_nmm + self.processes[m].mean(z))
    }
}

impl MomentStream for MapPredictor {
    fn quick_nmm(&mut self, _t_s: f64, shift_pm: [f64; 2], _rise_degc: f64) -> [f64; 2] {
        self.mean_nmm(shift_pm)
    }

    fn moments(&mut self, _t_s: f64, shift_pm: [f64; 2], _rise_degc: f64) -> StreamMoments {
        let p = self.predict(shift_pm);
        self.last = p;
        StreamMoments {
            moment_nmm: p.moment_nmm,
            sd_nmm: p.sd_nmm,
            valid: p.is_valid(),
        }
    }

    fn spread(&self) -> MomentSpread {
        self.last.spread()
    }
}
