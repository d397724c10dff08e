//! Files that a person names.

use anyhow::{Context, Result};
use std::path::Path;
use wcal_core::files;

/// A file, whole.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    files::read(path).with_context(|| format!("reading {}", path.display()))
}

/// A text document.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    files::read_text(path).with_context(|| format!("reading {}", path.display()))
}
