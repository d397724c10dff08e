//! Quadratic form of the moment in each channel.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;

/// Five times what is usual at most (4 % of full scale), which leaves room for its standard deviation: more is no grating's nonlinearity.
const MAX_SHARE: f64 = 0.2;

/// See the module.
pub struct FbgNonlinearity;

impl Effect for FbgNonlinearity {
    fn id(&self) -> &'static str {
        "fbg-nonlinearity"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("quadratic")
                .column("quadratic_11", "pm/(N mm)^2")
                .column("quadratic_12", "pm/(N mm)^2")
                .column("quadratic_22", "pm/(N mm)^2")
                .at_most(MAX_SHARE),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The wavelength shift is nonlinear in the moment."
    }
    fn source(&self) -> &'static str {
        "second-order strain-optic and bonding terms"
    }
}

impl WhiskerEffect for FbgNonlinearity {
    fn columns(
        &self,
        _values: &Values,
        _path: &WhiskerPath,
        moments_nmm: &[[f64; 2]],
        out: &mut Vec<Vec<f64>>,
    ) {
        out.push(moments_nmm.iter().map(|m| m[0] * m[0]).collect());
        out.push(moments_nmm.iter().map(|m| m[0] * m[1]).collect());
        out.push(moments_nmm.iter().map(|m| m[1] * m[1]).collect());
    }
}
