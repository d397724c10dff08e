//! The page of a sweep dataset: counts by verdict and event, objects, and some sweeps drawn. All of it is simulated.

use crate::input::Fact;
use crate::markup::{Table, TableCell, escape, list, paragraph};
use crate::number::{number, percent};
use crate::page::simulated;
use crate::plot::{Axis, Layer, Plot};
use crate::sections::{legend, series};
use std::fmt::Write;

/// What a report of sweeps shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SweepsInput {
    /// Heading.
    pub title: String,
    /// Engine, whisker, plan, rate, ...
    pub facts: Vec<Fact>,
    /// What a reader has to know before using the data.
    pub warnings: Vec<String>,
    /// Verdict ("kept" or a reason) and number of sweeps.
    pub verdicts: Vec<(String, u64)>,
    /// Event and how often it happened.
    pub events: Vec<(String, u64)>,
    /// Objects.
    pub objects: Vec<SweptObject>,
    /// The same sweeps by two engines, where they were made so.
    pub engines: Option<EnginesCompared>,
    /// Sweeps to draw.
    pub examples: Vec<ExampleSweep>,
}

/// A dynamic engine against a quasi-static one on the same sweeps.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EnginesCompared {
    /// What else is known of the difference, in sentences.
    pub remarks: Vec<String>,
    /// By speed.
    pub by_speed: Vec<SpeedDifference>,
}

/// What differs at speeds of a range.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SpeedDifference {
    /// Speeds of the base, mm/s.
    pub speed_mm_s: [f64; 2],
    /// Samples at which both touch.
    pub samples: usize,
    /// Share of them in another equilibrium; the differences leave them out.
    pub elsewhere: f64,
    /// Difference of the base moments, median and 95th percentile, N mm.
    pub moment_nmm: [f64; 2],
    /// Mean size of the moment over the quasi-static one's, less 1.
    pub bias: f64,
    /// Distance of the contacts, median and 95th percentile, mm.
    pub contact_mm: [f64; 2],
    /// Ripple of the moments, N mm.
    pub ripple_nmm: f64,
    /// Deepest overlap of wire and object, mm.
    pub overlap_mm: f64,
    /// Share of samples that chatter.
    pub chatter: f64,
}

/// An object's counts.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SweptObject {
    /// Name.
    pub name: String,
    /// Sweeps, and those kept.
    pub sweeps: u64,
    /// See `sweeps`.
    pub kept: u64,
    /// Reasons of the others, with their number.
    pub rejected: Vec<(String, u64)>,
    /// Events, with their number.
    pub events: Vec<(String, u64)>,
}

/// A sweep to draw.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExampleSweep {
    /// Object, number and verdict.
    pub title: String,
    /// Samples in time.
    pub samples: Vec<ExampleSample>,
}

/// A sample of a drawn sweep.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExampleSample {
    /// Time, s.
    pub t_s: f64,
    /// Transverse base moments y and z, N mm.
    pub moment_nmm: [f64; 2],
    /// Arc length of the contact nearest to the base, mm.
    pub contact_arclength_mm: Option<f64>,
    /// Event since the sample before; "none" where nothing happened.
    pub event: String,
    /// Whether the wire came to rest.
    pub settled: bool,
}

/// The page.
pub fn render_sweeps(input: &SweepsInput) -> String {
    let warnings = if input.warnings.is_empty() { String::new() } else { list(&input.warnings) };
    simulated(
        "Sweep dataset",
        &input.title,
        &input.facts,
        &[
            ("warnings", "Warnings", warnings),
            ("counts", "Verdicts and events", counts(input)),
            ("objects", "Objects", objects(&input.objects)),
            ("engines", "MuJoCo against the rod", input.engines.as_ref().map_or_else(String::new, engines)),
            ("examples", "Sweeps", examples(&input.examples)),
        ],
    )
}

