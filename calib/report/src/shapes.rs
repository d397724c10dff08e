//! The page of shapes from stereo pictures: the shapes in space (to be turned), and for every pair
//! its pictures with what was found drawn on them and the residuals along the wire.

use crate::input::Fact;
use crate::markup::{Table, TableCell, escape, list};
use crate::number::number;
use crate::page::{facts, plain_page};
use crate::plot::{Axis, Layer, Plot, svg};
use crate::sections::parts::{badge, legend, series};
use std::fmt::Write;

/// What the page shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapesInput {
    /// Heading.
    pub title: String,
    /// The pictures are rendered, not taken.
    pub simulated: bool,
    /// Cameras, rig, pairs, ...
    pub facts: Vec<Fact>,
    /// What a reader has to know.
    pub warnings: Vec<String>,
    /// Pairs that could not be used, with the reason.
    pub rejected: Vec<[String; 2]>,
    /// The others.
    pub pairs: Vec<ShapePair>,
}

/// One pair.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapePair {
    /// Name.
    pub name: String,
    /// Length, contact, residuals, each with its standard deviation.
    pub facts: Vec<Fact>,
    /// What was not seen, and what is doubtful.
    pub remarks: Vec<String>,
    /// Left and right picture.
    pub pictures: Vec<ShapePicture>,
    /// Arc length (mm) and distance from the curve (px) of every measured piece, left and right.
    pub residuals: [Vec<[f64; 2]>; 2],
    /// Centre line, base frame, mm.
    pub centreline_mm: Vec<[f64; 3]>,
    /// Contact with the groove, base frame, mm.
    pub groove_mm: Option<[f64; 3]>,
}

/// A picture and what was found in it, px, pixel centres at integers.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapePicture {
    /// `left` or `right`.
    pub side: String,
    /// Width and height.
    pub size_px: [usize; 2],
    /// The picture, JPEG in base64.
    pub jpeg_base64: String,
    /// Corners of each tag.
    pub tags: Vec<Vec<[f64; 2]>>,
    /// Fitted centre line.
    pub curve: Vec<[f64; 2]>,
    /// Measured centres that show the wire.
    pub seen: Vec<[f64; 2]>,
    /// Measured centres that do not.
    pub unseen: Vec<[f64; 2]>,
    /// Contact with the groove.
    pub groove: Option<[f64; 2]>,
}

/// The page.
pub fn render_shapes(input: &ShapesInput) -> String {
    let pairs: String = input
        .pairs
        .iter()
        .map(|p| pair(p, input.simulated))
        .collect();
    let space = if input.pairs.is_empty() {
        String::new()
    } else {
        space(input)
    };
    plain_page(
        ("Shapes from stereo pictures", &input.title),
        input.simulated,
        &input.facts,
        &[
            ("warnings", "Warnings", list(&input.warnings)),
            ("space", "In space", space),
            ("rejected", "Rejected pairs", rejected(&input.rejected)),
            ("pairs", "Pairs", pairs),
        ],
    )
}

fn rejected(pairs: &[[String; 2]]) -> String {
    let mut table = Table::new("Pairs that could not be used", &["pair", "why"]);
    for [name, why] in pairs {
        table.row([TableCell::Code(name.clone()), TableCell::Text(why.clone())]);
    }
    table.html()
}

fn pair(input: &ShapePair, simulated: bool) -> String {
    let mut out = format!(
        "<div class=\"card\"><h3>{}</h3>{}",
        escape(&input.name),
        facts(&input.facts)
    );
    out += &list(&input.remarks);
    out += "</div><figure class=\"pictures\"><div class=\"charts\">";
    out += &input.pictures.iter().map(picture).collect::<String>();
    let _ = writeln!(
        out,
        "</div><figcaption>{}Left and right. Line: fitted wire; blue dots: measured centres; red dots: centres that do not show the wire; \
         magenta: tags; orange circle: contact with the groove.</figcaption></figure>",
        badge(simulated)
    );
    out + &residuals(input, simulated)
}

/// The picture itself brings no own coordinates: half a pixel lies before the first centre.
fn picture(input: &ShapePicture) -> String {
    let [width, height] = input.size_px;
    let side = escape(&input.side);
    let mut out = format!(
        "<svg class=\"photo\" viewBox=\"-0.5 -0.5 {width} {height}\" role=\"img\" xmlns=\"http://www.w3.org/2000/svg\"><title>{side}</title>\
         <desc>{side} picture with the fitted wire</desc><image x=\"-0.5\" y=\"-0.5\" width=\"{width}\" height=\"{height}\" \
         href=\"data:image/jpeg;base64,{}\"/>",
        escape(&input.jpeg_base64)
    );
    let points = |list: &[[f64; 2]]| {
        list.iter()
            .map(|p| format!("{:.2},{:.2}", p[0], p[1]))
            .collect::<Vec<_>>()
            .join(" ")
    };
    for corners in &input.tags {
        let _ = write!(
            out,
            "<polygon class=\"tag\" points=\"{}\"/>",
            points(corners)
        );
    }
    let _ = write!(
        out,
        "<polyline class=\"wire\" points=\"{}\"/>",
        points(&input.curve)
    );
    for (class, centres) in [("seen", &input.seen), ("unseen", &input.unseen)] {
        for [x, y] in centres {
            let _ = write!(
                out,
                "<circle class=\"{class}\" cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"0.8\"/>"
            );
        }
    }
    if let Some([x, y]) = input.groove {
        let _ = write!(
            out,
            "<circle class=\"groove\" cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"6\"/>"
        );
    }
    out + "</svg>"
}

