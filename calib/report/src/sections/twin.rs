//! Twin check: moments along each trajectory, the rod's branches as lines and the outside labels as
//! markers.

use super::parts::{absent, figure, legend, series};
use crate::input::{MOMENT_NAMES, ReportInput, TwinMark, TwinTrajectory};
use crate::markup::{Table, TableCell};
use crate::number::number;
use crate::plot::{Axis, Layer, Marker, Plot, svg};

/// The section: only labels of an outside twin can be checked.
pub(super) fn body(input: &ReportInput) -> String {
    let faults = &input.verify.twin.faults;
    if faults.is_empty() && input.twin.iter().all(|t| t.labels.is_empty()) {
        return String::new();
    }
    let mut out = String::new();
    if faults.is_empty() {
        out += "<p>No fault was found in the twin's labels.</p>";
    } else {
        let mut table = Table::new(
            "Faulty labels of the twin",
            &["kind", "points", "what is wrong"],
        );
        for fault in faults {
            let points: Vec<String> = fault.points.iter().map(i64::to_string).collect();
            table.row([
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
    out += &legend(&MOMENT_NAMES);
    let charts: String = input.twin.iter().map(|t| chart(input, t)).collect();
    let caption = "Base moment against stage position. Lines: equilibria of wcal's own rod; markers: labels of the outside twin; rings with a word: labels on another branch, or of a wire that left the groove. Every chart has its own scale.";
    out + &figure(input.verify.simulated, "many", &charts, caption)
}

/// Kind of a label's fault; one of unit or discretisation is of all labels, and the table says so.
fn fault<'a>(input: &'a ReportInput, label: &TwinMark) -> Option<&'a str> {
    let single = |kind: &str| !matches!(kind, "unit" | "discretisation");
    let mut faults = input.verify.twin.faults.iter().filter(|f| single(&f.kind));
    faults
        .find(|f| f.points.contains(&label.point))
        .map(|f| f.kind.as_str())
}

fn chart(input: &ReportInput, trajectory: &TwinTrajectory) -> String {
    let stages = trajectory
        .stage_mm
        .iter()
        .copied()
        .chain(trajectory.labels.iter().map(|l| l.stage_mm));
    let moments = trajectory.moment_nmm.iter().flatten().copied();
    let moments = moments.chain(trajectory.labels.iter().flat_map(|l| l.moment_nmm));
    let mut layers = vec![Layer::HorizontalRule { at: 0.0 }];
    for (k, name) in MOMENT_NAMES.iter().enumerate() {
        let (class, marker) = series(k);
        let at = trajectory
            .stage_mm
            .iter()
            .zip(&trajectory.moment_nmm)
            .map(|(s, m)| [*s, m[k]])
            .collect();
        layers.push(Layer::Line { class, at });
        let at: Vec<_> = trajectory
            .labels
            .iter()
            .map(|l| [l.stage_mm, l.moment_nmm[k]])
            .collect();
        let hover = |l: &TwinMark| {
            let [value, stage] = [number(l.moment_nmm[k]), number(l.stage_mm)];
            let word = fault(input, l).map_or(String::new(), |kind| format!(", {kind}"));
            format!("point {}: {name} {value} N mm at {stage} mm{word}", l.point)
        };
        let titles = trajectory.labels.iter().map(hover).collect();
        layers.push(Layer::Points {
            class,
            marker,
            at,
            titles,
        });
    }
    let bad: Vec<_> = trajectory
        .labels
        .iter()
        .filter_map(|l| Some((l, fault(input, l)?)))
        .collect();
    let rings = bad
        .iter()
        .flat_map(|(l, _)| l.moment_nmm.map(|m| [l.stage_mm, m]))
        .collect();
    layers.push(Layer::Points {
        class: "bad",
        marker: Marker::Ring,
        at: rings,
        titles: Vec::new(),
    });
    let mut words: Vec<&str> = bad.iter().map(|b| b.1).collect();
    words.sort_unstable();
    words.dedup();
    let title = match words.as_slice() {
        [] => format!("Trajectory {}", trajectory.id),
        some => format!("Trajectory {} – {}", trajectory.id, some.join(", ")),
    };
    // Zero belongs on the axis of moments: it shows their size beside their change.
    svg(&Plot {
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
    })
}
