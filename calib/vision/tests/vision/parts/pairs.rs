//! Which files make a pair.

use std::path::PathBuf;
use wcal_vision::pairs::{matches_pattern, pair_files};

fn paths(names: &[&str]) -> Vec<PathBuf> {
    names.iter().map(PathBuf::from).collect()
}

#[test]
fn pairs_by_number_and_keeps_the_widow() {
    let pairs = pair_files(
        &paths(&["left01.jpg", "left02.jpg", "left10.jpg"]),
        &paths(&["right02.jpg", "right01.jpg"]),
    )
    .unwrap();
    assert_eq!(pairs.len(), 3);
    assert_eq!(pairs[1].right, Some(PathBuf::from("right02.jpg")));
    assert!(pairs[2].right.is_none());
}

#[test]
fn pairs_by_equal_names() {
    let pairs = pair_files(&paths(&["l/rest.png", "l/t1.png"]), &paths(&["r/rest.png", "r/t1.png"])).unwrap();
    assert_eq!(pairs.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(), ["rest", "t1"]);
    assert!(pairs.iter().all(|p| p.left.is_some() && p.right.is_some()));
}

#[test]
fn two_files_of_one_number_are_refused() {
    assert!(pair_files(&paths(&["a1.png", "b1.png"]), &paths(&["c1.png"])).is_err());
}

#[test]
fn patterns() {
    assert!(matches_pattern(b"left*.jpg", b"left01.jpg"));
    assert!(!matches_pattern(b"left*.jpg", b"right01.jpg"));
}
