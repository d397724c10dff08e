//! `wcal report` as a user meets it: a page again, and what it says of documents that give none. That every page comes again byte for byte
//! stands in `schemas.rs`, which has them all.

use crate::support::{code_and_messages, fixture};
use std::fs;
use std::path::Path;

/// What the program says of a folder in which `name` holds `text`; every page must be as it was.
fn said_of(folder: &Path, name: &str, text: Option<&str>) -> String {
    let (path, page) = (folder.join(name), folder.join("report.html"));
    let (before, first) = (fs::read(&path).ok(), fs::read(&page).ok());
    match text {
        Some(text) => fs::write(&path, text).unwrap(),
        None => fs::remove_file(&path).unwrap(),
    }
    let (code, said) = code_and_messages(&["report", folder.to_str().unwrap()]);
    assert_eq!(code, 1, "{name}: {said}");
    assert_eq!(fs::read(&page).ok(), first, "{name}: a page was written");
    match before {
        Some(bytes) => fs::write(&path, bytes).unwrap(),
        None => fs::remove_file(&path).unwrap(),
    }
    said
}

#[test]
fn a_page_comes_again_and_documents_that_give_none_are_named() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("out");
    let out = folder.to_str().unwrap();
    let session = fixture("nist/pontius");
    assert_eq!(code_and_messages(&["verify", session.to_str().unwrap(), "--out", out]).0, 0);
    let page = folder.join("report.html");
    let first = fs::read(&page).unwrap();
    fs::write(&page, "another").unwrap();
    assert_eq!(code_and_messages(&["report", folder.join("report.json").to_str().unwrap()]).0, 0);
    assert!(fs::read(&page).unwrap() == first, "the same page");

    let stored = fs::read_to_string(folder.join("report.json")).unwrap();
    let cut = &stored[..stored.len() / 2];
    let refused = |name: &str, text: Option<&str>, words: &[&str]| {
        let said = said_of(&folder, name, text);
        assert!(said.contains(name) && words.iter().all(|w| said.contains(w)), "{name}: {said}");
    };
    refused("report.json", Some(cut), &["EOF"]);
    refused("report.json", Some(""), &["EOF"]);
    refused(
        "report.json",
        Some("{\"format\": \"wcal-report/99\", \"page\": {}}"),
        &["wcal-report/1", "wcal-report/99"],
    );
    refused("report.json", Some("[1, 2]"), &["format"]);
    refused("report.json", Some("{\"format\": \"wcal-report/1\", \"page\": {\"poem\": {}}}"), &["poem"]);
    refused("report.json", Some(&stored.replace("\"residuals\"", "\"residues\"")), &["residuals"]);
    refused("report.json", None, &["report.json", "found none"]);
    refused("verify.json", Some("{"), &["EOF"]);
    refused("verify.json", None, &["verify.json"]);
    refused("fit-gpr.json", Some("{\"format\": \"wcal-map/1\"}"), &["points"]);

    let empty = place.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let (code, said) = code_and_messages(&["report", empty.to_str().unwrap()]);
    assert!(code == 1 && said.contains("report.json") && said.contains("found none"), "{said}");
    assert_eq!(fs::read_dir(&empty).unwrap().count(), 0);
}
