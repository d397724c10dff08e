//! Laws of one kind of sensor: a logarithmic scale, and the thermometers of the standards.

use crate::effect::{Effect, EffectModel, law};
use crate::scalar::frame::{Frame, correlation};
use crate::scalar::scalar_effect::ScalarEffect;

/// 0 degC in kelvin.
const ICE_POINT: f64 = 273.15;
/// Over less than this factor a logarithm is a bend like any other.
const MIN_RATIO: f64 = 3.0;

/// Logarithms of values that all have one sign and span a factor of [`MIN_RATIO`].
fn logarithms(values: &[f64]) -> Option<Vec<f64>> {
    let sign = values.first()?.signum();
    let sizes: Vec<f64> = values.iter().map(|v| sign * v).collect();
    let (low, high) = sizes
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(a, b), v| (a.min(*v), b.max(*v)));
    (low > 0.0 && high > MIN_RATIO * low).then(|| sizes.iter().map(|v| v.ln()).collect())
}

/// Whether the response is straighter on its own logarithmic scale (true), or over the logarithm of
/// the stimulus (false).
fn straighter(frame: &Frame, of_response: bool) -> bool {
    let (x, y): (Vec<f64>, Vec<f64>) = frame.rows.iter().map(|r| (r.x, r.y)).unzip();
    let plain = correlation(&x, &y).abs();
    let bent = if of_response {
        logarithms(&y).map(|l| correlation(&x, &l))
    } else {
        logarithms(&x).map(|l| correlation(&l, &y))
    };
    bent.is_some_and(|r| r.abs() > plain)
}

/// A characteristic over decades: exponential in the stimulus or in the inverse absolute
/// temperature (thermistor, IEC 60539-1: R = R0 exp(B/T - B/T0)), or in proportion to the logarithm
/// of the stimulus (Nernst electrode, gas sensor; Steinhart & Hart 1968 in ln R).
pub(crate) fn logarithmic_scale() -> ScalarEffect {
    let exponential = law("exponential")
        .shape(
            "exponent",
            "1/half-range",
            [0.5, 12.0],
            &[0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0],
        )
        .column("size", "response");
    let falling = EffectModel {
        name: "falling-exponential",
        ..exponential.clone()
    };
    let by_temperature = law("b-parameter")
        .shape(
            "b",
            "K",
            [200.0, 20e3],
            &[500.0, 1e3, 2e3, 3e3, 3.5e3, 4e3, 5e3, 7e3, 1e4],
        )
        .column("size", "response");
    let powers = |name, count| law(name).columns(count, "coefficient", "response");
    ScalarEffect {
        bend: true,
        not_observable: |frame| {
            let none = !straighter(frame, true) && !straighter(frame, false);
            none.then(|| "neither stimulus nor response is straighter on a logarithmic scale".to_owned())
        },
        columns: |values, frame| {
            let known = frame.new_rows;
            let of = |f: &dyn Fn(f64) -> f64| Some(vec![frame.u.iter().map(|u| f(*u)).collect::<Vec<f64>>()]);
            match values.law() {
                // About the end of the range where it is largest: the column stays within 1.
                "exponential" if known || straighter(frame, true) => of(&|u| (values.all()[0] * (u - 1.0)).exp()),
                "falling-exponential" if known || straighter(frame, true) => {
                    of(&|u| (-values.all()[0] * (u + 1.0)).exp())
                }
                "b-parameter" if known || straighter(frame, true) => {
                    let zero = frame.scaling.absolute_zero?;
                    let kelvin = |u: f64| frame.scaling.mid + frame.scaling.half * u - zero;
                    // The largest value is 1: that at the lowest temperature.
                    (kelvin(-1.0) > 0.0).then_some(())?;
                    of(&|u| (values.all()[0] * (1.0 / kelvin(u) - 1.0 / kelvin(-1.0))).exp())
                }
                "logarithm" | "logarithm-cubic" if known || straighter(frame, false) => {
                    let log = logarithms(&frame.rows.iter().map(|r| r.x).collect::<Vec<f64>>());
                    let log = if known { Some(frame.rows.iter().map(|r| r.x.abs().ln()).collect()) } else { log }?;
                    // About the middle the powers of the logarithm are hardly correlated.
                    let middle = (frame.scaling.mid.abs()).ln();
                    let power = |k: i32| log.iter().map(|l| (l - middle).powi(k)).collect::<Vec<f64>>();
                    Some((1..=values.linear() as i32).map(power).collect())
                }
                _ => None,
            }
        },
        ..Effect {
            refinements: vec![powers("logarithm-cubic", 3)],
            ..Effect::new(
                "logarithmic-scale",
                "The characteristic is logarithmic: on a logarithmic scale of the response, or of the stimulus, it is nearly straight.",
                vec![exponential, falling, by_temperature, powers("logarithm", 1)],
            )
        }
        .into()
    }
}

/// The term of a platinum thermometer below 0 degC (IEC 60751: R = R0 (1 + A t + B t^2 + C
/// (t - 100) t^3)).
pub(crate) fn callendar_van_dusen() -> ScalarEffect {
    ScalarEffect {
        bend: true,
        not_observable: |frame| {
            let ice = frame.scaling.absolute_zero.map(|zero| zero + ICE_POINT);
            let below = ice.is_some_and(|ice| frame.rows.iter().any(|r| r.x < ice));
            (!below).then(|| "no temperature below 0 degC was taken as the stimulus".to_owned())
        },
        columns: |_, frame| {
            let ice = frame.scaling.absolute_zero? + ICE_POINT;
            let term = |x: f64| {
                if x < ice {
                    // (t - 100) t^3 with t in degC, whatever scale the stimulus has.
                    (x - ice - 100.0) * (x - ice).powi(3)
                } else {
                    0.0
                }
            };
            Some(vec![frame.rows.iter().map(|r| term(r.x)).collect()])
        },
        ..ScalarEffect::new(
            "callendar-van-dusen",
            "Below 0 degC the resistance has the fourth-order term of a platinum thermometer (IEC 60751).",
            vec![law("below-zero").column("c", "response/stimulus^4")],
        )
    }
}
