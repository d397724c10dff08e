//! Fitted values in the session's units, with intervals.

use super::effects::{PERIODIC, ZERO_BY_SERIES, of_a_turn};
use super::frame::{Frame, Names};
use super::system::ScalarSystem;
use crate::effect::Values;
use crate::levels::NORMAL_95;
use crate::method::{Fit, Hypothesis, covariance, linear, t95};
use crate::{EffectTerm, MeasurementModel};
use nalgebra::DMatrix;
use wcal_core::verify_document::EffectParameter;

/// A unit over others with their powers: "V/kPa^2", "um/(1/m)". Quantities without a unit ("1")
/// leave no trace, so that 1/1^2 is 1.
pub fn ratio(numerator: &str, denominators: &[(&str, i32)]) -> String {
    let plain = |unit: &str| matches!(unit.trim(), "" | "1");
    let whole = |unit: &str| {
        let unit = unit.trim();
        if unit.contains(['/', '*', '^', ' ', '\u{b7}']) {
            format!("({unit})")
        } else {
            unit.to_owned()
        }
    };
    let divided = |(unit, power): &(&str, i32)| match power {
        _ if plain(unit) => String::new(),
        2.. => format!("/{}^{power}", whole(unit)),
        _ => format!("/{}", whole(unit)),
    };
    let below: String = denominators.iter().map(divided).collect();
    match (plain(numerator), below.is_empty()) {
        (true, _) => format!("1{below}"),
        (false, true) => numerator.to_owned(),
        (false, false) => whole(numerator) + &below,
    }
}

/// A catalogue value (see `effects`) in the session's units. `law` chooses the covariate of
/// `cross-axis`.
pub fn physical(unit: &str, value: f64, law: usize, frame: &Frame, names: &Names) -> (f64, String) {
    let s = &frame.scaling;
    let half = s.half_range();
    // n readings have n - 1 steps between them.
    let readings = s.count.max(2) as f64 - 1.0;
    let (response, stimulus) = (&names.response, &names.stimulus);
    let duration = s.time.map_or(1.0, |t| t[1]);
    if let Some(power) = unit.strip_prefix("response/half-range") {
        let (power, rest) = match power {
            "" => (1, ""),
            "/degc" => (1, "degc"),
            p => (p.trim_start_matches('^').parse::<i32>().unwrap_or(1), ""),
        };
        return (
            // u = (x - mid) / half: a coefficient of u^k is half^k of one of x^k.
            value / half.powi(power),
            ratio(response, &[(stimulus, power), (rest, 1)]),
        );
    }
    match unit {
        "half-range" => (value * half, stimulus.clone()),
        "stimulus" => (s.mid + half * value, stimulus.clone()),
        "duration" => (value * duration, "s".to_owned()),
        "clock" => match s.time {
            Some([first, _]) => (first + duration * value, "s".to_owned()),
            None => (1.0 + readings * value, "reading".to_owned()),
        },
        "1/half-range" => (value / half, ratio("1", &[(stimulus, 1)])),
        "response/stimulus^4" => (value, ratio(response, &[(stimulus, 4)])),
        // The catalogue counts cycles over the whole range, the session states their length.
        "period:stimulus" => (2.0 * half / value, stimulus.clone()),
        "period:time" => (duration / value, "s".to_owned()),
        "period:order" => (readings / value, "readings".to_owned()),
        "response" => (value, response.clone()),
        "response/degc" => (value, ratio(response, &[("degc", 1)])),
        "response/duration" => match s.time {
            Some(_) => (value / duration, ratio(response, &[("s", 1)])),
            None => (value / readings, ratio(response, &[("reading", 1)])),
        },
        "response/covariate" => {
            let half = s.covariates.get(law).map_or(1.0, |c| c[1]);
            let name = names
                .covariates
                .get(law)
                .map_or("covariate", String::as_str);
            (value / half, ratio(response, &[(name, 1)]))
        }
        other => (value, other.to_owned()),
    }
}

fn ordered([a, b]: [f64; 2]) -> [f64; 2] {
    [a.min(b), a.max(b)]
}

