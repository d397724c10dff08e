//! Small charts as inline SVG. Colours come from the page's style sheet by class, so one drawing
//! serves light, dark and print.

mod axis;
mod draw;

pub(crate) use axis::Axis;
pub(crate) use draw::svg;

/// Shape of a point; every series differs in shape as well as in colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Marker {
    /// Filled circle.
    Circle,
    /// Very small circle, of many that cover one another.
    Speck,
    /// Filled square.
    Square,
    /// Filled diamond.
    Diamond,
    /// Filled triangle.
    Triangle,
    /// Diagonal cross, for rejected readings.
    Cross,
    /// Large open circle, around what is marked.
    Ring,
}

/// One thing drawn in a chart; `class` names its colour in the style sheet (`s1` to `s4`, `bad`,
/// `quiet`).
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Layer {
    /// Points; `titles` is empty or one hover text a point.
    Points {
        /// Colour class.
        class: &'static str,
        /// Shape.
        marker: Marker,
        /// Coordinates in data units.
        at: Vec<[f64; 2]>,
        /// Hover texts.
        titles: Vec<String>,
    },
    /// Polyline, broken where a coordinate is not finite.
    Line {
        /// Colour class.
        class: &'static str,
        /// Coordinates in data units.
        at: Vec<[f64; 2]>,
    },
    /// Band between two values of y across the chart.
    Band {
        /// Lower and upper edge, data unit.
        between: [f64; 2],
    },
    /// Horizontal line.
    HorizontalRule {
        /// Value of y.
        at: f64,
    },
    /// Vertical line.
    VerticalRule {
        /// Value of x.
        at: f64,
    },
}

/// A chart of two axes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plot {
    /// Short name: printed above the chart and read by screen readers.
    pub title: String,
    /// What the chart shows, for screen readers.
    pub description: String,
    /// Width in SVG units.
    pub width: f64,
    /// Height in SVG units.
    pub height: f64,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// Bottom first.
    pub layers: Vec<Layer>,
}

/// Coordinate in SVG units with one decimal.
fn px(value: f64) -> String {
    let text = format!("{value:.1}");
    text.strip_suffix(".0").map(str::to_owned).unwrap_or(text)
}

/// Estimated width of a text at the charts' 11 px, SVG units.
fn text_width(text: &str) -> f64 {
    6.1 * text.chars().count() as f64
}

/// Every how many of `count` items to draw so that no more than `most` are drawn.
pub(crate) fn stride(count: usize, most: usize) -> usize {
    count.div_ceil(most.max(1)).max(1)
}
