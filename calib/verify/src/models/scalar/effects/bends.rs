//! Bends: laws of the stimulus alone. They compete for one shape, so each is judged beside the
//! others (`scalar::bends`).

use crate::effect::LawRequirement::Slope;
use crate::effect::{Effect, EffectModel, Values, law};
use crate::scalar::frame::Frame;
use crate::scalar::scalar_effect::ScalarEffect;

/// Identifier of the polynomial that is taken where no plainer law does.
pub(crate) const POLYNOMIAL: &str = "nonlinearity-polynomial";
/// Highest degree of that polynomial: beyond it equal steps of the stimulus make it swing between
/// the places (Runge).
const MAX_DEGREE: usize = 9;

/// Law of an odd response.
const ABOUT_ZERO: &str = "power-3-about-zero";
/// Within this share of the half range zero is inside: the cubic's own part is a third of it and
/// more.
const TWO_SIDED: f64 = 0.5;
/// Further out than this from the middle, zero is no part of what was measured.
const FAR: f64 = 1.2;

/// Fewer stimuli than this do not say whether a polynomial holds between them.
const MIN_PLACES: usize = 6;

/// A term in the square of the stimulus, about the middle of the range (NIST/SEMATECH e-Handbook
/// 4.6.1, load cell).
pub(crate) fn nonlinearity_quadratic() -> ScalarEffect {
    ScalarEffect {
        bend: true,
        degree: Some(2),
        columns: |_, frame| Some(vec![frame.u.iter().map(|u| u.powi(2)).collect()]),
        ..ScalarEffect::new(
            "nonlinearity-quadratic",
            "Quadratic nonlinearity: the response has a term in the square of the stimulus.",
            vec![law("power-2").column("coefficient", "response/half-range^2")],
        )
    }
}

/// A term in the cube of the stimulus, about the middle of the range, or about zero (an odd
/// response).
///
/// ```text
/// (u - u0)^3 = u^3 - 3 u0 u^2 + ...      u0: stimulus zero; about the middle the square has its own coefficient
/// ```
pub(crate) fn nonlinearity_cubic() -> ScalarEffect {
    let cube = |name| law(name).column("coefficient", "response/half-range^3");
    ScalarEffect {
        bend: true,
        degree: Some(3),
        looks_like: |law, frame| {
            let one_sided = law.name == ABOUT_ZERO && frame.zero_u.abs() > TWO_SIDED;
            one_sided.then_some("nonlinearity-quadratic")
        },
        columns: |values, frame| {
            let centre = if values.law() == ABOUT_ZERO {
                frame.zero_u
            } else {
                0.0
            };
            // About the middle of the range both laws are one; far outside it nothing says that
            // zero is the centre.
            if values.law() == ABOUT_ZERO && !frame.new_rows && !(1e-3..FAR).contains(&centre.abs())
            {
                return None;
            }
            Some(vec![frame.u.iter().map(|u| (u - centre).powi(3)).collect()])
        },
        ..ScalarEffect::new(
            "nonlinearity-cubic",
            "Cubic nonlinearity: the response has a term in the cube of the stimulus.",
            vec![cube("power-3"), cube(ABOUT_ZERO).needing(&[Slope])],
        )
    }
}

/// A polynomial of a higher degree: the powers that the declared one lacks, all at once.
///
/// Of a smooth characteristic that repeats (a thermocouple, a Hall sensor) no power is a separate
/// finding.
pub(crate) fn polynomial(declared: usize) -> ScalarEffect {
    const NAMES: [&str; MAX_DEGREE + 1] = [
        "", "", "", "degree-3", "degree-4", "degree-5", "degree-6", "degree-7", "degree-8",
        "degree-9",
    ];
    let to =
        |k: usize| law(NAMES[k]).columns(k.saturating_sub(declared), "coefficient", "response");
    ScalarEffect {
        bend: true,
        not_observable: |frame| {
            (frame.levels() < MIN_PLACES).then(|| format!("fewer than {MIN_PLACES} stimuli"))
        },
        columns: |values, frame| {
            // The powers above the declared ones, named by the highest.
            let degree: i32 = values.law().rsplit('-').next()?.parse().ok()?;
            let lacking = values.linear() as i32;
            Some(
                (degree - lacking + 1..=degree)
                    .map(|k| frame.u.iter().map(|u| u.powi(k)).collect())
                    .collect(),
            )
        },
        ..Effect {
            // Any bend is one of these: they are no rivals of a law, and are tried only where every
            // law fails.
            refinements: (3..=MAX_DEGREE).map(to).collect(),
            ..Effect::new(
                POLYNOMIAL,
                "Smooth nonlinearity: a polynomial of a higher degree follows the characteristic.",
                Vec::new(),
            )
        }
        .into()
    }
}

