//! Escaping and tables: every text passes through here, so the page stays well-formed whatever a
//! session holds.

use std::fmt::Write;

/// Text that is safe inside elements and attribute values; characters that XML forbids become
/// U+FFFD.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' => out.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// `= 0.02` or `< 0.0001` of a p-value, ready for HTML.
pub(crate) fn with_sign(p: &str) -> String {
    if p.starts_with('<') {
        escape(p)
    } else {
        format!("= {}", escape(p))
    }
}

/// `<p>` of escaped text; empty where there is none.
pub(crate) fn paragraph(text: &str) -> String {
    match text {
        "" => String::new(),
        text => format!("<p>{}</p>", escape(text)),
    }
}

/// `<ul>` of escaped texts; empty where there are none.
pub(crate) fn list(items: &[String]) -> String {
    if items.is_empty() {
        return String::new();
    }
    let rows: String = items
        .iter()
        .map(|item| format!("<li>{}</li>", escape(item)))
        .collect();
    format!("<ul>{rows}</ul>")
}

/// One cell of a table.
#[derive(Debug, Clone)]
pub(crate) enum TableCell {
    /// Text, or a number that is formatted.
    Text(String),
    /// The same with smaller lines below.
    WithNotes(String, Vec<String>),
    /// Identifier in a fixed-width face.
    Code(String),
    /// Pill with a class for its colour.
    Badge(&'static str, String),
    /// Relative address and text; plain text where the address is empty or could run a script.
    Link(String, String),
}

impl TableCell {
    pub(crate) fn html(&self) -> String {
        match self {
            Self::Text(text) => escape(text),
            Self::WithNotes(text, notes) => {
                let notes: String = notes
                    .iter()
                    .map(|n| format!("<small>{}</small>", escape(n)))
                    .collect();
                escape(text) + &notes
            }
            Self::Code(text) => format!("<code>{}</code>", escape(text)),
            Self::Badge(class, text) => {
                format!("<span class=\"pill {class}\">{}</span>", escape(text))
            }
            Self::Link(href, text) if href.is_empty() || href.contains(':') => escape(text),
            Self::Link(href, text) => format!("<a href=\"{}\">{}</a>", escape(href), escape(text)),
        }
    }
}

impl From<String> for TableCell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

/// A table with a caption; the first column heads the rows.
#[derive(Debug, Default)]
pub(crate) struct Table {
    caption: String,
    columns: Vec<(String, bool)>,
    rows: Vec<(&'static str, Vec<TableCell>)>,
}

impl Table {
    /// Starts a table; a column whose name begins with `#` holds numbers.
    pub(crate) fn new(caption: &str, columns: &[&str]) -> Self {
        let split = |c: &&str| match c.strip_prefix('#') {
            Some(name) => (name.to_owned(), true),
            None => ((*c).to_owned(), false),
        };
        let columns = columns.iter().map(split).collect();
        Self {
            caption: caption.into(),
            columns,
            rows: Vec::new(),
        }
    }

    /// Adds a row.
    pub(crate) fn row<C: Into<TableCell>>(&mut self, cells: impl IntoIterator<Item = C>) {
        self.marked_row("", cells.into_iter().map(C::into).collect());
    }

    /// Adds a row with a class.
    pub(crate) fn marked_row(&mut self, class: &'static str, cells: Vec<TableCell>) {
        self.rows.push((class, cells));
    }

    /// The table inside a box that scrolls sideways where the page is narrow.
    pub(crate) fn html(&self) -> String {
        if self.rows.is_empty() {
            return String::new();
        }
        let caption = escape(&self.caption);
        // A box that scrolls must be reachable by keyboard, hence tabindex and a name.
        let mut out = format!(
            "<div class=\"scroll\" role=\"region\" tabindex=\"0\" aria-label=\"{caption}\"><table><caption>{caption}</caption><thead><tr>"
        );
        for (name, is_number) in &self.columns {
            let class = if *is_number { " class=\"num\"" } else { "" };
            let _ = write!(out, "<th scope=\"col\"{class}>{}</th>", escape(name));
        }
        out.push_str("</tr></thead><tbody>");
        for (class, cells) in &self.rows {
            let _ = write!(out, "<tr{}>", attribute("class", class));
            for (k, cell) in cells.iter().enumerate() {
                let html = cell.html();
                let is_number = self.columns.get(k).is_some_and(|c| c.1);
                let class = attribute("class", if is_number { "num" } else { "" });
                let _ = match k {
                    0 => write!(out, "<th scope=\"row\"{class}>{html}</th>"),
                    _ => write!(out, "<td{class}>{html}</td>"),
                };
            }
            out.push_str("</tr>");
        }
        out.push_str("</tbody></table></div>\n");
        out
    }
}

fn attribute(name: &str, value: &str) -> String {
    if value.is_empty() {
        String::new()
    } else {
        format!(" {name}=\"{value}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_in_text_is_disarmed() {
        assert_eq!(escape("<script>&\"'"), "&lt;script&gt;&amp;&quot;&#39;");
        assert_eq!(escape("a\u{0}b\u{1b}"), "a\u{fffd}b\u{fffd}");
    }

    #[test]
    fn table_heads_rows_and_columns() {
        let mut table = Table::new("a <b>", &["name", "#value"]);
        assert_eq!(table.html(), "");
        table.row([TableCell::Code("x&y".into()), TableCell::Text("1".into())]);
        let html = table.html();
        assert!(html.contains("<caption>a &lt;b&gt;</caption>"));
        assert!(
            html.contains("<th scope=\"row\"><code>x&amp;y</code></th><td class=\"num\">1</td>")
        );
    }
}
