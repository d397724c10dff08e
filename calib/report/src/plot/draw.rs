//! Drawing of a two-axis chart.

use super::{Layer, Marker, Plot, px, text_width};
use crate::markup::escape;
use std::fmt::Write;

/// Rectangle that the data fills, SVG units.
struct Frame<'a> {
    plot: &'a Plot,
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

impl Frame<'_> {
    fn x(&self, value: f64) -> Option<f64> {
        Some(self.left + self.plot.x.position(value)? * self.width)
    }

    fn y(&self, value: f64) -> Option<f64> {
        Some(self.top + (1.0 - self.plot.y.position(value)?) * self.height)
    }

    fn point(&self, at: [f64; 2]) -> Option<(f64, f64)> {
        Some((self.x(at[0])?, self.y(at[1])?))
    }
}

/// The chart as an `<svg>` element.
pub(crate) fn svg(plot: &Plot) -> String {
    let (y_ticks, y_label) = plot.y.ticks(((plot.height / 36.0) as usize).max(3));
    let widest = y_ticks
        .iter()
        .map(|t| text_width(&t.1))
        .fold(18.0, f64::max);
    let left = widest + 28.0;
    let title = if plot.title.is_empty() { 10.0 } else { 24.0 };
    let frame = Frame {
        plot,
        left,
        top: title,
        width: plot.width - left - 12.0,
        height: plot.height - title - 38.0,
    };
    let mut out = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {:.0} {:.0}\" role=\"img\" xmlns=\"http://www.w3.org/2000/svg\"><title>{}</title><desc>{}</desc>",
        plot.width,
        plot.height,
        escape(&plot.title),
        escape(&plot.description)
    );
    if !plot.title.is_empty() {
        let (x, title) = (px(frame.left), escape(&plot.title));
        let _ = write!(
            out,
            "<text class=\"head\" x=\"{x}\" y=\"14\">{title}</text>"
        );
    }
    bands(&mut out, &frame);
    axes(&mut out, &frame, &y_ticks, &y_label);
    for layer in &plot.layers {
        draw_layer(&mut out, &frame, layer);
    }
    out.push_str("</svg>\n");
    out
}

/// Bands lie below the grid, so that it stays visible.
fn bands(out: &mut String, frame: &Frame<'_>) {
    for layer in &frame.plot.layers {
        let Layer::Band { between } = layer else {
            continue;
        };
        let axis = &frame.plot.y;
        let edges = (
            frame.y(axis.clamp(between[0])),
            frame.y(axis.clamp(between[1])),
        );
        if let (Some(low), Some(high)) = edges {
            let (y, height) = (px(high), px((low - high).max(0.0)));
            let (x, width) = (px(frame.left), px(frame.width));
            let _ = write!(
                out,
                "<rect class=\"band\" x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\"/>"
            );
        }
    }
}

fn axes(out: &mut String, frame: &Frame<'_>, y_ticks: &[(f64, String)], y_label: &str) {
    let right = frame.left + frame.width;
    let bottom = frame.top + frame.height;
    for (value, text) in y_ticks {
        let Some(y) = frame.y(*value) else { continue };
        let _ = write!(
            out,
            "<path class=\"grid\" d=\"M{} {}H{}\"/><text class=\"tick\" text-anchor=\"end\" x=\"{}\" y=\"{}\">{}</text>",
            px(frame.left),
            px(y),
            px(right),
            px(frame.left - 5.0),
            px(y + 3.8),
            escape(text)
        );
    }
    let (x_ticks, x_label) = x_ticks_that_fit(frame);
    for (value, text) in &x_ticks {
        let Some(x) = frame.x(*value) else { continue };
        let _ = write!(
            out,
            "<path class=\"stub\" d=\"M{} {}v4\"/><text class=\"tick\" text-anchor=\"middle\" x=\"{}\" y=\"{}\">{}</text>",
            px(x),
            px(bottom),
            px(x),
            px(bottom + 16.0),
            escape(text)
        );
    }
    let _ = write!(
        out,
        "<path class=\"edge\" d=\"M{l} {t}V{b}H{r}\"/><text class=\"name\" text-anchor=\"middle\" x=\"{x}\" y=\"{y}\">{name}</text>",
        l = px(frame.left),
        t = px(frame.top),
        b = px(bottom),
        r = px(right),
        x = px(frame.left + frame.width / 2.0),
        y = px(bottom + 32.0),
        name = escape(&x_label)
    );
    let _ = write!(
        out,
        "<text class=\"name\" text-anchor=\"middle\" transform=\"translate(12 {}) rotate(-90)\">{}</text>",
        px(frame.top + frame.height / 2.0),
        escape(y_label)
    );
}

/// Fewer ticks until their texts stand clear of one another.
fn x_ticks_that_fit(frame: &Frame<'_>) -> (Vec<(f64, String)>, String) {
    let most = ((frame.width / 48.0) as usize).max(2);
    for wanted in (2..=most).rev() {
        let (ticks, label) = frame.plot.x.ticks(wanted);
        let needed: f64 = ticks.iter().map(|t| text_width(&t.1) + 8.0).sum();
        if needed <= frame.width {
            return (ticks, label);
        }
    }
    // Ticks with names cannot be chosen coarser: every n-th of them is drawn.
    let (ticks, label) = frame.plot.x.ticks(2);
    let widest = ticks
        .iter()
        .map(|t| text_width(&t.1) + 10.0)
        .fold(1.0, f64::max);
    let every = super::stride(ticks.len(), (frame.width / widest) as usize);
    (ticks.into_iter().step_by(every).collect(), label)
}