/// What the words of verdicts and events mean.
fn meaning(word: &str) -> &'static str {
    match word {
        "kept" => "usable",
        "no-section" => "the drawn plane misses the object within the wire's reach",
        "no-contact" => "the wire never touched",
        "starts-inside" => "the wire began inside the object",
        "torque-too-high" => "the wire's skin was strained past the plan's limit",
        "contact-jump" => "the wire sprang from one equilibrium to another, and the plan rejects that",
        "no-equilibrium" => "the wire did not come to rest in too many samples",
        "onset" => "first touch",
        "release" => "the wire came free",
        "unstable" => "a step went wrong: a value is not finite",
        "penetration" => "the wire sank into the object by more than its radius",
        "chatter" => "the contact opened and closed from step to step",
        "engine-died" => "MuJoCo's program ended; a second run makes these sweeps again",
        "model-refused" => "MuJoCo cannot take one of the object's convex parts",
        "no-convex-parts" => "the object could not be taken apart into convex parts",
        "jump" => "the wire sprang from one equilibrium to another",
        "slip" => "the contact ran along the wire several times faster than the base",
        _ => "",
    }
}

fn counts(input: &SweepsInput) -> String {
    let all: u64 = input.verdicts.iter().map(|v| v.1).sum();
    let mut verdicts = Table::new("Sweeps by verdict", &["verdict", "#sweeps", "#share", "meaning"]);
    for (name, count) in &input.verdicts {
        let class = if name == "kept" { "good" } else { "plain" };
        verdicts.row(vec![
            TableCell::Badge(class, name.clone()),
            TableCell::Number(count.to_string()),
            TableCell::Number(percent(*count as f64 / all.max(1) as f64)),
            TableCell::Text(meaning(name).to_owned()),
        ]);
    }
    let mut out = verdicts.html();
    if input.events.is_empty() {
        return out + &paragraph("No event: the wire touched nothing.");
    }
    let mut events = Table::new("Events in all sweeps, rejected ones too", &["event", "#times", "meaning"]);
    for (name, count) in &input.events {
        events.row(vec![
            TableCell::Text(name.clone()),
            TableCell::Number(count.to_string()),
            TableCell::Text(meaning(name).to_owned()),
        ]);
    }
    out += &events.html();
    out
}

fn objects(objects: &[SweptObject]) -> String {
    let words = |counts: &[(String, u64)]| {
        let words: Vec<String> = counts.iter().map(|(name, n)| format!("{name} {n}")).collect();
        words.join(", ")
    };
    let mut table = Table::new(
        "Sweeps over each object",
        &["object", "#sweeps", "#kept", "#share kept", "rejected for", "events"],
    );
    for o in objects {
        table.row(vec![
            TableCell::Text(o.name.clone()),
            TableCell::Number(o.sweeps.to_string()),
            TableCell::Number(o.kept.to_string()),
            TableCell::Number(percent(o.kept as f64 / o.sweeps.max(1) as f64)),
            TableCell::Text(words(&o.rejected)),
            TableCell::Text(words(&o.events)),
        ]);
    }
    table.html()
}

fn engines(compared: &EnginesCompared) -> String {
    let mut table = Table::new(
        "The same sweeps by both engines, by the base's speed",
        &[
            "speed, mm/s",
            "#samples",
            "#elsewhere",
            "#moment off, p50, N mm",
            "#p95, N mm",
            "#bias",
            "#contact off, p50, mm",
            "#p95, mm",
            "#ripple, N mm",
            "#overlap, mm",
            "#chatter",
        ],
    );
    for r in &compared.by_speed {
        let [from, to] = r.speed_mm_s.map(number);
        table.row(vec![
            TableCell::Text(if from == to { from } else { format!("{from} to {to}") }),
            TableCell::Number(r.samples.to_string()),
            TableCell::Number(percent(r.elsewhere)),
            TableCell::Number(number(r.moment_nmm[0])),
            TableCell::Number(number(r.moment_nmm[1])),
            TableCell::Number(percent(r.bias)),
            TableCell::Number(number(r.contact_mm[0])),
            TableCell::Number(number(r.contact_mm[1])),
            TableCell::Number(number(r.ripple_nmm)),
            TableCell::Number(number(r.overlap_mm)),
            TableCell::Number(percent(r.chatter)),
        ]);
    }
    let note = "Elsewhere: the contacts are so far apart that the wire is in another equilibrium (one engine has let it spring, the other not yet); the other columns leave these samples out. Bias: mean size of MuJoCo's moment over the rod's, less one; it grows with the speed where damping makes it.";
    compared.remarks.iter().map(|line| paragraph(line)).collect::<String>() + &table.html() + &paragraph(note)
}

