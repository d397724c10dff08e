//! An explanation, what it costs, and why a name falls.
//!
//! ```text
//! C = ssr / s^2 + 2 k + flags (2 c + 2 ln n)          (Akaike; k parameters, c channels, n readings)
//! ```
//!
//! H. Akaike, IEEE Trans. Automat. Contr. 19 (1974), 716-723; a flagged reading is a free shift in
//! every channel, chosen among n.

use super::fitted::Fit;
use super::noise::Weights;
use crate::effect::Catalogue;
use crate::levels::PRICE;

/// An explanation: effects with fitted parameters.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// The fit.
    pub fit: Fit,
    /// Weights, flagged readings at zero.
    pub weights: Weights,
    /// Readings flagged as outliers.
    pub flagged: Vec<usize>,
    /// Chance that noise with tails as heavy as the data allow gives the flagged readings; 1 where
    /// none is.
    pub flag_p: f64,
}

impl Hypothesis {
    /// Indices of its effects, ascending; outliers included.
    pub fn effects(&self, outliers: Option<usize>) -> Vec<usize> {
        let mut ids: Vec<usize> = self.fit.terms.iter().map(|t| t.effect).collect();
        if let (Some(o), false) = (outliers, self.flagged.is_empty()) {
            ids.push(o);
        }
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Identifiers of its terms.
    pub(crate) fn term_ids(&self, catalogue: &Catalogue) -> Vec<String> {
        self.fit
            .terms
            .iter()
            .map(|t| catalogue[t.effect].id.to_owned())
            .collect()
    }

    /// Parameters that the explanation spends beyond the declared model.
    pub fn parameters(&self, base: &Fit) -> f64 {
        let columns = (self.fit.design.ncols() - base.design.ncols()) * self.fit.residual.ncols();
        let values: usize = self.fit.terms.iter().map(|t| t.values.len()).sum();
        (columns + values) as f64
    }

    /// Misfit in units of `variance` plus twice the parameters (Akaike); smaller is better.
    pub(crate) fn aic(&self, base: &Fit, variance: f64) -> f64 {
        let n = self.fit.residual.nrows() as f64;
        let channels = self.fit.residual.ncols() as f64;
        // A flagged reading is a free shift in every channel, chosen among n.
        let flags = self.flagged.len() as f64 * (2.0 * channels + PRICE * n.ln());
        self.fit.ssr / variance + 2.0 * self.parameters(base) + flags
    }
}

/// An effect that the design of the experiment does not tell from others.
#[derive(Debug, Clone, PartialEq)]
pub struct NotIdentified {
    /// Index in the catalogue.
    pub effect: usize,
    /// Why.
    pub why: String,
}

/// A gate at which a name falls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gate {
    /// Its fit was still falling when the iterations ran out.
    NotConverged,
    /// The design of the experiment does not tell it from others.
    Identifiability,
    /// It lowers the error of readings that are left out by less than that gain scatters.
    LeftOutError,
    /// Another measurement of the instrument refutes it.
    Witness,
}

/// A name that fell, at which gate and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejection {
    /// Effects of the explanation.
    pub effects: Vec<String>,
    /// Gate.
    pub gate: Gate,
    /// Why, in words; empty where the gate says it all.
    pub why: String,
}
