//! Where an effect of the whisker acts: on the pose, the rod, the sensor, the pictures, or as
//! columns of the readout.

use super::path::{ReadoutOrigin, WhiskerPath};
use super::picture_observations::PairObservation;
use super::rod_parameters::RodParameters;
use crate::effect::{Effect, EffectModel, EffectTerm, Values};

/// What a sensor remembers: the moment before, N mm, and the states of its elements.
#[derive(Debug, Clone, Default)]
pub(crate) struct SensorMemory {
    before: [f64; 2],
    states: Vec<[f64; 2]>,
}

impl SensorMemory {
    /// What is sensed of `moment_nmm` by elements side by side, each with its weight, and a time
    /// constant or width: the moment and, weighted, the state of each. `next`: that state from the
    /// last one, the moment before and the width.
    pub(crate) fn sensed(
        &mut self,
        elements: Vec<(f64, f64)>,
        moment_nmm: [f64; 2],
        next: impl Fn([f64; 2], [f64; 2], f64) -> [f64; 2],
    ) -> [f64; 2] {
        self.states.resize(elements.len(), [0.0; 2]);
        let mut sensed = moment_nmm;
        for (state, (weight, width)) in self.states.iter_mut().zip(elements) {
            *state = next(*state, self.before, width);
            sensed = [0, 1].map(|c| sensed[c] + weight * state[c]);
        }
        self.before = moment_nmm;
        sensed
    }
}

/// Who sees a change of the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Observers {
    /// Where the groove really was: gratings and cameras.
    Both,
    /// Gratings alone: their readings are late.
    Gratings,
    /// Cameras alone: their pictures are late.
    Cameras,
}

/// What is sensed of a moment (N mm) some time (s) after the one before, none at the first, which is
/// remembered.
type Sensor = fn(&Values, &mut SensorMemory, Option<f64>, [f64; 2]) -> [f64; 2];
/// Columns of the readout from the sensed moments of a path's readings.
type ReadoutColumns = fn(&Values, &WhiskerPath, &ReadoutOrigin, &[[f64; 2]]) -> Vec<Vec<f64>>;

/// An effect with where it acts.
pub(crate) struct WhiskerEffect {
    /// Name and laws.
    pub effect: Effect,
    /// Who sees the poses that it changes: the gratings, the cameras, or both.
    pub observers: Observers,
    /// Changes the effective stage position of every node, mm.
    pub pose: fn(&Values, &WhiskerPath, &mut [f64]),
    /// Changes the mechanics of wire, root and groove.
    pub rod: fn(&Values, &mut RodParameters),
    /// What the gratings sense of moments that come one after the other.
    pub sensor: Sensor,
    /// Changes what pairs of pictures show: faults of the cameras' setup.
    pub pictures: fn(&Values, &mut [PairObservation]),
    /// Readout columns (one value a reading) whose coefficients are free in each channel, from the
    /// sensed moments, N mm.
    pub columns: ReadoutColumns,
}

impl WhiskerEffect {
    /// An effect without memory that acts nowhere yet.
    pub(crate) fn new(id: &'static str, sentence: &'static str, laws: Vec<EffectModel>) -> Self {
        Effect::new(id, sentence, laws).into()
    }
}

impl From<Effect> for WhiskerEffect {
    /// An effect that acts nowhere yet.
    fn from(effect: Effect) -> Self {
        Self {
            effect,
            observers: Observers::Both,
            pose: |_, _, _| {},
            rod: |_, _| {},
            sensor: |_, _, _, moment_nmm| moment_nmm,
            pictures: |_, _| {},
            columns: |_, _, _, _| Vec::new(),
        }
    }
}

/// An effect that acts: its law and values.
pub(crate) struct ActiveEffect {
    /// The effect.
    pub effect: &'static WhiskerEffect,
    /// Its place in the catalogue, law and values.
    pub term: EffectTerm,
}

impl ActiveEffect {
    /// Its law.
    pub(crate) fn law(&self) -> &'static EffectModel {
        self.effect.effect.law(self.term.law)
    }

    /// Values of its parameters, by name.
    pub(crate) fn values(&self) -> Values<'_> {
        Values::new(self.law(), self.term.law, &self.term.values)
    }

    /// Changes the moments that the gratings sense at every node, N mm.
    pub(crate) fn sensor(&self, path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let (mut memory, mut last_s) = (SensorMemory::default(), None);
        for (m, node) in moments_nmm.iter_mut().zip(&path.nodes) {
            let dt_s = last_s.replace(node.t_s).map(|last: f64| node.t_s - last);
            *m = self.sensed(&mut memory, dt_s, *m);
        }
    }

    /// What is sensed of one moment, N mm.
    pub(crate) fn sensed(
        &self,
        memory: &mut SensorMemory,
        dt_s: Option<f64>,
        moment_nmm: [f64; 2],
    ) -> [f64; 2] {
        (self.effect.sensor)(&self.values(), memory, dt_s, moment_nmm)
    }
}
