//! Does an existing calibration hold on readings that were not in its fit?
//!
//! With the errors e of what it infers and the standard deviations s that it states, it holds where
//! its 95 % intervals cover at least 80 % and `rms(e / s) <= 2`: looser than the statement itself,
//! because readings of one session share what a calibration has wrong.

use super::error_summary::{coverage95, summarise};
use super::session_model::{HeldOut, Quantity};
use wcal_core::verify_document::CalibrationJudgement;

/// Least coverage of stated 95 % intervals.
pub(crate) const MIN_COVERAGE: f64 = 0.8;
/// Largest error in stated standard deviations, root mean square.
pub const MAX_RATIO: f64 = 2.0;

/// The judgement over readings through the calibration; none without any.
pub fn judge(readings: &[HeldOut], quantities: &[Quantity]) -> Option<CalibrationJudgement> {
    let error = summarise(readings, quantities, "holdout")?;
    let coverage95 = coverage95(readings)?;
    let of = |r: &HeldOut| {
        r.errors[0]
            .iter()
            .zip(&r.stated_sd[0])
            .map(|(e, sd)| e / sd)
            .collect::<Vec<f64>>()
    };
    let all: Vec<f64> = readings.iter().flat_map(of).collect();
    // In its own units the errors of a calibration that states its spread rightly have the rms 1.
    let ratio = (all.iter().map(|z| z * z).sum::<f64>() / all.len().max(1) as f64).sqrt();
    let mut why = Vec::new();
    if !(coverage95 >= MIN_COVERAGE) {
        why.push(format!(
            "its 95 % intervals hold {:.0} % of the readings",
            100.0 * coverage95
        ));
    }
    if !(ratio <= MAX_RATIO) {
        why.push(format!("the errors are {ratio:.1} times what it states"));
    }
    let (holds, why) = match why[..] {
        [] => {
            let covered = format!("its 95 % intervals hold {:.0} %", 100.0 * coverage95);
            (
                true,
                format!("{covered}, the errors are {ratio:.2} times what it states"),
            )
        }
        _ => (false, why.join("; ")),
    };
    let finite = ratio.is_finite().then_some(ratio);
    Some(CalibrationJudgement {
        error,
        coverage95,
        ratio: finite,
        holds,
        why,
        ..CalibrationJudgement::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_holds_that_is_as_good_as_it_says_and_no_other() {
        let quantity = [Quantity {
            key: "response_rmse",
            unit: "",
        }];
        let readings = |size: f64| -> Vec<HeldOut> {
            let of = |k: u32| {
                let z = size * (f64::from(k) - 9.5) / 5.8;
                let stated_sd = vec![vec![1.0]];
                HeldOut {
                    group: k,
                    errors: vec![vec![z]],
                    stated_sd,
                    inside95: vec![z.abs() < 1.96],
                }
            };
            (0..20).map(of).collect()
        };
        assert!(judge(&readings(1.0), &quantity).unwrap().holds);
        let wrong = judge(&readings(4.0), &quantity).unwrap();
        assert!(
            !wrong.holds && wrong.why.contains("4.0 times"),
            "{}",
            wrong.why
        );
        assert!(judge(&[], &quantity).is_none());
    }
}
