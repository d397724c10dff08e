//! What the loop knows of an effect before it sees data: laws, parameters with unit and range, and what they need.

use crate::engine::noise_parts::NoiseInputs;
use nalgebra::DMatrix;

/// Role of a parameter in a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// Zero means "not there"; `probe` is a typical size.
    Amplitude {
        /// Typical size, in the parameter's unit.
        probe: f64,
    },
    /// Shapes the law; tried on `grid` before it is refined.
    Shape {
        /// Values tried in screening.
        grid: &'static [f64],
    },
}

/// A nonlinear parameter of a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name in `verify.json`.
    pub name: &'static str,
    /// Unit, `1` where dimensionless.
    pub unit: &'static str,
    /// Physical range; an estimate at its end is no explanation unless the end is "not there".
    pub range: [f64; 2],
    /// Role.
    pub role: Role,
}

/// One way in which an effect can act.
#[derive(Debug, Clone, PartialEq)]
pub struct Law {
    /// Name, e.g. `prony`.
    pub name: &'static str,
    /// Nonlinear parameters.
    pub parameters: Vec<Parameter>,
    /// Names and units of the coefficients that enter linearly, one a column and channel.
    pub linear: Vec<(&'static str, &'static str)>,
    /// Largest part that those columns may have in what a channel spans; none where the law has no such limit.
    pub largest_share: Option<f64>,
}

/// An effect of a catalogue.
pub trait Candidate: Send + Sync {
    /// Identifier of docs/src/formats.md.
    fn id(&self) -> &'static str;
    /// Laws, the plainest first.
    fn laws(&self) -> Vec<Law>;
    /// Richer laws, tried only where the effect is accepted already and something is left. Their indices go on after those of `laws`.
    fn refinements(&self) -> Vec<Law> {
        Vec::new()
    }
    /// A law by its index.
    ///
    /// # Panics
    /// Where there is none.
    fn law(&self, index: usize) -> Law {
        let mut all = self.laws();
        if index >= all.len() {
            all.extend(self.refinements());
        }
        all.swap_remove(index)
    }
    /// One plain sentence for the report.
    fn sentence(&self) -> &'static str;
    /// Where the law and its ranges come from.
    fn source(&self) -> &'static str;
}

/// An effect with its law and nonlinear parameter values.
#[derive(Debug, Clone, PartialEq)]
pub struct Term {
    /// Index in the catalogue.
    pub effect: usize,
    /// Index in the effect's laws.
    pub law: usize,
    /// Values of the law's nonlinear parameters.
    pub values: Vec<f64>,
}

/// A session seen through a declared model and a catalogue: what the loop works on.
///
/// The prediction is `design(terms) * B` with free coefficients B, one column a channel.
pub trait System: Sync {
    /// Measured values, readings x channels.
    fn measured(&self) -> &DMatrix<f64>;
    /// From the channels of [`System::measured`], whose noise is alike and apart, to those of the sensor: `sensor = measured * this`.
    fn channels_pm(&self) -> DMatrix<f64> {
        DMatrix::identity(self.measured().ncols(), self.measured().ncols())
    }
    /// Design matrix, readings x coefficients; none where the model has no solution at these values.
    fn design(&self, terms: &[Term]) -> Option<DMatrix<f64>>;
    /// The catalogue.
    fn catalogue(&self) -> &[std::sync::Arc<dyn Candidate>];
    /// Why an effect cannot be seen in this session; none where it can.
    fn not_observable(&self, effect: usize) -> Option<String>;
    /// Group of each reading (trajectory, cycle); resampling keeps groups whole.
    fn groups(&self) -> &[u32];
    /// Covariates for finding what drives an unexplained residual: name and one value a reading.
    fn covariates(&self) -> Vec<(String, Vec<f64>)>;
    /// Known part of the noise, readings x channels (same unit as measured).
    fn known_noise(&self) -> &DMatrix<f64>;
    /// What the noise of the readings can depend on.
    fn noise_inputs(&self) -> NoiseInputs {
        NoiseInputs::none(self.measured().nrows())
    }
}
