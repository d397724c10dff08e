//! `wcal explain`: what an effect of a catalogue is; `wcal formats`: the files in short.

use anyhow::bail;
use clap::Args;
use std::fmt::Write as _;
use std::process::ExitCode;
use std::sync::Arc;
use wcal_trace::effect::{Effect, EffectModel, LawRequirement, Role};
use wcal_trace::scalar::effects::scalar_catalogue;
use wcal_trace::scalar::frame::{Declared, Frame, Scaling};
use wcal_trace::whisker::effects::whisker_catalogue;

/// The file formats, for `wcal formats` and `wcal help formats`.
pub const FORMATS: &str = include_str!("formats.txt");

/// Arguments of `wcal explain`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal explain
  wcal explain groove-friction")]
pub struct ExplainArgs {
    /// Effect, as verify.json names it; without it every effect of every catalogue is listed
    pub effect: Option<String>,
}

/// A catalogue: the kind of session that it is for, and its effects.
type Catalogue = (&'static str, Vec<Arc<dyn Effect>>);

/// The catalogues by kind of session.
fn catalogues() -> [Catalogue; 3] {
    let scalar = |declared| -> Vec<Arc<dyn Effect>> {
        // Laws and ranges do not depend on rows; one covariate stands for all.
        let frame = Frame::new(Vec::new(), &Scaling::of(&[]), declared);
        scalar_catalogue(&frame, &["covariate".to_owned()])
            .into_iter()
            .map(|e| e as Arc<dyn Effect>)
            .collect()
    };
    [
        ("whisker", whisker_catalogue().into_iter().map(|e| e as Arc<dyn Effect>).collect()),
        ("transducer", scalar(Declared::Polynomial(1))),
        ("axis", scalar(Declared::Axis)),
    ]
}

/// Runs the command.
///
/// # Errors
/// Where no catalogue has the effect.
pub fn run(args: &ExplainArgs) -> anyhow::Result<ExitCode> {
    let catalogues = catalogues();
    let Some(id) = &args.effect else {
        print!("{}", listed(&catalogues));
        return Ok(ExitCode::SUCCESS);
    };
    let found: Vec<(&str, &Arc<dyn Effect>)> = catalogues
        .iter()
        .flat_map(|(kind, effects)| effects.iter().map(move |e| (*kind, e)))
        .filter(|(_, e)| e.id() == id)
        .collect();
    if found.is_empty() {
        bail!("{id}: expected an effect of a catalogue (`wcal explain` lists them), found none of that name");
    }
    // Two kinds that share an effect's laws are told once.
    let mut told: Vec<(Vec<&str>, String)> = Vec::new();
    for (kind, effect) in found {
        let text = in_full(kind, effect.as_ref());
        match told.iter_mut().find(|t| t.1 == text) {
            Some((kinds, _)) => kinds.push(kind),
            None => told.push((vec![kind], text)),
        }
    }
    let all: Vec<String> =
        told.iter().map(|(kinds, text)| format!("{id} (kind {})\n{text}", kinds.join(", "))).collect();
    print!("{}", all.join("\n"));
    Ok(ExitCode::SUCCESS)
}

/// Runs `wcal formats`.
///
/// # Errors
/// None.
pub fn formats() -> anyhow::Result<ExitCode> {
    print!("{FORMATS}");
    Ok(ExitCode::SUCCESS)
}

/// Every effect with its sentence and source.
fn listed(catalogues: &[Catalogue]) -> String {
    let mut out = String::new();
    for (kind, effects) in catalogues {
        let _ = writeln!(out, "kind {kind}");
        for e in effects {
            let _ = writeln!(out, "  {:<24} {}\n  {:<24} source: {}", e.id(), e.sentence(), "", e.source());
        }
        out.push('\n');
    }
    out.push_str("`wcal explain EFFECT` prints one in full: laws, parameters, units, ranges, columns.\n");
    out
}

/// An effect with its laws.
fn in_full(kind: &str, effect: &dyn Effect) -> String {
    let mut out = format!("  {}\n  source: {}\n", effect.sentence(), effect.source());
    let _ = writeln!(out, "  columns: {}", columns(kind, effect));
    for (laws, note) in
        [(effect.laws(), ""), (effect.refinements(), ", tried where the effect is accepted already")]
    {
        laws.iter().for_each(|law| out += &of_law(law, note));
    }
    out
}

fn of_law(law: &EffectModel, note: &str) -> String {
    let mut out = format!("  law {}{note}\n", law.name);
    for p in &law.parameters {
        let [low, high] = p.range;
        let role = match p.role {
            Role::Amplitude { probe } => format!("amplitude, typically {probe}"),
            Role::Shape { .. } => "shape".to_owned(),
        };
        let _ = writeln!(out, "    {:<24} {} to {} {} ({role})", p.name, low, high, unit(p.unit));
    }
    for (name, unit_of) in &law.linear {
        let _ = writeln!(out, "    {:<24} free, {} (a coefficient for each channel)", name, unit(unit_of));
    }
    if law.parameters.is_empty() && law.linear.is_empty() {
        out.push_str("    no parameter: single readings are found and excluded\n");
    }
    out
}

/// A unit as people read it: scalar catalogues hold for any unit, so theirs are shares of the session's ranges.
fn unit(unit: &str) -> String {
    match unit {
        "1" => "(no unit)".to_owned(),
        "half-range" => "half ranges of the stimulus".to_owned(),
        "stimulus" => "half ranges of the stimulus from its middle".to_owned(),
        "duration" => "durations of the session".to_owned(),
        "clock" => "of the session's duration, from its beginning".to_owned(),
        "response" => "unit of the response".to_owned(),
        "response/degc" => "unit of the response per deg C".to_owned(),
        "response/duration" => "unit of the response per duration of the session".to_owned(),
        "response/covariate" => "unit of the response per half range of the covariate".to_owned(),
        other => match (other.strip_prefix("period:"), other.strip_prefix("response/half-range")) {
            (Some(over), _) => format!("cycles over the range of the {over}"),
            (_, Some("")) => "unit of the response per half range of the stimulus".to_owned(),
            (_, Some(power)) => format!("unit of the response per half range of the stimulus{power}"),
            _ => other.to_owned(),
        },
    }
}

/// Columns without which the effect cannot be traced, beside the required ones, and those that help.
fn columns(kind: &str, effect: &dyn Effect) -> String {
    let needed = effect.needs();
    let all: Vec<&str> =
        needed.iter().filter_map(|need| column(kind, *need)).chain(effect.helped_by()).collect();
    if all.is_empty() { "none beside the required ones".to_owned() } else { all.join(", ") }
}

fn column(kind: &str, need: LawRequirement) -> Option<&'static str> {
    match need {
        LawRequirement::Time => Some("t_s"),
        LawRequirement::Clock => Some("t_s, or rows in the order in which they were taken"),
        LawRequirement::Order => Some("rows in the order in which they were taken"),
        LawRequirement::Temperature if kind == "whisker" => Some("temperature_degc or fbg_ref_nm"),
        LawRequirement::Temperature => Some("temperature_degc"),
        LawRequirement::BothDirections => Some("direction, or t_s with rising and falling stimulus"),
        LawRequirement::Motion => Some("t_s, speed_mm_s above 0 (readings while the stage moves)"),
        LawRequirement::MovingBase => {
            Some("none: on the stage the base does not move, so it is never observable there")
        }
        LawRequirement::Weight => Some("none; session.toml gives density_kg_m3 and the direction of gravity"),
        LawRequirement::Covariate => Some("a further covariate"),
        LawRequirement::RestReadings => Some("a reading at rest (role rest, or no trajectory)"),
        LawRequirement::Pictures => Some("none; `[files] shapes` of session.toml names what the cameras saw"),
        LawRequirement::StraightArc => Some("none; session.toml gives straight_mm and arc_radius_mm"),
        LawRequirement::MovingPictures => {
            Some("t_s, speed_mm_s above 0 and pictures taken while the stage moves")
        }
        LawRequirement::Slope => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_is_told_in_full() {
        for (kind, effects) in catalogues() {
            for e in effects {
                let text = in_full(kind, e.as_ref());
                assert!(text.contains(e.sentence()) && text.contains(e.source()), "{kind} {}", e.id());
                for law in e.laws().iter().chain(&e.refinements()) {
                    let names = law.parameters.iter().map(|p| p.name).chain(law.linear.iter().map(|l| l.0));
                    assert!(names.into_iter().all(|n| text.contains(n)), "{kind} {}: {text}", e.id());
                }
                // No name of a normalised unit reaches a person.
                assert!(!text.contains("half-range") && !text.contains("period:"), "{text}");
            }
        }
    }
}
