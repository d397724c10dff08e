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
    /// Dot at the end of a way, and a tick where it could have led to.
    Change {
        /// Where the dot lies.
        to: f64,
        /// Where the way began.
        from: f64,
        /// Place of the tick.
        floor: Option<f64>,
    },
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
/// A row whose name and value do not stand side by side has them on two lines.
const LINE: f64 = 15.0;
const MARGIN: f64 = 14.0;
/// Room for texts.
const INNER: f64 = WIDTH - 2.0 * MARGIN;

/// Ground behind a text, so that no line of the chart runs through it.
fn behind(out: &mut String, x: f64, baseline: f64, text: &str) {
    let (x, y, width) = (px(x - 1.0), px(baseline - 11.0), px(text_width(text) + 2.0));
    let _ = write!(out, "<rect class=\"behind\" x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"14\"/>");
}

impl RowItem {
    /// The name, broken between words where it is wider than the chart.
    fn name_lines(&self) -> Vec<String> {
        let mut lines = vec![String::new()];
        for word in self.label.split_whitespace() {
            let last = lines.len() - 1;
            if !lines[last].is_empty() && text_width(&lines[last]) + text_width(word) + 6.0 > INNER {
                lines.push(word.to_owned());
            } else {
                let gap = if lines[last].is_empty() { "" } else { " " };
                lines[last] += &format!("{gap}{word}");
            }
        }
        lines
    }

    /// Whether the value needs a line of its own: next to the name it would be printed over it.
    fn value_below(&self) -> bool {
        let last = self.name_lines().last().map_or(0.0, |line| text_width(line));
        last + text_width(&self.value) + 12.0 > INNER
    }

    fn height(&self) -> f64 {
        ROW + LINE * (self.name_lines().len() - 1 + usize::from(self.value_below())) as f64
    }
}

impl RowChart {
    /// The chart as an `<svg>` element.
    pub fn svg(&self) -> String {
        let top = if self.rules.is_empty() { 28.0 } else { 42.0 };
        let bottom = top + self.rows.iter().map(RowItem::height).sum::<f64>();
        let mut out = open_svg("rows", WIDTH, bottom + 40.0, &self.title, &self.description);
        let _ = write!(out, "<text class=\"head\" x=\"{MARGIN}\" y=\"14\">{}</text>", escape(&self.title));
        self.draw_axis(&mut out, top, bottom);
        let mut at = top;
        for row in &self.rows {
            self.draw_row(&mut out, row, at);
            at += row.height();
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
        let base = top + row.height() - 9.0;
        let lines = row.name_lines();
        for (k, line) in lines.iter().enumerate() {
            let y = px(top + LINE * (k + 1) as f64);
            behind(out, MARGIN, top + LINE * (k + 1) as f64, line);
            let _ = write!(out, "<text class=\"name\" x=\"{MARGIN}\" y=\"{y}\">{}</text>", escape(line));
        }
        let below = top + LINE * (lines.len() + usize::from(row.value_below())) as f64;
        behind(out, WIDTH - MARGIN - text_width(&row.value), below, &row.value);
        let _ = write!(
            out,
            "<text class=\"value\" text-anchor=\"end\" x=\"{}\" y=\"{}\">{}</text>",
            px(WIDTH - MARGIN),
            px(below),
            escape(&row.value)
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
            Mark::Change { to, from, floor } => {
                let [to, from] = [to, from].map(|v| self.x(self.axis.clamp(v)));
                if let (Some(to), Some(from)) = (to, from) {
                    let _ = write!(
                        out,
                        "<path class=\"line {c}\" d=\"M{} {y}H{}\"/><path class=\"big {c}\" d=\"M{to} {y}h.01\"/>",
                        px(from),
                        px(to),
                        c = row.class,
                        to = px(to),
                        y = px(base)
                    );
                }
                if let Some(x) = floor.and_then(|f| self.x(f)) {
                    let _ =
                        write!(out, "<path class=\"stub floor\" d=\"M{} {}v11\"/>", px(x), px(base - 5.5));
                }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn row(label: &str, value: &str) -> RowItem {
        RowItem { label: label.into(), value: value.into(), class: "s1", mark: Mark::Bar(1.0) }
    }

    #[test]
    fn a_long_name_is_not_printed_over_its_value() {
        let long = row(
            "groove-friction + superelastic-softening + temperature-mismatch",
            "−12.31, p 0.0123, rejected",
        );
        assert!(long.value_below() && long.height() > ROW);
        let svg = RowChart {
            title: String::new(),
            description: String::new(),
            axis: Axis::fixed("", 0.0, 1.0),
            rows: vec![long],
            rules: vec![],
        }
        .svg();
        let line_of = |text: &str| {
            let before = &svg[..svg.find(text).unwrap()];
            before.rsplit("y=\"").next().unwrap().split('"').next().unwrap().to_owned()
        };
        assert_ne!(line_of(">groove-friction"), line_of(">−12.31"), "{svg}");
        // Negative control: what fits side by side stays on one line.
        let short = row("creep", "0, p 0.5, survives");
        assert!(!short.value_below() && short.height() == ROW);
    }

    #[test]
    fn a_name_wider_than_the_chart_is_broken_between_words() {
        let wide = row(&"stage-backlash + ".repeat(8), "1");
        assert!(wide.name_lines().len() > 1);
        assert!(wide.name_lines().iter().all(|line| text_width(line) <= INNER));
    }
}
