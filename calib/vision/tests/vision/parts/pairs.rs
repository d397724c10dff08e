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
    let pairs = pair_files(
        &paths(&["l/rest.png", "l/t1.png"]),
        &paths(&["r/rest.png", "r/t1.png"]),
    )
    .unwrap();
    assert_eq!(
        pairs.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(),
        ["rest", "t1"]
    );
    assert!(pairs.iter().all(|p| p.left.is_some() && p.right.is_some()));
}

/// The camera's own number stands last, first or in between; a run's number, or a clock of each
/// camera, stands beside the frame's.
#[test]
fn pairs_by_the_number_that_varies() {
    for (left, right) in [
        (
            ["IMG_00049_0.png", "IMG_00050_0.png", "IMG_00051_0.png"],
            ["IMG_00051_1.png", "IMG_00049_1.png", "IMG_00050_1.png"],
        ),
        (
            ["cam0_7.png", "cam0_8.png", "cam0_9.png"],
            ["cam1_9.png", "cam1_7.png", "cam1_8.png"],
        ),
        (
            ["1_cam0_x2.png", "2_cam0_x2.png", "3_cam0_x2.png"],
            ["3_cam1_x2.png", "1_cam1_x2.png", "2_cam1_x2.png"],
        ),
        (
            ["a5_t100.png", "a6_t200.png", "a7_t300.png"],
            ["b7_t301.png", "b5_t101.png", "b6_t201.png"],
        ),
    ] {
        let pairs = pair_files(&paths(&left), &paths(&right)).unwrap();
        let found: Vec<_> = pairs
            .iter()
            .map(|p| (p.left.clone().unwrap(), p.right.clone().unwrap()))
            .collect();
        let expected = [right[1], right[2], right[0]];
        let expected: Vec<_> = left
            .into_iter()
            .zip(expected)
            .map(|(l, r)| (l.into(), r.into()))
            .collect();
        assert_eq!(found, expected);
    }
    // A single pair has nothing that varies: what is equal counts.
    let one = pair_files(&paths(&["IMG_00049_0.png"]), &paths(&["IMG_00049_1.png"])).unwrap();
    assert_eq!(one.len(), 1);
}

#[test]
fn two_files_of_one_number_are_refused() {
    assert!(pair_files(&paths(&["a1.png", "b1.png"]), &paths(&["c1.png"])).is_err());
}

#[test]
fn patterns() {
    assert!(matches_pattern(b"left*.jpg", b"left01.jpg"));
    assert!(!matches_pattern(b"left*.jpg", b"right01.jpg"));
    // By the definition, letter by letter, over every pattern and name of few letters.
    fn by_definition(pattern: &[u8], name: &[u8]) -> bool {
        match (pattern, name) {
            ([], []) => true,
            ([b'*', rest @ ..], _) => (0..=name.len()).any(|k| by_definition(rest, &name[k..])),
            ([p, rest @ ..], [n, others @ ..]) => {
                (*p == b'?' || p == n) && by_definition(rest, others)
            }
            _ => false,
        }
    }
    let words = |letters: &[u8], longest: u32| -> Vec<Vec<u8>> {
        let of_length = |length: u32| {
            let count = letters.len().pow(length);
            (0..count).map(move |k| {
                (0..length)
                    .map(|d| letters[k / letters.len().pow(d) % letters.len()])
                    .collect()
            })
        };
        (0..=longest).flat_map(of_length).collect()
    };
    let (mut yes, mut no) = (0, 0);
    for pattern in words(b"ab*?", 4) {
        for name in words(b"ab", 5) {
            let found = matches_pattern(&pattern, &name);
            assert_eq!(
                found,
                by_definition(&pattern, &name),
                "{pattern:?} {name:?}"
            );
            if found { yes += 1 } else { no += 1 }
        }
    }
    assert!(yes > 1000 && no > 1000, "{yes} {no}");
    // Many stars before a letter that is not there: a search that tries every way takes longer than
    // the universe is old.
    let stars = [b"*a".repeat(40), b"*b".to_vec()].concat();
    assert!(!matches_pattern(&stars, &b"a".repeat(200)));
}