/// The sensitivity changes at a knee by the share `gained`, on the side that lies away from
/// stimulus zero; false where the knee has no such side.
fn hinge(values: &Values, frame: &Frame, u: &mut [f64], gained: f64) -> bool {
    let knee = values.of("knee");
    let upper = values.law() == "upper-knee";
    // Toward zero a lost slope is a dead zone.
    let away = if upper {
        knee >= frame.zero_u
    } else {
        knee <= frame.zero_u
    };
    for v in u.iter_mut() {
        // Continuous at the knee: the slope alone changes there.
        *v += gained
            * if upper {
                (*v - knee).max(0.0)
            } else {
                (*v - knee).min(0.0)
            };
    }
    away
}

/// The two laws of a hinge, with a share of the slope in `range`.
fn hinges(share: &'static str, range: [f64; 2]) -> Vec<EffectModel> {
    const UPPER: &[f64] = &[-0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8];
    const LOWER: &[f64] = &[-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4];
    let knee = |name, places, grid| {
        let changed = law(name)
            .needing(&[Slope])
            .amplitude(share, "1", range, 0.2);
        changed.shape("knee", "stimulus", places, grid)
    };
    vec![
        knee("upper-knee", [-0.9, 0.98], UPPER),
        knee("lower-knee", [-0.98, 0.9], LOWER),
    ]
}

/// Saturation: beyond a knee, away from zero, the response follows the stimulus less or not at all
/// (limit stop or full-scale limit, piecewise linear).
pub(crate) fn saturation() -> ScalarEffect {
    ScalarEffect {
        bend: true,
        warp: |values, frame, u| hinge(values, frame, u, -values.of("slope_lost")),
        ..ScalarEffect::new(
            "saturation",
            "Saturation: above a threshold the sensitivity decreases.",
            // A share of one is complete saturation.
            hinges("slope_lost", [0.0, 1.0]),
        )
    }
}

/// Knee: two straight pieces, the steeper one away from zero (calibration by pieces).
pub(crate) fn knee() -> ScalarEffect {
    ScalarEffect {
        bend: true,
        warp: |values, frame, u| hinge(values, frame, u, values.of("slope_gained")),
        // There can be one on either side of zero.
        ..Effect {
            superposes: true,
            ..Effect::new(
                "knee",
                "Two slopes: the sensitivity changes at a knee, and the response follows the stimulus on both sides of it.",
                hinges("slope_gained", [0.0, 20.0]),
            )
        }
        .into()
    }
}

/// Dead zone: near zero next to nothing of the slope remains (play or threshold, piecewise linear).
/// A slope that is merely smaller there is a knee.
pub(crate) fn dead_zone() -> ScalarEffect {
    let about_zero = law("about-zero")
        .needing(&[Slope])
        .amplitude("slope_lost", "1", [0.8, 1.0], 0.2)
        .shape(
            "half_width",
            "half-range",
            [0.005, 1.6],
            &[0.05, 0.1, 0.2, 0.4, 0.8],
        );
    ScalarEffect {
        bend: true,
        not_observable: |frame| {
            let outside = frame.zero_u.abs() > 1.2;
            outside.then(|| "no reading was taken near stimulus zero".to_owned())
        },
        warp: |values, frame, u| {
            let (share, width) = (values.of("slope_lost"), values.of("half_width"));
            for v in u {
                // Inside the zone the slope is less by the share; outside, the loss is constant.
                *v -= share * (*v - frame.zero_u).clamp(-width, width);
            }
            true
        },
        ..ScalarEffect::new(
            "dead-zone",
            "Dead zone: near zero the response does not follow the stimulus.",
            vec![about_zero],
        )
    }
}
