//! The fixtures are what their hashes say, and every file of theirs is hashed.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use wcal_core::provenance::sha256_hex;

fn files(folder: &Path, out: &mut BTreeSet<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, out);
        } else {
            out.insert(path);
        }
    }
}

/// Lines of SHA256SUMS that do not fit, and files without a line.
fn mismatches(folder: &Path) -> Vec<String> {
    let list = fs::read_to_string(folder.join("SHA256SUMS")).unwrap();
    let mut present = BTreeSet::new();
    files(folder, &mut present);
    present.remove(&folder.join("SHA256SUMS"));
    // The record that a holdout was opened stays with its session; it is no part of the fixture and
    // git ignores it.
    present.retain(|path| path.file_name().is_none_or(|name| name != "unsealed.json"));
    let mut wrong = Vec::new();
    for line in list.lines() {
        let (hash, name) = line.split_once("  ").unwrap();
        let path = folder.join(name.trim_start_matches("./"));
        match fs::read(&path) {
            Ok(bytes) if sha256_hex(&bytes) == hash => {}
            Ok(_) => wrong.push(format!("{} differs", path.display())),
            Err(error) => wrong.push(format!("{}: {error}", path.display())),
        }
        present.remove(&path);
    }
    wrong.extend(
        present
            .iter()
            .map(|path| format!("{} has no hash", path.display())),
    );
    wrong
}

#[test]
fn every_fixture_is_hashed_has_a_source_and_is_unchanged() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures");
    let mut folders = 0;
    for entry in fs::read_dir(&fixtures).unwrap() {
        let folder = entry.unwrap().path();
        if !folder.is_dir() {
            continue;
        }
        folders += 1;
        let source = ["SOURCE.md", "SOURCE.txt", "README.md"]
            .iter()
            .any(|name| folder.join(name).is_file());
        assert!(source, "{} names no source", folder.display());
        assert_eq!(mismatches(&folder), Vec::<String>::new());
    }
    assert!(folders >= 3);
}

#[test]
fn a_changed_or_added_file_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.csv"), "1").unwrap();
    fs::write(
        folder.path().join("SHA256SUMS"),
        format!("{}  ./a.csv\n", sha256_hex(b"1")),
    )
    .unwrap();
    assert!(mismatches(folder.path()).is_empty());
    fs::write(folder.path().join("a.csv"), "2").unwrap();
    fs::write(folder.path().join("b.csv"), "3").unwrap();
    assert_eq!(mismatches(folder.path()).len(), 2);
}
