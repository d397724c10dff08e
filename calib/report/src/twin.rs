//! The page of a twin's labels: its own error, and what the groove's tip does to the moments. All of it is simulated.

use crate::input::Fact;
use crate::markup::{Table, TableCell, list, paragraph};
use crate::nullable::or_nan;
use crate::number::significant;
use crate::page::simulated;
use serde::{Deserialize, Serialize};

/// What a twin's report shows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct TwinInput {
    /// Heading.
    pub title: String,
    /// Engine, preset, poses, ...
    pub facts: Vec<Fact>,
    /// What was found, in sentences.
    pub findings: Vec<String>,
    /// The tip's effects in the order in which they were added; the last row is all of them.
    pub tip: Vec<TipEffect>,
    /// Poses that the table is over.
    pub poses: usize,
}

/// An effect of the groove's tip on the moment, % of the moment in an ideal groove.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TipEffect {
    /// What was added.
    pub name: String,
    /// Mean change along the moment: these add up.
    #[serde(deserialize_with = "or_nan")]
    pub along_percent: f64,
    /// Root mean square of the whole change.
    #[serde(deserialize_with = "or_nan")]
    pub rms_percent: f64,
    /// Largest change, and the pose.
    #[serde(deserialize_with = "or_nan")]
    pub largest_percent: f64,
    /// See `largest_percent`.
    pub at_point: i64,
}

/// The page.
#[must_use]
pub fn render_twin(input: &TwinInput) -> String {
    simulated(
        "Twin",
        &input.title,
        &input.facts,
        &[
            ("tip", "What the groove's tip does to the moment", tip(input)),
            ("findings", "The twin's own error", list(&input.findings)),
        ],
    )
}

fn tip(input: &TwinInput) -> String {
    if input.tip.is_empty() {
        return "<p class=\"quiet\">Not asked for, or no pose is held in every way.</p>".to_owned();
    }
    let caption = format!("Change of the base moment over {} poses, % of the ideal groove's", input.poses);
    let mut table = Table::new(
        &caption,
        &["effect", "#mean along the moment", "#RMS of the whole", "#largest", "#at point"],
    );
    for row in &input.tip {
        table.row(vec![
            TableCell::Text(row.name.clone()),
            TableCell::Number(significant(row.along_percent, 3)),
            TableCell::Number(significant(row.rms_percent, 3)),
            TableCell::Number(significant(row.largest_percent, 3)),
            TableCell::Number(row.at_point.to_string()),
        ]);
    }
    let note = "Each effect is added to those above it. The means along the moment add up to the last row; the others do not, as the changes have directions of their own.";
    table.html() + &paragraph(note)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_are_in_the_table_and_none_is_said() {
        let row = |name: &str, along_percent: f64| TipEffect {
            name: name.to_owned(),
            along_percent,
            rms_percent: 2.0,
            largest_percent: 4.0,
            at_point: 7,
        };
        let mut input = TwinInput {
            title: "Twin <x>".to_owned(),
            tip: vec![row("shape", -1.25), row("all together", 3.5)],
            poses: 5,
            ..TwinInput::default()
        };
        let page = render_twin(&input);
        for words in ["Twin &lt;x&gt;", "SIMULATED", "over 5 poses", "shape", "1.25", "all together", "3.5"] {
            assert!(page.contains(words), "{words}: {page}");
        }
        input.tip.clear();
        assert!(render_twin(&input).contains("Not asked for"), "negative control");
    }
}
