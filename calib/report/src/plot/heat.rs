//! Heat map of a square matrix of values between -1 and 1, the number printed in every cell.

use super::{open_svg, px, text_width};
use crate::markup::escape;
use std::fmt::Write;

/// A square matrix with named rows and columns.
#[derive(Debug, Clone, PartialEq)]
pub struct HeatMap<'a> {
    /// Short name.
    pub title: String,
    /// What it shows, for screen readers.
    pub description: String,
    /// Names, n of them.
    pub names: &'a [String],
    /// n rows of n values.
    pub values: &'a [Vec<f64>],
    /// Cells at or above this size (off the diagonal) are outlined.
    pub outline_from: f64,
}

const CELL: f64 = 34.0;

impl HeatMap<'_> {
    /// The map as an `<svg>` element; shade is the size, the sign is in the printed number.
    #[must_use]
    pub fn svg(&self) -> String {
        let n = self.names.len() as f64;
        let margin = self.names.iter().map(|name| text_width(name)).fold(30.0, f64::max) + 12.0;
        // Slanted column names need their width times the sine of 50 degrees.
        let head = 0.77 * margin + 8.0;
        let (width, height) = (margin + CELL * n + 0.65 * margin, head + CELL * n + 4.0);
        let mut out = open_svg("heat", width, height, &self.title, &self.description);
        out.insert_str(
            4,
            &format!(" style=\"min-width:{:.0}px;max-width:{:.0}px\"", 0.85 * width, 1.1 * width),
        );
        for (i, name) in self.names.iter().enumerate() {
            let at = CELL * i as f64 + CELL / 2.0;
            let _ = write!(
                out,
                "<text class=\"name\" text-anchor=\"end\" x=\"{}\" y=\"{}\">{name}</text><text class=\"name\" transform=\"translate({} {}) rotate(-50)\">{name}</text>",
                px(margin - 6.0),
                px(head + at + 4.0),
                px(margin + at + 4.0),
                px(head - 5.0),
                name = escape(name)
            );
        }
        for (i, row) in self.values.iter().enumerate().take(self.names.len()) {
            for (j, value) in row.iter().enumerate().take(self.names.len()) {
                self.cell(&mut out, i, j, *value, margin + CELL * j as f64, head + CELL * i as f64);
            }
        }
        out.push_str("</svg>\n");
        out
    }

    fn cell(&self, out: &mut String, i: usize, j: usize, value: f64, x: f64, y: f64) {
        let size = value.abs();
        let (shade, ink, text) = match (value.is_finite(), size > 0.7) {
            (false, _) => (0.0, "value", "–".to_owned()),
            (true, strong) => {
                let text = format!("{value:.2}").replace('-', "\u{2212}");
                (size.min(1.0) * 0.85, if strong { "value on" } else { "value" }, text)
            }
        };
        let marked = if i != j && size >= self.outline_from { " twin" } else { "" };
        let hover = format!("{} / {}: {}", self.names[i], self.names[j], crate::number::number(value));
        let _ = write!(
            out,
            "<g><title>{}</title><rect class=\"cell{marked}\" x=\"{}\" y=\"{}\" width=\"{s}\" height=\"{s}\" fill-opacity=\"{shade:.2}\"/><text class=\"{ink}\" text-anchor=\"middle\" x=\"{}\" y=\"{}\">{text}</text></g>",
            escape(&hover),
            px(x + 1.0),
            px(y + 1.0),
            px(x + CELL / 2.0),
            px(y + CELL / 2.0 + 4.0),
            s = CELL - 2.0
        );
    }
}

#[cfg(test)]
mod tests {
    use super::HeatMap;

    #[test]
    fn every_cell_prints_its_number_and_twins_are_outlined() {
        let names = ["a".to_owned(), "b<".to_owned()];
        let values = vec![vec![1.0, -0.997], vec![-0.997, f64::NAN]];
        let map = HeatMap {
            title: String::new(),
            description: String::new(),
            names: &names,
            values: &values,
            outline_from: 0.995,
        };
        let svg = map.svg();
        assert_eq!(svg.matches("−1.00").count(), 2);
        assert_eq!(svg.matches("cell twin").count(), 2);
        assert!(svg.contains("b&lt;") && !svg.contains("NaN"));
    }

    #[test]
    fn a_ragged_matrix_is_drawn_as_far_as_it_goes() {
        let names = ["a".to_owned(), "b".to_owned()];
        let values = vec![vec![1.0]];
        let (title, description) = (String::new(), String::new());
        let svg = HeatMap { title, description, names: &names, values: &values, outline_from: 1.0 }.svg();
        assert_eq!(svg.matches("class=\"cell").count(), 1);
    }
}