fn examples(examples: &[ExampleSweep]) -> String {
    if examples.is_empty() {
        return "<p class=\"quiet\">No sweep could be drawn.</p>".to_owned();
    }
    let mut out = legend(&["moment y".to_owned(), "moment z".to_owned(), "contact's arc length".to_owned()]);
    for example in examples {
        let _ = writeln!(
            out,
            "<figure class=\"pair\"><div class=\"charts\">{}{}</div><figcaption><span class=\"pill sim\">SIMULATED</span> {}. Vertical lines: events; rings: samples at which the wire did not come to rest.</figcaption></figure>",
            moments(example),
            arclength(example),
            escape(&example.title)
        );
    }
    out
}

fn times(example: &ExampleSweep) -> Axis {
    Axis::covering("time, s", example.samples.iter().map(|s| s.t_s))
}

fn events(example: &ExampleSweep) -> Vec<Layer> {
    let happened = example.samples.iter().filter(|s| s.event != "none");
    happened.map(|s| Layer::VerticalRule { at: s.t_s, label: s.event.clone() }).collect()
}

fn unsettled(example: &ExampleSweep, at: impl Fn(&ExampleSample) -> Vec<[f64; 2]>) -> Layer {
    let at = example.samples.iter().filter(|s| !s.settled).flat_map(at).collect();
    Layer::Points { class: "bad", marker: crate::plot::Marker::Ring, at, titles: Vec::new() }
}

fn moments(example: &ExampleSweep) -> String {
    let mut layers = events(example);
    layers.push(Layer::HorizontalRule { at: 0.0 });
    for k in 0..2 {
        let (class, marker) = series(k);
        let at: Vec<[f64; 2]> = example.samples.iter().map(|s| [s.t_s, s.moment_nmm[k]]).collect();
        let hover = |s: &ExampleSample| {
            format!("moment {} {} N mm at {} s", ["y", "z"][k], number(s.moment_nmm[k]), number(s.t_s))
        };
        layers.push(Layer::Line { class, at: at.clone() });
        layers.push(Layer::Points { class, marker, at, titles: example.samples.iter().map(hover).collect() });
    }
    layers.push(unsettled(example, |s| s.moment_nmm.map(|m| [s.t_s, m]).to_vec()));
    let values = example.samples.iter().flat_map(|s| s.moment_nmm);
    Plot {
        title: "Base moments".to_owned(),
        description: format!("Base moments against time: {}", example.title),
        width: 460.0,
        height: 240.0,
        x: times(example),
        y: Axis::covering("moment, N mm", values),
        layers,
    }
    .svg()
}

fn arclength(example: &ExampleSweep) -> String {
    let mut layers = events(example);
    let (class, marker) = series(2);
    let at: Vec<[f64; 2]> =
        example.samples.iter().map(|s| [s.t_s, s.contact_arclength_mm.unwrap_or(f64::NAN)]).collect();
    layers.push(Layer::Line { class, at: at.clone() });
    let touching: Vec<[f64; 2]> = at.into_iter().filter(|p| p[1].is_finite()).collect();
    let titles = touching.iter().map(|p| format!("{} mm at {} s", number(p[1]), number(p[0]))).collect();
    let values: Vec<f64> = touching.iter().map(|p| p[1]).collect();
    layers.push(Layer::Points { class, marker, at: touching, titles });
    layers.push(unsettled(example, |s| s.contact_arclength_mm.map(|a| [s.t_s, a]).into_iter().collect()));
    Plot {
        title: "Contact".to_owned(),
        description: format!("Arc length of the contact nearest to the base against time: {}", example.title),
        width: 460.0,
        height: 240.0,
        x: times(example),
        y: Axis::covering("arc length, mm", values),
        layers,
    }
    .svg()
}
