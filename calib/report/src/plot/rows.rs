//! One row an item: a name above a bar, or a dot with its interval.

use super::{Axis, open_svg, px, text_width};
use crate::markup::escape;
use std::fmt::Write;

/// How a row is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Mark {
    /// Bar from the lower end of the axis.
    Bar(f64),
    /// Dot with an interval.
    Dot(f64, Option<[f64; 2]>),
}

/// One row.
#[derive(Debug, Clone, PartialEq)]
pub struct RowItem {
    /// Name, left.
    pub label: String,
    /// Value in words, right.
    pub value: String,
    /// Colour class.
    pub class: &'static str,
    /// Drawing.
    pub mark: Mark,
}

/// Rows over one common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct RowChart {
    /// Short name, printed above.
    pub title: String,
    /// What the chart shows, for screen readers.
    pub description: String,
    /// Common axis.
    pub axis: Axis,
    /// Rows, top first.
    pub rows: Vec<RowItem>,
    /// Vertical lines with a word.
    pub rules: Vec<(f64, String)>,
}

const WIDTH: f64 = 420.0;
const ROW: f64 = 36.0;
const MARGIN: f64 = 14.0;

impl RowChart {
    /// The chart as an `<svg>` element.
    #[must_use]
    pub fn svg(&self) -> String {
        let top = if self.rules.is_empty() { 28.0 } else { 42.0 };
        let bottom = top + ROW * self.rows.len() as f64;
        let mut out = open_svg("rows", WIDTH, bottom + 40.0, &self.title, &self.description);
        let _ = write!(out, "<text class=\"head\" x=\"{MARGIN}\" y=\"14\">{}</text>", escape(&self.title));
        self.draw_axis(&mut out, top, bottom);
        for (k, row) in self.rows.iter().enumerate() {
            self.draw_row(&mut out, row, top + ROW * k as f64);
        }
        out.push_str("</svg>\n");
        out
    }

    fn x(&self, value: f64) -> Option<f64> {
        Some(MARGIN + self.axis.position(value)? * (WIDTH - 2.0 * MARGIN))
    }

    fn draw_axis(&self, out: &mut String, top: f64, bottom: f64) {
        let (ticks, label) = self.axis.ticks(6);
        for (value, text) in ticks {
            let Some(x) = self.x(value) else { continue };
            let _ = write!(
                out,
                "<path class=\"grid\" d=\"M{x} {}V{}\"/><text class=\"tick\" text-anchor=\"middle\" x=\"{x}\" y=\"{}\">{}</text>",
                px(top),
                px(bottom),
                px(bottom + 15.0),
                escape(&text),
                x = px(x)
            );
        }
        let _ = write!(
            out,
            "<path class=\"edge\" d=\"M{MARGIN} {b}H{}\"/><text class=\"name\" text-anchor=\"middle\" x=\"{}\" y=\"{}\">{}</text>",
            px(WIDTH - MARGIN),
            px(WIDTH / 2.0),
            px(bottom + 32.0),
            escape(&label),
            b = px(bottom)
        );
        for (value, word) in &self.rules {
            let Some(x) = self.x(*value) else { continue };
            let half = text_width(word) / 2.0;
            let _ = write!(
                out,
                "<path class=\"rule\" d=\"M{} {}V{}\"/><text class=\"tick\" text-anchor=\"middle\" x=\"{}\" y=\"{}\">{}</text>",
                px(x),
                px(top - 6.0),
                px(bottom),
                px(x.clamp(half + 2.0, (WIDTH - half - 2.0).max(half + 2.0))),
                px(top - 9.0),
                escape(word)
            );
        }
    }

    fn draw_row(&self, out: &mut String, row: &RowItem, top: f64) {
        let base = top + 27.0;
        let _ = write!(
            out,
            "<text class=\"name\" x=\"{MARGIN}\" y=\"{y}\">{}</text><text class=\"value\" text-anchor=\"end\" x=\"{}\" y=\"{y}\">{}</text>",
            escape(&row.label),
            px(WIDTH - MARGIN),
            escape(&row.value),
            y = px(top + 15.0)
        );
        match row.mark {
            Mark::Bar(to) => {
                let Some(x) = self.x(self.axis.clamp(to)) else { return };
                // A bar of no length still shows where it starts.
                let _ = write!(
                    out,
                    "<rect class=\"bar {}\" x=\"{MARGIN}\" y=\"{}\" width=\"{}\" height=\"9\"/>",
                    row.class,
                    px(base - 6.0),
                    px((x - MARGIN).max(1.5))
                );
            }
            Mark::Dot(at, interval) => {
                let ends = interval.and_then(|[low, high]| {
                    Some((self.x(self.axis.clamp(low))?, self.x(self.axis.clamp(high))?))
                });
                if let Some((low, high)) = ends {
                    let _ = write!(
                        out,
                        "<path class=\"line {}\" d=\"M{low} {a}V{b}M{low} {y}H{high}M{high} {a}V{b}\"/>",
                        row.class,
                        low = px(low),
                        high = px(high),
                        y = px(base),
                        a = px(base - 3.5),
                        b = px(base + 3.5)
                    );
                }
                if let Some(x) = self.x(at) {
                    let _ =
                        write!(out, "<path class=\"big {}\" d=\"M{} {}h.01\"/>", row.class, px(x), px(base));
                }
            }
        }
    }
}
