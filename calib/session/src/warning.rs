//! What deserves attention in a session that can be used.

use serde::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt;
use wcal_core::PairLeftOut;
use wcal_core::text::brief;

/// A warning about a file of the session.
#[derive(Debug, Clone, PartialEq)]
pub struct SessionWarning {
    /// The file as the session names it; of a session that was joined with its folder.
    pub file: String,
    /// What is odd.
    pub kind: WarningKind,
}

/// What is odd about a file.
#[derive(Debug, Clone, PartialEq)]
pub enum WarningKind {
    /// Time runs backwards in file order.
    ClockProblem {
        /// How often.
        times: usize,
        /// Line of the first time.
        line: usize,
        /// By how much there, s.
        back_s: f64,
    },
    /// Rows in which an instrument wrote a code because it had no value.
    Overflow {
        /// Column.
        column: String,
        /// The code.
        value: f64,
        /// Lines of the rows, which are left out.
        lines: Vec<usize>,
        /// Their points.
        points: Vec<i64>,
    },
    /// Rows that repeat others to the last digit where their noise would not let them.
    Copied {
        /// Lines of the rows, which are left out.
        lines: Vec<usize>,
        /// Their points.
        points: Vec<i64>,
        /// Rows of the table.
        of: usize,
    },
    /// The file ends within its last row, where a copy that was cut off would.
    OpenEnd {
        /// Line of the row.
        line: usize,
    },
    /// A column that no reader knows.
    UnknownColumn(String),
    /// A column that would be a covariate, but holds no numbers.
    ColumnWithoutNumbers(String),
    /// A key that no reader knows.
    UnknownKey(String),
    /// The medium is not given; air is assumed.
    NoMedium,
    /// The recording that the session names is not there.
    NoRecording(String),
    /// Points whose averaging windows miss scans.
    ScansLost(Vec<i64>),
    /// Points whose scans came late, or whose clocks could not be aligned.
    ScansLate(Vec<i64>),
    /// Points left out: the stage moved in their averaging windows, or stood where it had not been sent.
    StageMoved(Vec<i64>),
    /// A grating reads the same in every row while another grating changes.
    Stuck {
        /// Grating.
        column: String,
        /// Rows.
        rows: usize,
    },
    /// Points without a label of the twin.
    Unlabelled {
        /// How many.
        points: usize,
        /// Of how many.
        of: usize,
    },
    /// The groove is not where the stage says.
    StageDisagrees {
        /// Limit that was passed, mm.
        limit_mm: f64,
        /// Rows past it.
        rows: usize,
        /// Largest difference, mm.
        worst_mm: f64,
        /// Line of the largest difference.
        line: usize,
    },
    /// The rest shape is not as long as the wire is said to be.
    RestShapeLength {
        /// Length of the polyline, mm.
        polyline_mm: f64,
        /// `length_mm`.
        declared_mm: f64,
    },
    /// A trajectory of a joined session got another number.
    TrajectoryRenamed {
        /// Its number there.
        old: u32,
        /// Its number here.
        new: u32,
    },
    /// Pairs of pictures that cannot be used: name and why.
    PairsLeftOut(Vec<PairLeftOut>),
    /// A joined session has labels of its own.
    TwinNotUsed,
    /// A measured and a simulated session were joined; the identifier is that of the simulated one.
    JoinedWithSimulated(String),
}

impl SessionWarning {
    pub(crate) fn new(file: &str, kind: WarningKind) -> Self {
        Self { file: file.to_owned(), kind }
    }

    /// Whether it says that a grating does not respond: what follows from its readings means nothing.
    pub fn is_stuck(&self) -> bool {
        matches!(self.kind, WarningKind::Stuck { .. })
    }

    /// Whether it is said and no more: many programs write no line end after the last row.
    pub fn is_remark(&self) -> bool {
        matches!(self.kind, WarningKind::OpenEnd { .. })
    }

    /// Points of rows that were left out of the table.
    pub(crate) fn left_out(&self) -> &[i64] {
        match &self.kind {
            WarningKind::Overflow { points, .. } | WarningKind::Copied { points, .. } => points,
            _ => &[],
        }
    }

    /// Whether it says that time runs backwards.
    pub fn is_clock_problem(&self) -> bool {
        matches!(self.kind, WarningKind::ClockProblem { .. })
    }
}

