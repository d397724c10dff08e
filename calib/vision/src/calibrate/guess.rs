//! What pictures show that do not show the stated board: said within seconds, before the finders search a whole folder in vain.

use crate::calibrate::board::{Board, Pattern};
use crate::calibrate::chessboard::{Finder, find_chessboard};
use crate::calibrate::markers::{DICTIONARIES, marker_ids};
use crate::picture::Picture;
use crate::tags::detection::{Search, detect_tags};
use std::collections::BTreeSet;

/// Families of boards; the others' tables of codes take seconds to make.
const FAMILIES: [&str; 4] = ["tag36h11", "tag25h9", "tag16h5", "tagStandard41h12"];
/// Different markers in one picture that are no chance, and more than a bench carries.
const BOARD_MARKERS: usize = 4;

/// The pattern that one of the pictures shows, with the options that state it; none where nothing is recognised.
pub(crate) fn other_pattern(pictures: &[Picture], stated: &Board) -> Option<String> {
    pictures
        .iter()
        .find_map(|p| tags(p, stated).or_else(|| markers(p, stated)).or_else(|| squares(p, stated)))
}

fn tags(picture: &Picture, stated: &Board) -> Option<String> {
    let others = FAMILIES
        .into_iter()
        .filter(|f| !matches!(&stated.pattern, Pattern::AprilGrid { family, .. } if family == f));
    others.into_iter().find_map(|family| {
        let found = detect_tags(picture, family, Search::Halved).ok()?;
        let ids: BTreeSet<u32> = found.iter().filter(|t| t.hamming == 0).map(|t| t.id).collect();
        counted(&ids).map(|n| format!("{n} tags (--pattern aprilgrid --dictionary {family})"))
    })
}

fn markers(picture: &Picture, stated: &Board) -> Option<String> {
    let own = match &stated.pattern {
        Pattern::Charuco { dictionary, .. } => Some(dictionary),
        _ => None,
    };
    let seen = |(k, name): (usize, &&'static str)| {
        let ids: BTreeSet<i32> = marker_ids(picture, k as i32).ok()?.into_iter().collect();
        counted(&ids).map(|n| (n, *name))
    };
    let found: Vec<(usize, &str)> = DICTIONARIES.iter().enumerate().filter_map(seen).collect();
    let most = found.iter().map(|f| f.0).max()?;
    // The markers of a small dictionary are those of the larger ones as well.
    let all: Vec<&str> = found.iter().filter(|f| f.0 == most).map(|f| f.1).collect();
    (!all.iter().any(|d| own.is_some_and(|o| o.eq_ignore_ascii_case(d))))
        .then(|| format!("{most} markers (--pattern charuco --dictionary {})", all[0]))
}

fn squares(picture: &Picture, stated: &Board) -> Option<String> {
    if stated.pattern == Pattern::Chessboard {
        return None;
    }
    let found = find_chessboard(picture, stated.size, Finder::Classic).ok().flatten();
    found.map(|_| format!("squares with {} inner corners (--pattern chessboard)", stated.size))
}

fn counted<T>(ids: &BTreeSet<T>) -> Option<usize> {
    (ids.len() >= BOARD_MARKERS).then_some(ids.len())
}
