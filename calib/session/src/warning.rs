//! What deserves attention in a session that can be used.

use serde::{Serialize, Serializer};
use std::fmt;
use wcal_core::text::printable;

/// A warning about a file of the session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionWarning {
    /// The file as the session names it; of a session that was joined with its folder.
    pub file: String,
    /// What a program asks for.
    pub kind: WarningKind,
    /// What is odd, in words.
    pub(crate) text: String,
    /// Lines of the file where it is so.
    pub(crate) lines: Vec<usize>,
}

/// What a program asks of a warning; for people all are sentences.
#[derive(Debug, Clone, PartialEq)]
pub enum WarningKind {
    /// Time runs backwards in file order.
    ClockProblem,
    /// Rows are left out of the table; their points.
    LeftOut(Vec<i64>),
    /// The file ends within its last row, where a copy that was cut off would; many programs write
    /// no line end after it, so no result is doubted for that.
    OpenEnd,
    /// A column that no reader knows.
    UnknownColumn(String),
    /// Points whose scans came late, or whose clocks could not be aligned.
    ScansLate,
    /// Points left out: the stage moved in their averaging windows, or stood where it had not been
    /// sent.
    StageMoved,
    /// A grating reads the same in every row while another grating changes: what follows from its
    /// readings means nothing.
    Stuck,
    /// Anything else.
    Other,
}

impl SessionWarning {
    pub(crate) fn new(file: &str, kind: WarningKind, text: impl Into<String>) -> Self {
        Self {
            file: file.to_owned(),
            kind,
            text: text.into(),
            lines: Vec::new(),
        }
    }

    /// Adds the lines of the file where it is so.
    pub(crate) fn at(mut self, lines: Vec<usize>) -> Self {
        self.lines = lines;
        self
    }

    /// The same of the file that this one was made of, whose line each line comes from.
    #[must_use]
    pub fn of_source(mut self, file: &str, line: impl Fn(usize) -> usize) -> Self {
        file.clone_into(&mut self.file);
        self.lines.iter_mut().for_each(|l| *l = line(*l));
        self
    }

    /// One that is only said.
    pub(crate) fn other(file: &str, text: impl Into<String>) -> Self {
        Self::new(file, WarningKind::Other, text)
    }
}

/// As a sentence.
impl Serialize for SessionWarning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for SessionWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head = match self.kind {
            WarningKind::ClockProblem => "clock_problem: ",
            _ => "",
        };
        write!(
            f,
            "{head}{}",
            printable(&format!("{}: {}", self.file, self.text))
        )?;
        match &self.lines[..] {
            [] => Ok(()),
            lines => write!(f, ": line(s) {}", named(lines)),
        }
    }
}

/// Points or lines by number; many are counted.
pub fn named(points: &[impl ToString]) -> String {
    /// More points are counted, not named.
    const MAX_NAMED: usize = 20;
    let mut named: Vec<String> = points
        .iter()
        .take(MAX_NAMED)
        .map(ToString::to_string)
        .collect();
    if points.len() > MAX_NAMED {
        named.push(format!("and {} more", points.len() - MAX_NAMED));
    }
    named.join(", ")
}
