//! Where an effect of the whisker acts: on the pose, the rod, the sensor, the pictures, or as columns of the readout.

use super::path::WhiskerPath;
use super::pictures::PairObservation;
use super::rod_parameters::RodParameters;
use crate::effect::{Effect, EffectModel, EffectTerm, LawRequirement, Values};
use std::sync::Arc;

/// A sensor whose answer depends on what came before.
pub trait Memory: Send {
    /// What is sensed of a moment (N mm) `dt_s` after the one before, none at the first; nothing is remembered.
    fn sensed(&self, dt_s: Option<f64>, moment_nmm: [f64; 2]) -> [f64; 2];
    /// Remembers that moment.
    fn accept(&mut self, dt_s: Option<f64>, moment_nmm: [f64; 2]);
}

/// Who sees a change of the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Observers {
    /// Where the groove really was: gratings and cameras.
    Both,
    /// Gratings alone: their readings are late.
    Gratings,
    /// Cameras alone: their pictures are late.
    Cameras,
}

/// Where an effect of the whisker acts; every hook does nothing by default.
pub trait WhiskerEffect: Effect {
    /// Who sees the poses that it changes: the gratings, the cameras, or both.
    fn observers(&self) -> Observers {
        Observers::Both
    }
    /// Changes the effective stage position of every node, mm.
    fn pose(&self, _values: &Values, _path: &WhiskerPath, _xs_mm: &mut [f64]) {}
    /// Changes the mechanics of wire, root and groove.
    fn rod(&self, _values: &Values, _rod: &mut RodParameters) {}
    /// What the gratings sense of moments that come one after the other; none where they sense them as they are.
    fn memory(&self, _values: &Values) -> Option<Box<dyn Memory>> {
        None
    }
    /// Changes the moments that the gratings sense at every node, N mm.
    fn sensor(&self, values: &Values, path: &WhiskerPath, moments_nmm: &mut [[f64; 2]]) {
        let Some(mut memory) = self.memory(values) else { return };
        let mut last_s = None;
        for (m, node) in moments_nmm.iter_mut().zip(&path.nodes) {
            let dt_s = last_s.map(|last| node.t_s - last);
            last_s = Some(node.t_s);
            let sensed = memory.sensed(dt_s, *m);
            memory.accept(dt_s, *m);
            *m = sensed;
        }
    }
    /// Changes what pairs of pictures show: faults of the cameras' setup.
    fn pictures(&self, _values: &Values, _seen: &mut [PairObservation]) {}
    /// Appends readout columns (one value a reading) whose coefficients are free in each channel.
    fn columns(
        &self,
        _values: &Values,
        _path: &WhiskerPath,
        _moments_nmm: &[[f64; 2]],
        _out: &mut Vec<Vec<f64>>,
    ) {
    }
}

/// An effect that acts: its law and values.
pub struct ActiveEffect {
    /// The effect.
    pub effect: Arc<dyn WhiskerEffect>,
    law: EffectModel,
    term: EffectTerm,
}

impl ActiveEffect {
    /// `term` of a catalogue's effect.
    pub fn new(effect: Arc<dyn WhiskerEffect>, term: EffectTerm) -> Self {
        Self { law: effect.law(term.law), effect, term }
    }

    /// What its law needs of a session.
    pub fn needs(&self) -> &[LawRequirement] {
        &self.law.needs
    }

    /// Its place in the catalogue.
    pub fn place(&self) -> usize {
        self.term.effect
    }

    /// Its place in the catalogue, law and values.
    pub fn into_term(self) -> EffectTerm {
        self.term
    }

    /// Physical ranges of its values.
    pub fn ranges(&self) -> impl Iterator<Item = [f64; 2]> {
        self.law.parameters.iter().map(|p| p.range)
    }

    /// Values of its parameters, by name.
    pub fn values(&self) -> Values<'_> {
        Values::new(&self.law, self.term.law, &self.term.values)
    }
}