fn residuals(input: &ShapePair, simulated: bool) -> String {
    let all = || input.residuals.iter().flatten();
    let mut layers = vec![Layer::HorizontalRule { at: 0.0 }];
    for (k, at) in input.residuals.iter().enumerate() {
        let (class, marker) = series(k);
        layers.push(Layer::Points {
            class,
            marker,
            at: at.clone(),
            titles: Vec::new(),
        });
    }
    let plot = Plot {
        title: "Distance from the fitted wire".to_owned(),
        description: format!(
            "Measured centres from the reprojected curve of {}",
            input.name
        ),
        width: 460.0,
        height: 210.0,
        x: Axis::covering("arc length from the root (mm)", all().map(|p| p[0])),
        y: Axis::symmetric("distance (px)", all().map(|p| p[1])),
        layers,
    };
    format!(
        "<figure class=\"whole\">{}<div class=\"charts\">{}</div><figcaption>{}Measured centres from the reprojected curve, root to \
         tip.</figcaption></figure>\n",
        legend(&["left".to_owned(), "right".to_owned()]),
        svg(&plot),
        badge(simulated)
    )
}

/// A canvas that turns; the lines are in the page, nothing is loaded.
fn space(input: &ShapesInput) -> String {
    let pairs: Vec<serde_json::Value> = input
        .pairs
        .iter()
        .map(
            |p| serde_json::json!({"name": p.name, "line": p.centreline_mm, "groove": p.groove_mm}),
        )
        .collect();
    // Neither markup nor the end of the script may come out of a name, and the page stays
    // well-formed XML.
    let data = serde_json::Value::from(pairs).to_string();
    let data = data
        .replace('<', "\\u003c")
        .replace('>', "\\u003e")
        .replace('&', "\\u0026");
    let mut table = Table::new(
        "Contacts with the groove, base frame",
        &["pair", "#x (mm)", "#y (mm)", "#z (mm)"],
    );
    for (name, place) in input
        .pairs
        .iter()
        .filter_map(|p| Some((&p.name, p.groove_mm?)))
    {
        let mut row = vec![TableCell::Code(name.clone())];
        row.extend(place.map(|v| TableCell::Text(number(v))));
        table.row(row);
    }
    let table = table.html();
    format!(
        "<figure class=\"whole\"><canvas id=\"turn\" role=\"img\" aria-label=\"Centre lines in space\"></canvas>\
         <div id=\"names\" class=\"legend\"></div><figcaption>{}Centre lines in the base frame. Drag to turn, wheel to zoom.</figcaption>\
         </figure>\n{table}<script>const pairs={data};{SCRIPT}</script>\n",
        badge(input.simulated)
    )
}

/// Draws with the page's own colours, so that light and dark both hold.
const SCRIPT: &str = include_str!("shapes.js");

#[cfg(test)]
mod tests {
    use super::*;

    fn input() -> ShapesInput {
        let picture = |side: &str| ShapePicture {
            side: side.into(),
            size_px: [64, 48],
            tags: vec![vec![[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 9.0]]],
            curve: vec![[10.0, 10.0], [50.0, 20.0]],
            seen: vec![[10.0, 10.1]],
            unseen: vec![[50.0, 25.0]],
            groove: Some([40.0, 17.5]),
            ..ShapePicture::default()
        };
        ShapesInput {
            title: "Scene".into(),
            simulated: true,
            rejected: vec![["</script><b>".into(), "no <wire>".into()]],
            pairs: vec![ShapePair {
                name: "t1 </script>".into(),
                pictures: ["left", "right"].map(picture).to_vec(),
                residuals: [vec![[1.0, 0.1]], vec![[2.0, -0.1]]],
                centreline_mm: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]],
                groove_mm: Some([1.0, 0.0, 0.5]),
                ..ShapePair::default()
            }],
            ..ShapesInput::default()
        }
    }

    #[test]
    fn the_page_is_whole_names_do_not_break_it_and_the_mark_is_at_every_picture() {
        let page = render_shapes(&input());
        assert!(
            page.contains("no &lt;wire&gt;") && page.contains("[1.0,0.0,0.5]"),
            "{page}"
        );
        assert_eq!(page.matches("</script>").count(), 1);
        let outside = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
        assert!(!outside.contains("://"), "nothing is loaded from elsewhere");
        assert_eq!(
            page.matches("<figcaption>").count(),
            page.matches("SIMULATED</span> ").count()
        );
        let mut reader = quick_xml::Reader::from_str(&page);
        while !matches!(reader.read_event().unwrap(), quick_xml::events::Event::Eof) {}
        // Negative control: pictures that were taken carry no mark.
        assert!(
            !render_shapes(&ShapesInput {
                simulated: false,
                ..input()
            })
            .contains("SIMULATED")
        );
    }

    #[test]
    fn without_a_usable_pair_there_is_no_empty_space() {
        let page = render_shapes(&ShapesInput {
            pairs: vec![],
            ..input()
        });
        assert!(!page.contains("<canvas") && page.contains("Rejected pairs"));
    }
}
