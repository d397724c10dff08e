//! What this session could have shown: the smallest size of every effect found with 90 % probability.

use super::effects::HETEROSCEDASTIC_NOISE;
use super::frame::Declared;
use super::parameters::{Names, physical};
use super::system::ScalarSystem;
use crate::candidate::System;
use crate::engine::fit::Fit;
use crate::engine::gate::{CATALOGUE_LEVEL, Gate};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wcal_core::verify_document::Detectable;

/// Normal quantile of 90 % power.
const POWER_90: f64 = 1.281_551_565_545;

/// Single p-value whose family-wise value is `level`, by bisection.
fn critical(gate: &Gate, level: f64) -> f64 {
    let (mut low, mut high) = (-60.0_f64, 0.0_f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if gate.family.adjusted(middle.exp()) <= level { low = middle } else { high = middle }
    }
    low.exp()
}

/// Name of a law as a reader of this kind of session has it; calibration.json keeps the catalogue's.
fn law_name(system: &ScalarSystem, name: &str) -> String {
    if system.frame.declared == Declared::Axis {
        name.replace("stimulus", "position")
    } else {
        name.to_owned()
    }
}

/// One row an effect; sizes at the shape that this session shows best. `gate` is the gate on `fit`.
#[must_use]
pub fn table(system: &ScalarSystem, fit: &Fit, gate: &Gate, names: &Names) -> Vec<Detectable> {
    let sd = fit.variance().sqrt();
    let single = critical(gate, CATALOGUE_LEVEL);
    let entry = |e: usize, status: &str, smallest: Option<f64>, unit: String, why: String| Detectable {
        id: system.catalogue()[e].id().to_owned(),
        smallest,
        unit,
        status: status.to_owned(),
        why,
    };
    (0..system.catalogue().len())
        .map(|e| {
            let candidate = &system.catalogue()[e];
            if let Some(why) = system.not_observable(e) {
                return entry(e, "not-observable", None, "1".into(), system.frame.declared.worded(&why));
            }
            if candidate.id() == HETEROSCEDASTIC_NOISE {
                let why = "tested by the trend of the squared residuals";
                return entry(e, "testable", None, "1".into(), why.into());
            }
            let laws = candidate.laws();
            if laws.iter().all(|l| l.parameters.is_empty() && l.linear.is_empty()) {
                let why = "single readings far outside the noise are flagged";
                return entry(e, "testable", Some(1.0), "readings".into(), why.into());
            }
            if fit.terms.iter().any(|t| t.effect == e) {
                return entry(e, "testable", None, "1".into(), "part of the accepted model".into());
            }
            let best = gate
                .atoms
                .iter()
                .filter(|a| a.term.effect == e)
                .filter_map(|a| {
                    let law = &laws[a.term.law];
                    let chi = ChiSquared::new(a.dimension() as f64).ok()?;
                    let needed = chi.inverse_cdf(1.0 - single).sqrt() + POWER_90;
                    let (slot_unit, probe) = match a.amplitudes.first() {
                        Some((slot, probe)) => (law.parameters[*slot].unit, probe.abs()),
                        None => (law.linear.first()?.1, 1.0),
                    };
                    let size = a.projected.first()?.norm();
                    let smallest = needed * sd * probe / size;
                    let (value, unit) = physical(slot_unit, smallest, a.term.law, &system.frame, names);
                    (size > 0.0).then_some((a.term.law, needed, value, unit, a.share_left, law.name))
                })
                .min_by(|a, b| (a.0, a.2).0.cmp(&(b.0, b.2).0).then(a.2.total_cmp(&b.2)));
            match best {
                Some((_, _, smallest, unit, share, law)) => {
                    let left = 100.0 * share;
                    let law = law_name(system, law);
                    let why = format!("law {law}; {left:.0} % of its signature is left beside the fitted model");
                    entry(e, "testable", Some(smallest), unit, why)
                }
                None => {
                    let why = "the declared model and what is accepted take up its whole signature: it cannot do harm here nor be named";
                    entry(e, "absorbed", None, "1".into(), why.into())
                }
            }
        })
        .collect()
}
