//! `wcal report`: a page again, from the documents that its command stored.

use crate::output::{check_beside, write_file};
use crate::page_files::read_page;
use anyhow::{Context, bail, ensure};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::map_document::MAP_FORMAT;
use wcal_report::{REPORT_FORMAT, is_page, render_map};

/// Arguments of `wcal report`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal verify session --out out
  wcal report out

Nothing is computed: the page comes from report.json (with verify.json where a session was verified), fit-gpr.json or dynamics.json. The page of `wcal twin --report NAME.html` has its document beside it: wcal report NAME.json.")]
pub struct ReportArgs {
    /// Folder of results, or one document
    pub place: PathBuf,
}

/// Documents of which a page is made, and the page's name.
const DOCUMENTS: [(&str, &str); 3] =
    [("report.json", "report.html"), ("fit-gpr.json", "report.html"), ("dynamics.json", "dynamics.html")];

/// Runs the command.
///
/// # Errors
/// Where no document is there, or one is not what its page needs.
pub fn run(args: &ReportArgs) -> anyhow::Result<ExitCode> {
    for page in pages_again(&args.place)? {
        println!("report: {}", page.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes every page of a place anew; their paths.
fn pages_again(place: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut made = Vec::new();
    let mut again = |document: PathBuf, page: PathBuf| -> anyhow::Result<()> {
        let html = html_of(&document).with_context(|| document.display().to_string())?;
        write_file(&page, html.as_bytes())?;
        made.push(page);
        Ok(())
    };
    if !place.is_dir() {
        let name = place.file_name().unwrap_or_default();
        let page = match DOCUMENTS.iter().find(|(document, _)| name == *document) {
            Some((_, page)) => place.with_file_name(page),
            // In a folder that is no result the name may be taken.
            None => {
                let page = place.with_extension("html");
                check_beside(std::slice::from_ref(&page), is_page, false)?;
                page
            }
        };
        again(place.to_owned(), page)?;
        return Ok(made);
    }
    for (document, page) in DOCUMENTS {
        if place.join(document).is_file() {
            again(place.join(document), place.join(page))?;
        }
    }
    if made.is_empty() {
        for folder in crate::demo::folders(place) {
            made.extend(pages_again(&folder)?);
        }
        if !made.is_empty() {
            made.push(crate::demo::write_index(place)?);
        }
    }
    let names = DOCUMENTS.map(|(document, _)| document).join(", ");
    ensure!(
        !made.is_empty(),
        "{}: expected a document that a page is made of ({names}), found none",
        place.display()
    );
    Ok(made)
}

/// The page of one document.
fn html_of(path: &Path) -> anyhow::Result<String> {
    let text = wcal_core::files::read_text(path)?;
    let document = wcal_core::document::json(&text)?;
    Ok(match document["format"].as_str() {
        Some(REPORT_FORMAT) => read_page(path)?.render(),
        Some(MAP_FORMAT) => render_map(&serde_json::from_value(document)?),
        found => bail!("format: expected {REPORT_FORMAT} or {MAP_FORMAT}, found {found:?}"),
    })
}
