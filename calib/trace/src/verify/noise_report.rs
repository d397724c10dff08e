//! The noise in parts, as `verify.json` and a reader have it.

use crate::method::noise::Noise;
use wcal_core::verify_document::{CorrelatedNoise, NoiseDocument, NoiseLaw, NoisePart};

/// Standard deviation of a value that is rounded to a step: uniform over the step.
fn rounding_sd(step: f64) -> f64 {
    step / 12f64.sqrt()
}

/// The parts, `session` from several sessions; what the design cannot tell is absent.
pub fn noise_document(noise: &Noise, session: Option<NoisePart>, unit: &str) -> NoiseDocument {
    let step = noise.step.iter().flatten().copied().fold(0.0, f64::max);
    let rounding =
        (step > 0.0).then(|| NoisePart { value: rounding_sd(step), interval95: [rounding_sd(step); 2] });
    let heavy = noise.tails.filter(|t| t.heavy);
    NoiseDocument {
        repeat: Some(noise.repeat),
        pose: noise.pose,
        session,
        correlated: noise.correlated.map(|(sd, tau)| CorrelatedNoise {
            sd: sd.value,
            interval95: sd.interval95,
            time_constant_s: tau,
        }),
        rounding,
        tails_dof: heavy.map(|t| NoisePart { value: t.dof, interval95: [t.heaviest, t.lightest.min(1e3)] }),
        // Load and depth go from 0 to 1.
        law: noise.law.as_ref().map(|l| NoiseLaw {
            follows: l.follows.clone(),
            ratio: l.spread.exponent.exp(),
            interval95: l.spread.interval95.map(f64::exp),
        }),
        unit: unit.to_owned(),
    }
}

/// The noise in one or two plain sentences; none where there is nothing to say beyond its size.
pub fn noise_sentences(noise: &NoiseDocument) -> Vec<String> {
    let unit = &noise.unit;
    let mut out = Vec::new();
    if let (Some(repeat), Some(pose)) = (noise.repeat, noise.pose.filter(|p| p.interval95[0] > 0.0)) {
        out.push(format!(
            "Repeats of a held pose agree to {:.3} {unit}; setting the pose anew adds {:.3} [{:.3}, {:.3}] {unit}.",
            repeat.value, pose.value, pose.interval95[0], pose.interval95[1]
        ));
    }
    if let Some(c) = noise.correlated {
        out.push(format!(
            "Part of the noise is correlated in time: {:.3} [{:.3}, {:.3}] {unit} with a time constant of {:.0} s; an effect is named only where \
             it goes beyond that.",
            c.sd, c.interval95[0], c.interval95[1], c.time_constant_s
        ));
    }
    if let Some(law) = &noise.law {
        let (more, ratio) = if law.ratio >= 1.0 { ("more", law.ratio) } else { ("less", 1.0 / law.ratio) };
        out.push(format!(
            "The readings scatter {ratio:.1} times {more} at the largest {} than at the smallest.",
            law.follows
        ));
    }
    if let Some(tails) = noise.tails_dof {
        out.push(format!(
            "The noise has heavier tails than a Gaussian (Student's t with {:.0} degrees of freedom [{:.0}, {:.0}]).",
            tails.value, tails.interval95[0], tails.interval95[1]
        ));
    }
    if let Some(rounding) = noise.rounding {
        out.push(format!("Values are rounded: {:.3} {unit} of the noise at least.", rounding.value));
    }
    out
}
