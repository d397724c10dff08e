//! One error type: what was being done, where, what was expected, what was found.

use std::fmt;
use wcal_core::files::FileError;
use wcal_core::ranges::OutOfRange;
use wcal_core::text::{NotUtf8, brief};

/// An error of a file's content, located as closely as possible.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputErrorFields {
    /// File as named in the session, or its path.
    pub file: String,
    /// Line in the file, header = 1.
    pub line: Option<usize>,
    /// Column or key, e.g. `groove_x_mm` or `whisker.diameter_mm`.
    pub field: Option<String>,
    /// What was expected.
    pub expected: String,
    /// What was found.
    pub found: String,
    /// What to do about it, where that is clear.
    pub hint: Option<String>,
}

/// A boxed [`InputErrorFields`]: a result stays small however much the message says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputError(Box<InputErrorFields>);

impl std::ops::Deref for InputError {
    type Target = InputErrorFields;

    fn deref(&self) -> &InputErrorFields {
        &self.0
    }
}

impl InputError {
    /// An error of a whole file.
    pub fn new(file: &str, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self(Box::new(InputErrorFields {
            file: file.to_owned(),
            line: None,
            field: None,
            expected: brief(&expected.into()),
            found: brief(&found.into()),
            hint: None,
        }))
    }

    /// A number of a file that its key or column cannot have.
    pub fn range(file: &str, error: OutOfRange) -> Self {
        Self::new(file, error.expected, error.found).field(error.key)
    }

    /// Adds the line (header = 1).
    pub fn at(mut self, line: usize) -> Self {
        self.0.line = Some(line);
        self
    }

    /// Adds the column or key.
    pub fn field(mut self, field: impl Into<String>) -> Self {
        self.0.field = Some(brief(&field.into()));
        self
    }

    /// The same of the file that this one was made of, with the line and the name of the column
    /// there.
    #[must_use]
    pub fn of_source(
        mut self,
        file: &str,
        line: impl Fn(usize) -> usize,
        column: impl Fn(&str) -> Option<String>,
    ) -> Self {
        file.clone_into(&mut self.0.file);
        self.0.line = self.0.line.map(line);
        self.0.field = self.0.field.map(|name| column(&name).unwrap_or(name));
        self
    }

    /// Adds what to do about it.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.0.hint = Some(brief(&hint.into()));
        self
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ", row at line {line}")?;
        }
        if let Some(field) = &self.field {
            write!(f, ", field {field}")?;
        }
        write!(f, ": expected {}, found {}", self.expected, self.found)?;
        match &self.hint {
            Some(hint) => write!(f, " ({hint})"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for InputError {}

/// The error of a file that is no UTF-8 text, with the line where it ends to be some.
pub(crate) fn not_utf8(file: &str, bytes: &[u8], found: NotUtf8) -> InputError {
    let valid = std::str::from_utf8(bytes).map_or_else(|e| e.valid_up_to(), str::len);
    let line = 1 + bytes[..valid].iter().filter(|b| **b == b'\n').count();
    InputError::new(file, "UTF-8 text", found.found)
        .at(line)
        .hint(found.way_out)
}

/// Columns of a table as listed in messages: the first of them, and how many there are.
pub(crate) fn listed(columns: &[String]) -> String {
    const MOST: usize = 30;
    let names = columns[..columns.len().min(MOST)].join(", ");
    if columns.len() > MOST {
        format!("{names}, ... ({} in all)", columns.len())
    } else {
        names
    }
}

/// Why a session could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The file system said no.
    #[error(transparent)]
    Io(#[from] FileError),
    /// A file's content cannot be used.
    #[error(transparent)]
    Content(#[from] InputError),
}

impl SessionError {
    /// Wraps an I/O error; a missing file becomes an error that says which file was expected.
    pub(crate) fn reading(error: FileError) -> Self {
        if error.source.kind() == std::io::ErrorKind::NotFound {
            let place = error.path.display().to_string();
            return InputError::new(&place, "a readable file", "no such file").into();
        }
        error.into()
    }
}

/// A cell or value as quoted in messages, shortened.
pub(crate) fn quote(text: &str) -> String {
    const LONGEST: usize = 60;
    if text.is_empty() {
        return "nothing".to_owned();
    }
    if text.chars().count() <= LONGEST {
        return format!("{text:?}");
    }
    let head: String = text.chars().take(LONGEST).collect();
    format!("{:?}", head + "...")
}
