//! Where an effect of the whisker acts: on the pose, the rod, the sensor, the pictures, or as
//! columns of the readout.

use super::path::{ReadoutOrigin, WhiskerPath};
use super::picture_observations::PairObservation;
use super::rod_parameters::RodParameters;
use crate::effect::{Effect, EffectModel, EffectTerm, Values};

/// A sensor whose answer depends on what came before.
pub trait Memory: Send {
    /// What is sensed of a moment (N mm) `dt_s` after the one before, none at the first; nothing is
    /// remembered.
    fn sensed(&self, dt_s: Option<f64>, moment_nmm: [f64; 2]) -> [f64; 2];
    /// Remembers that moment.
    fn accept(&mut self, dt_s: Option<f64>, moment_nmm: [f64; 2]);
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

/// Begins a sensor's memory under the effect's values.
type BeginMemory = fn(&Values) -> Box<dyn Memory>;
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
    /// What the gratings sense of moments that come one after the other; none where they sense them
    /// as they are.
    pub memory: Option<BeginMemory>,
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
            memory: None,
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

    /// What the gratings sense of moments, where the effect makes that depend on those before.
    pub(crate) fn memory(&self) -> Option<Box<dyn Memory>> {
        self.effect.memory.map(|memory| memory(&self.values()))
    }

    /// Changes the moments that the gratings sense at every node, N mm.
    pub(crate) fn sensor(&self, path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let Some(mut memory) = self.memory() else {
            return;
        };
        let mut last_s = None;
        for (m, node) in moments_nmm.iter_mut().zip(&path.nodes) {
            let dt_s = last_s.map(|last| node.t_s - last);
            last_s = Some(node.t_s);
            let sensed = memory.sensed(dt_s, *m);
            memory.accept(dt_s, *m);
            *m = sensed;
        }
    }
}
