//! What reading a table for a session noticed.

use wcal_session::TextTable;

/// What was noticed while reading tables.
#[derive(Default)]
pub(super) struct Noticed {
    /// How they were read.
    pub(super) remarks: Vec<String>,
    /// What is odd about them.
    pub(super) warnings: Vec<String>,
}

impl Noticed {
    /// Of the tables themselves.
    pub(super) fn of(tables: &[TextTable]) -> Self {
        let of_file = |texts: fn(&TextTable) -> &[String]| {
            let said = |t: &TextTable| {
                let said = texts(t).iter().map(|text| format!("{}: {text}", t.file));
                said.collect::<Vec<_>>()
            };
            tables.iter().flat_map(said).collect()
        };
        Self {
            remarks: of_file(|t| &t.remarks),
            warnings: of_file(|t| &t.warnings),
        }
    }
}
