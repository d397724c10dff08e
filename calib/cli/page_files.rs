//! Pages as files: `NAME.html` beside the document that it is made of.

use crate::output::OutputFolder;
use std::path::Path;
use wcal_report::Page;

/// Adds a page and the document that it is made of: `NAME.html`, `NAME.json`.
///
/// # Errors
/// None that a page can cause.
pub fn put_page(out: &mut OutputFolder<'_>, name: &str, page: &Page) -> anyhow::Result<()> {
    out.put(&format!("{name}.json"), page.to_json()?);
    out.put(&format!("{name}.html"), page.render());
    Ok(())
}

/// A page out of `report.json`, with the `verify.json` beside it.
///
/// # Errors
/// Where one of them is not what a page needs.
pub fn read_page(path: &Path) -> anyhow::Result<Page> {
    let text = wcal_core::files::read_text(path)?;
    let verify = wcal_core::files::read_text(path.with_file_name("verify.json")).ok();
    Ok(Page::from_json(&text, verify.as_deref())?)
}
