//! What this data could have shown: the smallest size of every effect found with 90 % probability.

use crate::candidate::System;
use crate::engine::fit::Fit;
use crate::engine::gate::{CATALOGUE_LEVEL, Gate};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wcal_core::verify_document::Detectable;

/// Normal quantile of 90 % power.
const POWER_90: f64 = 1.281_551_565_545;

/// One row an effect. `gate` is the gate on `fit`.
#[must_use]
pub fn table(system: &dyn System, fit: &Fit, gate: &Gate) -> Vec<Detectable> {
    let sd = fit.variance().sqrt();
    let critical = gate.family.critical(CATALOGUE_LEVEL);
    system
        .catalogue()
        .iter()
        .enumerate()
        .map(|(e, candidate)| {
            let laws = candidate.laws();
            let unit = laws
                .first()
                .and_then(|l| l.parameters.first().map(|p| p.unit).or(l.linear.first().map(|c| c.1)))
                .unwrap_or("readings")
                .to_owned();
            let row = |status: &str, smallest: Option<f64>, why: String| Detectable {
                id: candidate.id().to_owned(),
                smallest,
                unit: unit.clone(),
                status: status.to_owned(),
                why,
            };
            if let Some(why) = system.not_observable(e) {
                return row("not-observable", None, why);
            }
            if laws[0].parameters.is_empty() && laws[0].linear.is_empty() {
                return row("testable", Some(1.0), "single readings far outside the noise are flagged".into());
            }
            if fit.terms.iter().any(|t| t.effect == e) {
                return row("testable", None, "part of the accepted model".into());
            }
            let best = gate
                .atoms
                .iter()
                .filter(|a| a.term.effect == e && a.term.law == 0)
                .filter_map(|a| {
                    let needed = (ChiSquared::new(a.dimension() as f64).ok()?.inverse_cdf(1.0 - critical)).sqrt() + POWER_90;
                    let probe = a.amplitudes.first().map_or(1.0, |x| x.1.abs());
                    let size = a.projected.first()?.norm();
                    (size > 0.0).then(|| (needed * sd * probe / size, a.share_left))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            match best {
                Some((smallest, share)) => {
                    let why = format!(
                        "{:.0} % of its signature is left once K, the zero and what is accepted have taken their part",
                        100.0 * share
                    );
                    row("testable", Some(smallest), why)
                }
                None => row(
                    "absorbed",
                    None,
                    "K and the zero take up its whole signature on these poses; it cannot do harm here nor be named".into(),
                ),
            }
        })
        .collect()
}