fn draw_layer(out: &mut String, frame: &Frame<'_>, layer: &Layer) {
    let (left, right) = (px(frame.left), px(frame.left + frame.width));
    match layer {
        Layer::Band { .. } => {}
        Layer::Points {
            class,
            marker,
            at,
            titles,
        } => points(out, frame, class, *marker, at, titles),
        Layer::Line { class, at } => {
            let mut path = String::new();
            let mut pen_up = true;
            for point in at {
                match frame.point(*point) {
                    Some((x, y)) => {
                        let _ = write!(
                            path,
                            "{}{} {}",
                            if pen_up { 'M' } else { 'L' },
                            px(x),
                            px(y)
                        );
                        pen_up = false;
                    }
                    None => pen_up = true,
                }
            }
            if !path.is_empty() {
                let _ = write!(out, "<path class=\"line {class}\" d=\"{path}\"/>");
            }
        }
        Layer::HorizontalRule { at } => {
            if let Some(y) = frame.y(*at) {
                let _ = write!(
                    out,
                    "<path class=\"rule\" d=\"M{left} {}H{right}\"/>",
                    px(y)
                );
            }
        }
        Layer::VerticalRule { at } => {
            if let Some(x) = frame.x(*at) {
                let (x, top, bottom) = (px(x), px(frame.top), px(frame.top + frame.height));
                let _ = write!(out, "<path class=\"rule\" d=\"M{x} {top}V{bottom}\"/>");
            }
        }
    }
}

/// Without hover texts a series is one path, which keeps large sessions small.
fn points(
    out: &mut String,
    frame: &Frame<'_>,
    class: &str,
    marker: Marker,
    at: &[[f64; 2]],
    titles: &[String],
) {
    let name = marker_class(marker);
    let mut path = String::new();
    for (k, point) in at.iter().enumerate() {
        let Some((x, y)) = frame.point(*point) else {
            continue;
        };
        let shape = marker_path(marker, x, y);
        match titles.get(k) {
            Some(title) => {
                let _ = write!(
                    out,
                    "<path class=\"{name} {class}\" d=\"{shape}\"><title>{}</title></path>",
                    escape(title)
                );
            }
            None => path.push_str(&shape),
        }
    }
    if !path.is_empty() {
        let _ = write!(out, "<path class=\"{name} {class}\" d=\"{path}\"/>");
    }
}

fn marker_class(marker: Marker) -> &'static str {
    match marker {
        Marker::Circle => "dot",
        Marker::Speck => "speck",
        Marker::Square | Marker::Diamond | Marker::Triangle => "solid",
        Marker::Cross => "cross",
        Marker::Ring => "ring",
    }
}

fn marker_path(marker: Marker, x: f64, y: f64) -> String {
    let (x, y) = (px(x), px(y));
    match marker {
        // A zero-length stroke with round caps is the shortest circle.
        Marker::Circle | Marker::Speck => format!("M{x} {y}h.01"),
        Marker::Square => format!("M{x} {y}m-2.3-2.3h4.6v4.6h-4.6z"),
        Marker::Diamond => format!("M{x} {y}m0-3.4l3.4 3.4-3.4 3.4-3.4-3.4z"),
        Marker::Triangle => format!("M{x} {y}m0-3.3l3.2 5.6h-6.4z"),
        Marker::Cross => format!("M{x} {y}m-3.6-3.6l7.2 7.2m0-7.2l-7.2 7.2"),
        Marker::Ring => format!("M{x} {y}m-6.5 0a6.5 6.5 0 1 0 13 0a6.5 6.5 0 1 0-13 0"),
    }
}

#[cfg(test)]
mod tests {
    use crate::plot::{Axis, Layer, Marker, Plot, svg};

    fn chart(at: Vec<[f64; 2]>, titles: Vec<String>) -> String {
        let x = Axis::covering("x", at.iter().map(|p| p[0]));
        let y = Axis::covering("y <mm>", at.iter().map(|p| p[1]));
        let layers = vec![
            Layer::Points {
                class: "s1",
                marker: Marker::Circle,
                at: at.clone(),
                titles,
            },
            Layer::Line { class: "s1", at },
            Layer::Band {
                between: [-1.0, 1.0],
            },
        ];
        svg(&Plot {
            title: "t".into(),
            description: "d".into(),
            width: 280.0,
            height: 190.0,
            x,
            y,
            layers,
        })
    }

    #[test]
    fn values_that_are_not_finite_never_reach_the_drawing() {
        let svg = chart(
            vec![
                [0.0, f64::NAN],
                [1.0, f64::INFINITY],
                [2.0, 1.0],
                [f64::NEG_INFINITY, 0.0],
                [3.0, 2.0],
            ],
            vec![],
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("h.01").count(), 2);
    }

    #[test]
    fn hover_texts_and_labels_are_escaped() {
        let svg = chart(
            vec![[0.0, 0.0], [1.0, 1.0]],
            vec!["<b>".into(), "ok".into()],
        );
        assert!(svg.contains("<title>&lt;b&gt;</title>"));
        assert!(svg.contains("y &lt;mm&gt;"));
    }

    #[test]
    fn empty_charts_still_have_axes() {
        let svg = chart(vec![], vec![]);
        assert!(svg.contains("class=\"edge\"") && !svg.contains("class=\"dot"));
    }
}
