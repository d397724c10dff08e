//! What a map is fitted to, independent of where readings and labels came from.

use crate::error::MapError;
use crate::geometry::centre_and_spread;
use std::collections::{BTreeMap, BTreeSet};

/// Readings with their moment labels; entry `i` of every column belongs to reading `i`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MapTraining {
    /// Temperature-compensated shifts of the two sensing gratings, pm.
    pub shifts_pm: Vec<[f64; 2]>,
    /// Base moments, N mm.
    pub moments_nmm: Vec<[f64; 2]>,
    /// Trajectory of each reading; none at rest. Rest readings stay in every training fold.
    pub trajectory: Vec<Option<u32>>,
    /// Pose group: readings that share it are left out together by leave-one-out. Empty: every
    /// reading is its own pose.
    pub pose: Vec<u32>,
    /// Point numbers.
    pub point: Vec<i64>,
    /// Standard deviation of the readings' own noise, pm, where known (from replicates or sample
    /// spread).
    pub noise_sd_pm: Option<[f64; 2]>,
}

impl MapTraining {
    /// Number of readings.
    pub fn len(&self) -> usize {
        self.shifts_pm.len()
    }

    /// Whether there are no readings.
    pub fn is_empty(&self) -> bool {
        self.shifts_pm.is_empty()
    }

    /// Checks lengths, finiteness and size.
    ///
    /// # Errors
    /// [`MapError::Length`], [`MapError::NotFinite`] or [`MapError::TooFew`] (fewer than 5: three
    /// affine coefficients and two degrees of freedom).
    pub(crate) fn validate(&self) -> Result<(), MapError> {
        let n = self.len();
        let poses = if self.pose.is_empty() {
            n
        } else {
            self.pose.len()
        };
        let lengths = [
            ("moments_nmm", self.moments_nmm.len()),
            ("trajectory", self.trajectory.len()),
            ("point", self.point.len()),
            ("pose", poses),
        ];
        for (field, found) in lengths {
            if found != n {
                return Err(MapError::Length {
                    field,
                    expected: n,
                    found,
                });
            }
        }
        for (i, point) in self.point.iter().enumerate() {
            for (field, pair) in [
                ("shifts_pm", self.shifts_pm[i]),
                ("moments_nmm", self.moments_nmm[i]),
            ] {
                if let Some(found) = pair.into_iter().find(|v| !v.is_finite()) {
                    return Err(MapError::NotFinite {
                        field,
                        point: *point,
                        found,
                    });
                }
            }
        }
        if n < 5 {
            return Err(MapError::TooFew {
                expected: 5,
                found: n,
            });
        }
        Ok(())
    }

    /// Without the readings at rest.
    pub fn loaded(&self) -> Self {
        let mut loaded = self.clone();
        fn keep<T>(all: &mut Vec<T>, trajectory: &[Option<u32>]) {
            let mut of = trajectory.iter();
            all.retain(|_| of.next().is_some_and(Option::is_some));
        }
        keep(&mut loaded.shifts_pm, &self.trajectory);
        keep(&mut loaded.moments_nmm, &self.trajectory);
        keep(&mut loaded.trajectory, &self.trajectory);
        keep(&mut loaded.pose, &self.trajectory);
        keep(&mut loaded.point, &self.trajectory);
        loaded
    }

    /// Distinct trajectories in ascending order, rest not counted.
    pub fn trajectories(&self) -> Vec<u32> {
        let distinct: BTreeSet<u32> = self.trajectory.iter().flatten().copied().collect();
        distinct.into_iter().collect()
    }

    /// Readings left out together by leave-one-out: one entry a pose.
    pub(crate) fn pose_groups(&self) -> Vec<Vec<usize>> {
        if self.pose.is_empty() {
            return (0..self.len()).map(|i| vec![i]).collect();
        }
        let mut groups: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (i, pose) in self.pose.iter().enumerate() {
            groups.entry(*pose).or_default().push(i);
        }
        groups.into_values().collect()
    }

    /// One moment's labels, N mm.
    pub fn moment_nmm(&self, moment: usize) -> Vec<f64> {
        self.moments_nmm.iter().map(|m| m[moment]).collect()
    }

    /// Centre (pm) and one common scale (pm) for both gratings: a common scale keeps the kernel
    /// isotropic in wavelength.
    pub(crate) fn input_scaling(&self) -> ([f64; 2], f64) {
        let (centre, spread) = centre_and_spread(&self.shifts_pm);
        (centre, if spread > 0.0 { spread } else { 1.0 })
    }
}