/// Parameters of one effect of a fit, in the session's units, with 95 % intervals.
pub(crate) fn of_effect(
    system: &ScalarSystem,
    h: &Hypothesis,
    effect: usize,
    names: &Names,
) -> Vec<EffectParameter> {
    let fit = &h.fit;
    let covariance = covariance(fit, fit.variance());
    let q = fit.design.ncols();
    let t = t95(fit.dof);
    let mut out: Vec<EffectParameter> = Vec::new();
    let owner = &system.effects[effect];
    let terms = fit
        .terms
        .iter()
        .zip(fit.slots(system.catalogue()))
        .filter(|(t, _)| t.effect == effect);
    for (instance, (term, slots)) in terms.enumerate() {
        let law = &system.catalogue()[effect].law(term.law);
        // A further term of the effect: its values are numbered.
        let suffix = if instance > 0 {
            format!("_{}", instance + 1)
        } else {
            String::new()
        };
        if let Some(Some(period)) = of_a_turn(law.name, &system.frame) {
            let unit = names.stimulus.clone();
            out.push(EffectParameter {
                name: format!("period{suffix}"),
                value: period,
                unit,
                interval95: [period; 2],
            });
        }
        let mut push = |name: &str, unit: &str, value: f64, half: [f64; 2], lowest: f64| {
            let at = |v: f64| physical(unit, v, term.law, &system.frame, names);
            let (value_out, unit_out) = at(value);
            out.push(EffectParameter {
                name: format!("{name}{suffix}"),
                value: value_out,
                unit: unit_out,
                interval95: ordered([at((value - half[0]).max(lowest)).0, at(value + half[1]).0]),
            });
        };
        for ((p, v), k) in law.parameters.iter().zip(&term.values).zip(slots.values) {
            let unseen = (owner.systematic_sd)(
                &Values::new(law, term.law, &term.values),
                &system.frame,
                p.name,
            );
            // What no reading shows is independent of the fit: both half widths add in squares.
            let half = (t * covariance[(q + k, q + k)].max(0.0).sqrt()).hypot(NORMAL_95 * unseen);
            // The place of a change has no derivative: readings tell between which of them it lies.
            let place = p.name == "place";
            let halves = if half > 0.0 && !place {
                [half; 2]
            } else {
                reach95(system, h, k, *v, p.range)
            };
            // What is positive by its nature has no interval below zero.
            let lowest = if p.range[0] >= 0.0 && !place {
                1e-9 * v.abs()
            } else {
                f64::MIN
            };
            push(p.name, p.unit, *v, halves, lowest);
        }
        let column = slots.columns.start;
        for (k, (name, unit)) in law.linear.iter().enumerate() {
            let half = t * covariance[(column + k, column + k)].max(0.0).sqrt();
            // Columns of one name are numbered: powers, series.
            let several = law.linear.iter().filter(|l| l.0 == *name).count() > 1;
            let numbered = if several {
                format!("{name}_{}", k + 1)
            } else {
                (*name).to_owned()
            };
            push(
                &numbered,
                unit,
                fit.coefficients[(column + k, 0)],
                [half; 2],
                f64::MIN,
            );
        }
        if system.catalogue()[effect].id == PERIODIC {
            derived(&mut out, &suffix, fit, column, &covariance, t);
        }
    }
    out
}

/// Variance of another series' zero about the mean of k zeros, s^2 (1 + 1/k), as a normal one of
/// the same 95 % interval (Student's t with k - 1 degrees of freedom); 0 where they have one zero.
pub(crate) fn zero_scatter(system: &ScalarSystem, fit: &Fit) -> f64 {
    let is_zero = |t: &EffectTerm| system.catalogue()[t.effect].id == ZERO_BY_SERIES;
    let slots = fit.terms.iter().zip(fit.slots(system.catalogue()));
    let Some((_, own)) = slots.into_iter().find(|(term, _)| is_zero(term)) else {
        return 0.0;
    };
    let shifts: Vec<f64> = own.columns.map(|k| fit.coefficients[(k, 0)]).collect();
    let (square, sum): (f64, f64) = (shifts.iter().map(|s| s * s).sum(), shifts.iter().sum());
    // Sum-to-zero contrasts: the first series has minus the sum of the others.
    let dof = shifts.len() as f64;
    (square + sum * sum) / dof * (1.0 + 1.0 / (dof + 1.0)) * (t95(dof) / NORMAL_95).powi(2)
}

