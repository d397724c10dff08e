//! Session folders: reading with every check, writing without half-written files.
//!
//! [`load`] turns a folder (`session.toml` and the tables it names) into [`wcal_core::SessionData`]. Whatever cannot be
//! used is one [`SessionError`] that names file, row, field, what was expected and what was found; what can be used but
//! deserves attention is a warning in [`LoadedSession::warnings`].

mod axis;
mod document;
mod error;
mod row;
mod session;
mod table;
mod transducer;
mod units;
mod whisker;
mod whisker_checks;
mod whisker_meta;

pub use error::{Defect, DefectFields, SessionError};
pub use session::{CLOCK_PROBLEM, LoadedSession, SESSION_FORMAT, load};
pub use whisker::{ReadingTable, load_table};