/// As a sentence, as it has always been stored.
impl Serialize for SessionWarning {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for SessionWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = &self.file;
        match &self.kind {
            WarningKind::ClockProblem { times, line, back_s } => write!(
                f,
                "clock_problem: {file}: t_s runs backwards {times} time(s), first at line {line} by {back_s:.3} s"
            ),
            WarningKind::Overflow { column, value, lines, .. } => write!(
                f,
                "{file}: {column} {} in {} row(s) is an overflow value of the instrument; left out as missing: line(s) {}",
                short(*value),
                lines.len(),
                named(lines)
            ),
            WarningKind::Copied { lines, of, .. } => write!(
                f,
                "{file}: {} of {of} rows are copies of others; counted once, left out: line(s) {}",
                lines.len(),
                named(lines)
            ),
            WarningKind::OpenEnd { line } => write!(
                f,
                "{file}: the file ends within line {line}, without a line end: if it was cut off there, its last number may lack digits"
            ),
            WarningKind::UnknownColumn(column) => {
                write!(f, "{file}: column {} is not known and not used", brief(column))
            }
            WarningKind::ColumnWithoutNumbers(column) => {
                write!(f, "{file}: column {} holds no numbers and is not used", brief(column))
            }
            WarningKind::UnknownKey(key) => {
                write!(f, "{file}: key {} is not known and not used", brief(key))
            }
            WarningKind::NoMedium => write!(f, "{file}: medium is not given; taken as \"air\""),
            WarningKind::NoRecording(name) => {
                write!(f, "{file}: the recording {name} is not there; tables cannot be rebuilt from it")
            }
            WarningKind::ScansLost(points) => {
                write!(f, "{file}: points {}: scans are missing in the averaging window", named(points))
            }
            WarningKind::ScansLate(points) => write!(
                f,
                "{file}: points {}: scans came late, or the clocks could not be aligned: the bench or the recording computer had fallen \
                 behind",
                named(points)
            ),
            WarningKind::StageMoved(points) => write!(
                f,
                "{file}: points {} left out: the stage moved in their averaging window, or stood where it had not been sent",
                named(points)
            ),
            WarningKind::Stuck { column, rows } => write!(
                f,
                "{file}: no sensitivity: {column} reads the same in all {rows} rows while another grating changes; it is dead, stuck or not connected"
            ),
            WarningKind::Unlabelled { points, of } => {
                write!(f, "{file}: {points} of {of} points have no label")
            }
            WarningKind::StageDisagrees { limit_mm, rows, worst_mm, line } => write!(
                f,
                "{file}: groove and origin + stage_mm * direction differ by more than {limit_mm} mm in {rows} row(s), \
                 most by {worst_mm:.3} mm at line {line}"
            ),
            WarningKind::RestShapeLength { polyline_mm, declared_mm } => {
                write!(f, "{file}: the rest shape is {polyline_mm:.3} mm long, length_mm says {declared_mm}")
            }
            WarningKind::TrajectoryRenamed { old, new } => {
                write!(f, "{file}: trajectory {old} is another path here and is called {new}")
            }
            WarningKind::PairsLeftOut(pairs) => {
                let mut by_reason: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
                for p in pairs {
                    by_reason.entry(&p.why).or_default().push(&p.name);
                }
                let each: Vec<String> =
                    by_reason.iter().map(|(why, names)| format!("{} ({why})", names.join(", "))).collect();
                write!(f, "{file}: {} pair(s) of pictures left out: {}", pairs.len(), each.join("; "))
            }
            WarningKind::TwinNotUsed => write!(f, "{file}: labels of its twin are not used"),
            WarningKind::JoinedWithSimulated(id) => {
                write!(f, "measured and SIMULATED sessions are joined: {id:?} is simulated")
            }
        }
    }
}

/// A number as short as it reads back, with an exponent where zeros would fill a line.
fn short(value: f64) -> String {
    if value.abs() >= 1e12 { format!("{value:e}") } else { value.to_string() }
}

/// Points or lines by number; many are counted.
fn named(points: &[impl ToString]) -> String {
    /// More points are counted, not named.
    const MAX_NAMED: usize = 20;
    let mut named: Vec<String> = points.iter().take(MAX_NAMED).map(ToString::to_string).collect();
    if points.len() > MAX_NAMED {
        named.push(format!("and {} more", points.len() - MAX_NAMED));
    }
    named.join(", ")
}