/// How far nonlinear value `slot` can move in its range, down and up, until its sum of squares, with
/// the coefficients that suit it, rises by what a 95 % interval of the likelihood allows:
/// chi-squared of one degree of freedom. Readings weigh as in the fit.
fn reach95(
    system: &ScalarSystem,
    Hypothesis { fit, weights, .. }: &Hypothesis,
    slot: usize,
    value: f64,
    range: [f64; 2],
) -> [f64; 2] {
    let measured = weights.apply(system.measured());
    let ssr = |v: f64| {
        let mut terms = fit.terms.clone();
        *terms.iter_mut().flat_map(|t| &mut t.values).nth(slot)? = v;
        let design = weights.apply(&system.design(&terms)?);
        Some(linear(&design, &measured).1.norm_squared())
    };
    let Some(least) = ssr(value) else {
        return [0.0; 2];
    };
    // The rounding of sums that are equal.
    // S(v) - S_min = s^2 chi^2(1) at the ends of a profile likelihood interval.
    let most = least * (1.0 + 1e-9) + least / fit.dof.max(1.0) * NORMAL_95.powi(2);
    range.map(|end| {
        // Bisection for the last place that is as good.
        let (mut inside, mut outside) = (0.0, 1.0);
        for _ in 0..30 {
            let middle = 0.5 * (inside + outside);
            let good = ssr(value + middle * (end - value)).is_some_and(|at| at <= most);
            if good {
                inside = middle
            } else {
                outside = middle
            }
        }
        (inside * (end - value)).abs()
    })
}

/// Frequency and amplitude of a periodic effect, from its period, sine and cosine.
fn derived(
    out: &mut Vec<EffectParameter>,
    suffix: &str,
    fit: &Fit,
    column: usize,
    covariance: &DMatrix<f64>,
    t: f64,
) {
    let named = |name: &str| format!("{name}{suffix}");
    let Some(period) = out.iter().find(|p| p.name == named("period")).cloned() else {
        return;
    };
    out.push(EffectParameter {
        name: named("frequency"),
        value: 1.0 / period.value,
        unit: ratio("1", &[(&period.unit, 1)]),
        interval95: ordered(period.interval95.map(|v| 1.0 / v)),
    });
    let waves = fit.coefficients.fixed_view::<2, 1>(column, 0).clone_owned();
    let size = waves.norm();
    if size > 0.0 {
        // g' C g, g along sine and cosine.
        let along = waves / size;
        let variance = along.dot(&(covariance.fixed_view::<2, 2>(column, column) * along));
        let half = t * variance.max(0.0).sqrt();
        let sine = out.iter().find(|p| p.name == named("sine"));
        let unit = sine.map_or(String::new(), |p| p.unit.clone());
        out.push(EffectParameter {
            name: named("amplitude"),
            value: size,
            unit,
            interval95: [(size - half).max(0.0), size + half],
        });
    }
}

#[cfg(test)]
mod tests {
    use super::ratio;

    #[test]
    fn units_are_composed_and_ones_leave_no_trace() {
        for (numerator, denominators, composed) in [
            ("1", &[("1", 2)][..], "1"),
            ("V", &[("1", 1), ("", 1)], "V"),
            ("V", &[("kPa", 2), ("degc", 1)], "V/kPa^2/degc"),
            ("pm", &[("1/m", 2)], "pm/(1/m)^2"),
            ("um/mm", &[("N", 1)], "(um/mm)/N"),
            ("1", &[("s", 1)], "1/s"),
        ] {
            assert_eq!(ratio(numerator, denominators), composed);
        }
    }
}
