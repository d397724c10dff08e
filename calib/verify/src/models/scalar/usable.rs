//! Can an accepted model serve as a calibration: does the response depend on the stimulus, and can
//! its own rows be predicted by it?

use super::frame::Declared;
use super::model::ScalarModel;
use super::system::ScalarSystem;
use crate::levels::{NEGLIGIBLE, USUAL};
use crate::method::{Basis, Fit, Hypothesis, f_test};
use crate::{EffectTerm, MeasurementModel};
use nalgebra::DVector;

/// The response does not depend on the stimulus: F test of every term of the stimulus at once,
/// beside whatever else was fitted. A quadratic or cubic term that was accepted is one of them, and
/// so is a wave over the stimulus.
pub(super) fn non_invertible_reason(system: &ScalarSystem, h: &Hypothesis) -> Option<String> {
    let Declared::Polynomial(degree @ 1..) = system.frame.declared else {
        return None;
    };
    if system.names.deviation {
        return None;
    }
    let fit = &h.fit;
    let column =
        |j: usize| DVector::from_column_slice(fit.design.column(j).clone_owned().as_slice());
    let of_stimulus = columns_of_stimulus(system, fit, degree);
    let mut beside = Basis::default();
    for j in (0..fit.design.ncols()).filter(|j| !of_stimulus.contains(j)) {
        beside.push(&column(j));
    }
    let left = fit.residual.column(0).clone_owned();
    // The weighted readings again: fitted part and residual.
    let reading =
        (0..fit.design.ncols()).fold(left, |sum, j| sum + column(j) * fit.coefficients[(j, 0)]);
    // Squares left where no term of the stimulus is fitted.
    let constant = beside.project_off(&reading).norm_squared();
    let extra = of_stimulus.len() + fit.tangents.len();
    let p = f_test(constant - fit.ssr, constant, fit.dof + extra as f64, extra)?;
    let depends = if p > USUAL {
        "does not depend on the stimulus"
    } else {
        "hardly depends on the stimulus"
    };
    let chance = if p < 0.01 {
        format!("{p:.1e}")
    } else {
        format!("{p:.2}")
    };
    (p > NEGLIGIBLE)
        .then(|| format!("The response {depends} (p = {chance}): there is no sensitivity to calibrate. A correction or deviation of the stimulus needs none: deviation = true under [transducer] of session.toml states that it is one."))
}

/// Columns of the design that are functions of the stimulus: the declared powers, and those of
/// effects that act through the stimulus alone.
fn columns_of_stimulus(system: &ScalarSystem, fit: &Fit, degree: usize) -> Vec<usize> {
    let acts = |t: &EffectTerm| {
        system.effects[t.effect].of_stimulus(system.catalogue()[t.effect].law(t.law))
    };
    let slots = fit
        .terms
        .iter()
        .zip(fit.slots(system.catalogue()))
        .filter(|(t, _)| acts(t));
    (1..=degree)
        .chain(slots.flat_map(|(_, own)| own.columns))
        .collect()
}

/// The model cannot be applied to the rows that it was fitted to.
pub(super) fn domain_error(system: &ScalarSystem, h: &Hypothesis) -> Option<String> {
    let model = ScalarModel::of(system, h, 0.0, None, [None; 2]);
    let why = model.predict(&system.frame.rows).err()?;
    Some(format!(
        "The model cannot be applied to its own rows ({why}); no calibration follows from it."
    ))
}

/// Fewer readings than this show little beside their law; a certificate of five pressures is one of
/// them.
const FEW: usize = 8;

/// What the accepted law rests on and no reading tests.
pub(super) fn untested(system: &ScalarSystem, h: &Hypothesis) -> Vec<String> {
    let Declared::Polynomial(degree) = system.frame.declared else {
        return Vec::new();
    };
    let (n, levels) = (system.frame.rows.len(), system.frame.levels());
    let of_stimulus = 1 + columns_of_stimulus(system, &h.fit, degree).len();
    let mut out = Vec::new();
    // As many settings as coefficients: the curve goes through all of them, whatever it does
    // between them.
    if levels == of_stimulus && degree > 0 {
        out.push(format!(
            "{levels} stimuli determine the {levels} coefficients and test nothing of the law between them: a bend there does harm and does not \
             show. A reading at another stimulus between them decides."
        ));
    }
    if n < FEW {
        let repeats = if levels < n { "" } else { "repeatability, " };
        out.push(format!(
            "{n} readings leave {} degrees of freedom: intervals are those of Student's t, and {repeats}hysteresis, drift and single false readings \
             cannot be determined.",
            h.fit.dof
        ));
    }
    out
}
