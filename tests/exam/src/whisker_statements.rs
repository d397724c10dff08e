//! How often what `verify` states of whiskers holds: intervals of parameters, of the noise and of
//! moments that were held out, sizes that would show, p values. SIMULATED.
//!
//! A detectable size is put into the very session that stated it, its noise included; a law of two
//! channels acts on the first.

use crate::orders::{Drawn, Order, orders};
use crate::run::{Paper, answer};
use crate::score::Outcome;
use crate::statements::{Auditor, Counted, Labelled, StatementRow, holds, of_null, tallied};
use anyhow::Context;
use serde_json::Value;
use wcal_plant::case::Case;
use wcal_plant::contacts::expected_error_mm;
use wcal_plant::{Effect, Kind, Noise};

/// Longest time of one judgement, s.
const TIMEOUT_S: f64 = 240.0;

/// Laws of one number that plant and program share: identifier, law of verify.json, the plant's,
/// and its further numbers.
const LAWS: [(&str, &str, Kind, &[f64]); 7] = [
    ("groove-friction", "coulomb", Kind::FrictionCoulomb, &[]),
    (
        "stage-backlash",
        "play-from-loading",
        Kind::BacklashApproach,
        &[],
    ),
    ("time-lag", "pose", Kind::LagPose, &[]),
    (
        "base-compliance",
        "isotropic",
        Kind::ComplianceIsotropic,
        &[],
    ),
    (
        "temperature-mismatch",
        "linear",
        Kind::TemperatureLinear,
        &[1.0, 0.0],
    ),
    ("zero-drift", "linear", Kind::DriftLinear, &[1.0, 0.0]),
    ("dead-zone", "radial", Kind::DeadZoneRadial, &[]),
];

impl Auditor {
    /// Draws so many whiskers without an effect and as many with one, over all kinds of noise and
    /// layouts.
    ///
    /// # Errors
    /// Where a session cannot be drawn or written, or its answer cannot be read.
    pub fn audit_whiskers(&self, draws: usize, seed: u64) -> anyhow::Result<Vec<StatementRow>> {
        let of = |mix| orders(mix, draws, seed, None, false);
        let all: Vec<(usize, Order)> = of("noise-null")
            .into_iter()
            .chain(of("noise-single"))
            .enumerate()
            .collect();
        let label = |c| (c, "all", [2 * draws, 0]);
        let counted = self.each(&all, |(k, order)| {
            Ok(self
                .whisker(*k, order)?
                .into_iter()
                .map(label)
                .collect::<Vec<Labelled>>())
        })?;
        Ok(tallied(counted))
    }

    fn whisker(&self, index: usize, order: &Order) -> anyhow::Result<Vec<Counted>> {
        let Drawn::Whisker(case) = order.draw()? else {
            return Ok(Vec::new());
        };
        let name = format!("whisker-{index:04}");
        let (outcome, verify) = self.answered(&name, &case)?;
        let mut out = Vec::new();
        let (covered, values) = outcome.covered.unwrap_or_default();
        let moments = (0..values).map(|k| k < covered);
        out.extend(
            moments
                .map(|held| Counted::new("whisker, moment held out: inside 1.96 sd", 0.95, held)),
        );
        for part in outcome
            .parts
            .iter()
            .filter_map(|p| Some((&p.name, p.inside?)))
        {
            out.push(Counted::new(
                format!("whisker, noise.{}.interval95", part.0),
                0.95,
                part.1,
            ));
        }
        match outcome.label.as_str() {
            // Readings that are grossly off are there to be named.
            "null" if !case.truth.flagged.is_empty() => {}
            "null" => {
                out.extend(of_null(&verify).into_iter().map(|c| c.of("whisker")));
                out.extend(contacts(&case, &verify)?);
                out.extend(self.shown(&name, &case, &verify)?);
            }
            _ => out.extend(parameters(&case, &verify)),
        }
        Ok(out)
    }

    /// Writes a session and has the program judge it.
    fn answered(&self, name: &str, case: &Case) -> anyhow::Result<(Outcome, Value)> {
        let session = self.folder.join(name);
        case.write(&session)?;
        let paper = Paper {
            name: name.to_owned(),
            case: Drawn::Whisker(Box::new(case.clone())),
        };
        let outcome = answer(&self.program, &paper, &session, TIMEOUT_S);
        let text = std::fs::read_to_string(session.join("verify-out/verify.json"))
            .with_context(|| format!("reading what verify says of {name}: {}", outcome.why))?;
        Ok((outcome, serde_json::from_str(&text)?))
    }

    /// Each law at just the size that the session says would show.
    fn shown(&self, name: &str, case: &Case, verify: &Value) -> anyhow::Result<Vec<Counted>> {
        let mut out = Vec::new();
        for (id, law, kind, shape) in LAWS {
            let mut stated = verify["detectable"].as_array().into_iter().flatten();
            let stated = stated.find(|d| d["id"] == id && d["law"] == law);
            let Some(amplitude) = stated.and_then(|d| d["smallest"].as_f64()) else {
                continue;
            };
            let effect = Effect {
                kind,
                amplitude,
                shape: shape.to_vec(),
            };
            // A wire that does not settle under it has no readings.
            let Ok((planted, _)) = case.under(&[effect]) else {
                continue;
            };
            let (_, verify) = self.answered(&format!("{name}-{id}"), &planted)?;
            let shows = verify["verdict"] != "adequate";
            out.push(Counted::new(
                format!("whisker, detectable.smallest: {id} not called adequate"),
                0.9,
                shows,
            ));
        }
        Ok(out)
    }
}

/// Draws of the noise by which the expected error of contacts is known.
const NOISE_DRAWS: usize = 100;

/// The interval of the contacts' error, where the noise is white, beside the expected one by the
/// plant's own rod.
fn contacts(case: &Case, verify: &Value) -> anyhow::Result<Option<Counted>> {
    if case.truth.noise.kind != Noise::Gaussian {
        return Ok(None);
    }
    let expected = expected_error_mm(case, NOISE_DRAWS, case.truth.seed)?;
    Ok(holds(
        "whisker, contact.after.interval95",
        &verify["contact"]["after"]["interval95"],
        expected,
    ))
}

/// Intervals of laws of one number where the effect that acts is named alone.
fn parameters(case: &Case, verify: &Value) -> Vec<Counted> {
    let effects = verify["effects"].as_array().into_iter().flatten();
    let mut out = Vec::new();
    for effect in effects {
        let truth = effect["id"]
            .as_str()
            .and_then(|id| case.truth.effects.get(id))
            .and_then(Value::as_f64);
        let (Some(truth), [parameter]) = (
            truth,
            effect["parameters"].as_array().map_or(&[][..], |p| p),
        ) else {
            continue;
        };
        let statement = format!(
            "whisker, parameter of {}",
            effect["id"].as_str().unwrap_or_default()
        );
        out.extend(holds(&statement, &parameter["interval95"], truth));
    }
    out
}
