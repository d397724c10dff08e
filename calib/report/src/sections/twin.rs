//! Twin check: moments along each trajectory, the rod's branches as lines and the outside labels as markers.

use super::{absent, figure, legend, series};
use crate::input::{ReportInput, TwinTrajectory};
use crate::markup::{Table, TableCell};
use crate::number::number;
use crate::plot::{Axis, Layer, Marker, Plot};
use std::collections::HashMap;

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let faults = &input.verify.twin.faults;
    let mut out = String::new();
    if faults.is_empty() && has_labels(input) {
        out += "<p>No fault was found in the twin's labels.</p>";
    } else if faults.is_empty() {
        out +=
            &absent("The session has no labels of an outside twin (twin.csv): there was nothing to check.");
    } else {
        let mut table = Table::new("Faulty labels of the twin", &["kind", "points", "what is wrong"]);
        for fault in faults {
            let points: Vec<String> = fault.points.iter().map(i64::to_string).collect();
            table.row(vec![
                TableCell::Badge("bad", fault.kind.clone()),
                TableCell::Text(points.join(", ")),
                TableCell::Text(fault.detail.clone()),
            ]);
        }
        out += &table.html();
    }
    if input.twin.is_empty() {
        return out + &absent("No comparison along trajectories was handed to this report.");
    }
    // Faults may be given in the document only; the picture marks them all the same.
    let kinds: HashMap<i64, &str> =
        faults.iter().flat_map(|f| f.points.iter().map(move |p| (*p, f.kind.as_str()))).collect();
    out += &legend(&input.moment_names);
    let charts: String = input.twin.iter().map(|t| chart(input, t, &kinds)).collect();
    out + &figure(
        input.verify.simulated,
        "many",
        &charts,
        match has_labels(input) {
            true => {
                "Base moment against stage position. Lines: equilibrium branches of wcal's own rod; markers: labels of the outside twin; rings with a word: labels on another branch, or of a wire that left the groove. Every chart has its own scale."
            }
            false => {
                "Base moment against stage position: equilibrium branches of wcal's own rod. Every chart has its own scale."
            }
        },
    )
}

/// Whether an outside twin's labels were there to be checked.
pub(super) fn has_labels(input: &ReportInput) -> bool {
    input.twin.iter().any(|t| !t.labels.is_empty()) || !input.verify.twin.faults.is_empty()
}

/// A fault of single labels is ringed; one of unit or discretisation is of all labels, and the table says so.
fn of_single_labels(kind: &str) -> bool {
    !matches!(kind, "unit" | "discretisation")
}

fn chart(input: &ReportInput, trajectory: &TwinTrajectory, kinds: &HashMap<i64, &str>) -> String {
    let stages = trajectory.branches.iter().flat_map(|b| b.stage_mm.iter().copied());
    let stages = stages.chain(trajectory.labels.iter().map(|l| l.stage_mm));
    let moments = trajectory.branches.iter().flat_map(|b| b.moment_nmm.iter().flatten().copied());
    let moments = moments.chain(trajectory.labels.iter().flat_map(|l| l.moment_nmm));
    let mut layers: Vec<Layer> =
        trajectory.snaps_mm.iter().map(|at| Layer::VerticalRule { at: *at, label: "snap".into() }).collect();
    layers.push(Layer::HorizontalRule { at: 0.0 });
    for k in 0..2 {
        let (class, marker) = series(k);
        for branch in &trajectory.branches {
            let at = branch.stage_mm.iter().zip(&branch.moment_nmm).map(|(s, m)| [*s, m[k]]).collect();
            layers.push(Layer::Line { class, at });
        }
        let at: Vec<_> = trajectory.labels.iter().map(|l| [l.stage_mm, l.moment_nmm[k]]).collect();
        let hover = |l: &crate::input::TwinMark| {
            let [value, stage] = [number(l.moment_nmm[k]), number(l.stage_mm)];
            let fault = l.fault.as_deref().or(kinds.get(&l.point).copied());
            let word = fault.map_or(String::new(), |kind| format!(", {kind}"));
            format!("point {}: {} {value} N mm at {stage} mm{word}", l.point, input.moment_names[k])
        };
        let titles = trajectory.labels.iter().map(hover).collect();
        layers.push(Layer::Points { class, marker, at, titles });
    }
    let bad: Vec<_> = trajectory
        .labels
        .iter()
        .filter_map(|l| Some((l, l.fault.as_deref().or(kinds.get(&l.point).copied())?)))
        .filter(|(_, kind)| of_single_labels(kind))
        .collect();
    let rings = bad.iter().flat_map(|(l, _)| l.moment_nmm.map(|m| [l.stage_mm, m])).collect();
    layers.push(Layer::Points { class: "bad", marker: Marker::Ring, at: rings, titles: Vec::new() });
    let mut words: Vec<&str> = bad.iter().map(|b| b.1).collect();
    words.sort_unstable();
    words.dedup();
    let title = match words.as_slice() {
        [] => format!("Trajectory {}", trajectory.id),
        some => format!("Trajectory {} – {}", trajectory.id, some.join(", ")),
    };
    Plot {
        description: format!(
            "Moments along trajectory {}: {} labels, {} of them ringed",
            trajectory.id,
            trajectory.labels.len(),
            bad.len()
        ),
        title,
        width: 320.0,
        height: 210.0,
        x: Axis::covering("stage position (mm)", stages),
        y: Axis::covering("moment (N mm)", moments.chain([0.0])),
        layers,
    }
    .svg()
}
