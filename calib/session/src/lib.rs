//! Session folders: reading with every check.
//!
//! [`load`] turns a folder (`session.toml` and the tables it names) into
//! [`wcal_core::SessionData`]. Whatever cannot be used is one [`SessionError`] that names file,
//! row, field, what was expected and what was found; what can be used but deserves attention is a
//! warning in [`LoadedSession::warnings`].

mod axis;
mod cell;
mod columns;
mod document;
mod edit;
mod error;
mod findings;
mod foreign;
mod form;
mod holdout;
mod ledger;
mod motion_log;
pub mod motion_table;
mod quantity;
mod row;
mod screening;
mod separated;
mod session;
mod shapes;
mod sheet;
mod stamp;
pub mod sweep_session;
mod table;
mod transducer;
mod units;
mod warning;
mod whisker;
mod whisker_checks;
mod whisker_meta;

pub use cell::{is_among, name_of as column_name};
pub use edit::set_entries;

pub use error::{InputError, SessionError};
pub use findings::{Finding, Severity, examine};
pub use foreign::{AskedColumn, Stamps, asked_name};
pub use holdout::{add_session, attach_holdout};

pub use ledger::{LedgerFile, SessionLedger};

pub use motion_log::{Motion, MotionLog, MotionUnknown};
pub use quantity::{
    Relation, bracketed, is_unit, possible_units, relation, stated_unit, unit_in_name,
};
pub use separated::Separator;
pub use session::{LoadedSession, SESSION_FORMAT, load};
pub use table::{SIMULATED_COLUMN, TextTable, TextTableLayout, read_table_text, read_text_table};
pub use warning::{SessionWarning, WarningKind, named};

pub use whisker::{IN_SESSION, WHISKER_COLUMNS, load_table};
pub use whisker_meta::check_wire;
