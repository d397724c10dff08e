//! What several sections have: figures with their captions and keys, and words for lists.

use crate::markup::escape;
use crate::plot::Marker;

/// The mark of simulated data before a caption.
pub(crate) fn badge(simulated: bool) -> &'static str {
    if simulated {
        "<span class=\"pill sim\">SIMULATED</span> "
    } else {
        ""
    }
}

/// A chart or several under one caption; simulated data is labelled at the picture itself, since
/// pictures travel alone.
pub(crate) fn figure(simulated: bool, class: &str, charts: &str, caption: &str) -> String {
    let tag = badge(simulated);
    format!(
        "<figure class=\"{class}\"><div class=\"charts\">{charts}</div><figcaption>{tag}{}</figcaption></figure>\n",
        escape(caption)
    )
}

/// Says that something was not part of this run.
pub(super) fn absent(what: &str) -> String {
    format!("<p class=\"quiet\">{}</p>", escape(what))
}

/// Class and marker of the n-th channel; past the fourth, colours come back with another shape.
pub(crate) fn series(n: usize) -> (&'static str, Marker) {
    use Marker::{Circle, Diamond, Square, Triangle};
    (
        ["s1", "s2", "s3", "s4"][n % 4],
        [Circle, Square, Diamond, Triangle][(n + n / 4) % 4],
    )
}

/// Key of colours and shapes.
pub(crate) fn legend(names: &[impl AsRef<str>]) -> String {
    const SHAPES: [&str; 4] = ["●", "■", "◆", "▲"];
    let items: String = names
        .iter()
        .enumerate()
        .map(|(k, name)| {
            let (class, _) = series(k);
            // Colour and shape follow the rule of `series`, by which the charts are drawn.
            format!(
                "<li><span class=\"key {class}\">{}</span> {}</li>",
                SHAPES[(k + k / 4) % 4],
                escape(name.as_ref())
            )
        })
        .collect();
    format!("<ul class=\"legend\">{items}</ul>")
}

/// Names in order of first appearance.
pub(super) fn distinct<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for name in names {
        if !out.iter().any(|n| n == name) {
            out.push(name.to_owned());
        }
    }
    out
}

/// `a`, `a and b`, `a, b and c`.
pub(super) fn joined(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => one.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}
