//! The compiler that is stated is the one that is pinned, and old enough for nothing that is used.

use crate::support::{packages, repository};
use std::fs;

fn text(name: &str) -> String {
    fs::read_to_string(repository(name)).unwrap()
}

/// Major and minor version.
fn version(text: &str) -> Option<(u32, u32)> {
    let mut parts = text.split('.').map(|p| p.parse().ok());
    Some((parts.next()??, parts.next()??))
}

/// Every "Rust 1.N" of a text.
fn stated(text: &str) -> Vec<(u32, u32)> {
    text.split("Rust ")
        .skip(1)
        .filter_map(|rest| {
            let end = rest
                .find(|c: char| !c.is_ascii_digit() && c != '.')
                .unwrap_or(rest.len());
            version(rest[..end].trim_end_matches('.'))
        })
        .collect()
}

/// What does not agree with the pinned version.
fn disagreements(pinned: (u32, u32), said: &[(String, (u32, u32))]) -> Vec<String> {
    said.iter()
        .filter(|(_, v)| *v != pinned)
        .map(|(who, v)| format!("{who}: {}.{}", v.0, v.1))
        .collect()
}

#[test]
fn one_version_of_rust_is_stated_pinned_and_enough() {
    let toolchain: toml::Table = text("rust-toolchain.toml").parse().unwrap();
    let pinned = version(toolchain["toolchain"]["channel"].as_str().unwrap()).unwrap();
    let mut said: Vec<(String, (u32, u32))> = Vec::new();
    for page in ["README.md", "CONTRIBUTING.md", "docs/src/guide/start.md"] {
        let found = stated(&text(page));
        assert!(!found.is_empty(), "{page} states a version");
        said.extend(found.into_iter().map(|v| (page.to_owned(), v)));
    }
    let packages = packages::resolved();
    let own = packages.iter().filter(|p| p.source.is_none());
    said.extend(own.map(|p| {
        (
            p.name.clone(),
            p.rust_version
                .as_deref()
                .and_then(version)
                .unwrap_or((0, 0)),
        )
    }));
    assert!(said.len() > 15, "{said:?}");
    assert_eq!(disagreements(pinned, &said), Vec::<String>::new());
    let newer: Vec<&str> = packages
        .iter()
        .filter(|p| {
            p.rust_version
                .as_deref()
                .and_then(version)
                .is_some_and(|v| v > pinned)
        })
        .map(|p| p.name.as_str())
        .collect();
    assert!(
        newer.is_empty(),
        "packages that ask for a newer compiler: {newer:?}"
    );
    // Negative controls.
    said.push(("a page".to_owned(), stated("with Rust 1.91 or later")[0]));
    assert_eq!(disagreements(pinned, &said), ["a page: 1.91"]);
}
