//! Pairs of pictures of a board: read, judged, and their corners found.

use crate::calibrate::board::Board;
use crate::calibrate::bundle::BoardView;
use crate::calibrate::chessboard::{BoardSize, Finder, continues_beyond, find_chessboard};
use crate::calibrate::document::RejectedView;
use crate::calibrate::guess::other_pattern;
use crate::calibrate::initial::median;
use crate::calibrate::markers::{self, MarkerBoard};
use crate::calibrate::refinement::View;
use crate::error::VisionError;
use crate::pairs::PairFiles;
use crate::picture::Picture;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Adds to a refusal the reasons why views were missing.
pub(crate) fn with_rejections(error: VisionError, rejected: &[RejectedView]) -> VisionError {
    match error {
        VisionError::Result { action, expected, found } if !rejected.is_empty() => {
            let mut reasons: Vec<String> =
                rejected.iter().take(4).map(|r| format!("{}: {}", r.view, r.why)).collect();
            if rejected.len() > 4 {
                reasons.push(format!("and {} more", rejected.len() - 4));
            }
            VisionError::Result { action, expected, found: format!("{found} ({})", reasons.join("; ")) }
        }
        other => other,
    }
}

/// Reads both pictures of a pair; the reason where it cannot be used.
fn read_pair(files: &PairFiles) -> Result<[Picture; 2], String> {
    let (Some(left), Some(right)) = (&files.left, &files.right) else {
        return Err(format!(
            "the {} picture is missing",
            if files.left.is_none() { "left" } else { "right" }
        ));
    };
    let pictures = [left, right].map(|p| Picture::read(p).map_err(|e| e.to_string()));
    let [left_picture, right_picture] = pictures;
    let pictures = [left_picture?, right_picture?];
    for (picture, path) in pictures.iter().zip([left, right]) {
        if let Some(why) = picture.unusable() {
            return Err(format!("{}: {why}", path.display()));
        }
    }
    if [pictures[0].width, pictures[0].height] != [pictures[1].width, pictures[1].height] {
        return Err(format!(
            "different sizes: left {}x{}, right {}x{} px",
            pictures[0].width, pictures[0].height, pictures[1].width, pictures[1].height
        ));
    }
    if pictures[0] == pictures[1] {
        return Err("the left and the right picture are the same".into());
    }
    Ok(pictures)
}

/// The size that most pictures have; others are rejected.
fn common_size(sizes: impl Iterator<Item = [usize; 2]>) -> Option<[usize; 2]> {
    let mut counts: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    for s in sizes {
        *counts.entry(s).or_default() += 1;
    }
    counts.into_iter().max_by_key(|c| c.1).map(|c| c.0)
}

/// Width to which pictures are reduced where only the board's size is in question, px.
const PROBE_PX: usize = 800;
/// The same for the finder that takes seconds where there is no board, and the fourth of it at half the width.
const SECTORS_PROBE_PX: usize = 400;

/// Coarse corners of one side's picture, or why it is of no use.
type CornerReader<'a> = dyn Fn(&Picture, &str) -> Result<Vec<Vector2<f64>>, String> + Sync + 'a;

/// Pairs that show the whole chessboard, and the pictures' size.
///
/// # Errors
/// Where fewer than three pairs do.
pub(crate) fn usable(
    files: &[PairFiles],
    rejected: &mut Vec<RejectedView>,
    find: &CornerReader<'_>,
) -> Result<(Vec<View>, [usize; 2]), VisionError> {
    let found: Vec<Result<View, String>> = files
        .par_iter()
        .map(|f| {
            let pictures = read_pair(f)?;
            let coarse = [find(&pictures[0], "left")?, find(&pictures[1], "right")?];
            Ok(View { name: f.name.clone(), pictures, coarse })
        })
        .collect();
    let size = common_size(found.iter().flatten().map(|v| [v.pictures[0].width, v.pictures[0].height]));
    let mut views: Vec<View> = Vec::new();
    for (file, view) in files.iter().zip(found) {
        let why = match view {
            Err(why) => why,
            Ok(v) if Some([v.pictures[0].width, v.pictures[0].height]) != size => {
                format!("size {}x{} px, other pairs differ", v.pictures[0].width, v.pictures[0].height)
            }
            Ok(v) => {
                let same =
                    views.iter().find(|o| o.pictures[0] == v.pictures[0] || o.pictures[1] == v.pictures[1]);
                match same {
                    Some(other) => format!("shares a picture with {}", other.name),
                    None => {
                        views.push(v);
                        continue;
                    }
                }
            }
        };
        rejected.push(RejectedView { view: file.name.clone(), why });
    }
    match size {
        Some(size) if views.len() >= 3 => Ok((views, size)),
        _ => {
            let count = views.len();
            Err(with_rejections(
                VisionError::result(
                    "calibrate two cameras",
                    "at least 3 pairs that show the whole board in both pictures",
                    format!("{count} of {} pairs", files.len()),
                ),
                rejected,
            ))
        }
    }
}

/// Coarse corners of the whole board, or why there are none.
pub(crate) fn whole_board(
    picture: &Picture,
    size: BoardSize,
    side: &str,
) -> Result<Vec<Vector2<f64>>, String> {
    let find = |finder: Finder| find_chessboard(picture, size, finder).map_err(|e| e.to_string());
    let whole = |points: Vec<Vector2<f64>>| match continues_beyond(picture, size, &points) {
        None => Ok(points),
        Some(edge) => Err(format!(
            "{side} picture: wrong board size? {size} inner corners found, but the pattern continues beyond its {edge} edge"
        )),
    };
    let found = match find(Finder::Classic)? {
        Some(points) => Some(points),
        None => find(Finder::Sectors)?,
    };
    match found {
        Some(points) => whole(points),
        None => Err(format!("{side} picture: no board of {size} inner corners (absent, cut off or blurred)")),
    }
}

/// Left pictures, spread over the folder, that are examined before the stated size is doubted.
const PROBES: usize = 3;

/// Refuses a board that no probe shows where something else is seen in its place, or nothing in any picture: the finders take minutes to
/// fail on a whole folder. A board that is cut off in one picture appears smaller than it is, so that another size has to be seen in all probes.
pub(crate) fn check_board(files: &[PairFiles], board: &Board) -> Result<(), VisionError> {
    let size = board.size;
    let read = |path: &PathBuf| Some(Picture::read(path).ok()?.reduced(PROBE_PX));
    let reduced = probes(files, PROBE_PX);
    let shows = |picture: &Picture, size: BoardSize| -> Result<bool, VisionError> {
        let found = find_chessboard(picture, size, Finder::Classic)?;
        Ok(found.is_some_and(|points| continues_beyond(picture, size, &points).is_none()))
    };
    let all_show = |size: BoardSize| -> Result<bool, VisionError> {
        for picture in &reduced {
            if !shows(picture, size)? {
                return Ok(false);
            }
        }
        Ok(!reduced.is_empty())
    };
    let stated = |finder: Finder, width_px: usize| {
        let found = |picture: &Picture| {
            find_chessboard(&picture.reduced(width_px), size, finder).is_ok_and(|f| f.is_some())
        };
        reduced.par_iter().any(found)
    };
    if stated(Finder::Classic, PROBE_PX) {
        return Ok(());
    }
    let refused =
        |found: String| Err(VisionError::result("find the board", format!("{size} inner corners"), found));
    let other = other_pattern(&reduced, board);
    let (c, r) = (size.columns as i64, size.rows as i64);
    let others = [
        (c - 1, r),
        (c, r - 1),
        (c - 1, r - 1),
        (c + 1, r),
        (c, r + 1),
        (c + 1, r + 1),
        (c - 2, r),
        (c, r - 2),
    ];
    if other.is_none() {
        for (columns, rows) in others.into_iter().filter(|(c, r)| c.min(r) >= &3) {
            let other = BoardSize { columns: columns as usize, rows: rows as usize };
            if all_show(other)? {
                return refused(format!(
                    "a whole board of {other} in {} pictures: wrong board size?",
                    reduced.len()
                ));
            }
        }
    }
    if stated(Finder::Sectors, SECTORS_PROBE_PX) {
        return Ok(());
    }
    if let Some(seen) = other {
        return refused(format!("{seen} in their place"));
    }
    // A picture that cannot be read may show it: its own reason is said later.
    let perhaps = |file: &PairFiles| {
        let picture = file.left.as_ref().and_then(read);
        picture.is_none_or(|p| find_chessboard(&p, size, Finder::Classic).is_ok_and(|f| f.is_some()))
    };
    // Small squares of a large board are lost in reduced pictures: the probes once more as they are.
    let whole =
        |picture: &Picture| find_chessboard(picture, size, Finder::Sectors).is_ok_and(|f| f.is_some());
    if files.par_iter().any(perhaps) || probes(files, usize::MAX).par_iter().any(whole) {
        return Ok(());
    }
    refused(format!("none in {} pictures, and none of another pattern that is known", files.len()))
}

/// Some left pictures, reduced to a width.
fn probes(files: &[PairFiles], width_px: usize) -> Vec<Picture> {
    let count = PROBES.min(files.len());
    (0..count)
        .filter_map(|k| files[k * files.len() / count].left.as_ref())
        .filter_map(|path| Some(Picture::read(path).ok()?.reduced(width_px)))
        .collect()
}

/// What the pairs of a folder show of a board with markers.
pub(crate) struct MarkerPairs {
    /// Size that most pictures have, px.
    pub size: Option<[usize; 2]>,
    /// Pairs with enough corners, or why there are too few.
    pub views: Result<Vec<BoardView>, VisionError>,
    pub rejected: Vec<RejectedView>,
    /// On the corners, with the number of pictures that they hold for.
    pub remarks: Vec<String>,
    /// Side of the markers in squares; NaN where nothing tells.
    pub marker_share: f64,
}

/// Corners of a board with markers in all pairs.
pub(crate) fn marker_pairs(files: &[PairFiles], board: &MarkerBoard) -> MarkerPairs {
    type Found = (Result<(BoardView, Vec<String>, Vec<f64>), String>, Option<[usize; 2]>);
    let found: Vec<Found> = files
        .par_iter()
        .map(|f| {
            let pictures = match read_pair(f) {
                Ok(pictures) => pictures,
                Err(why) => return (Err(why), None),
            };
            let (mut remarks, mut shares) = (Vec::new(), Vec::new());
            let mut side = |k: usize, name: &str| {
                let seen =
                    markers::corners(board, &pictures[k]).map_err(|w| format!("{name} picture: {w}"))?;
                remarks.extend(seen.remarks);
                shares.extend(seen.marker_share);
                Ok::<_, String>(seen.corners)
            };
            let view = side(0, "left")
                .and_then(|left| Ok(BoardView { name: f.name.clone(), left, right: side(1, "right")? }));
            (view.map(|v| (v, remarks, shares)), Some([pictures[0].width, pictures[0].height]))
        })
        .collect();
    let with_corners = found.iter().filter(|f| f.0.is_ok()).filter_map(|f| f.1);
    let size = common_size(with_corners).or_else(|| common_size(found.iter().filter_map(|f| f.1)));
    let (mut views, mut rejected, mut shares) = (Vec::new(), Vec::new(), Vec::new());
    let mut remarks: BTreeMap<String, usize> = BTreeMap::new();
    for (file, (view, own)) in files.iter().zip(found) {
        let why = match view {
            Ok((view, more, one)) if own == size => {
                views.push(view);
                shares.extend(one);
                for remark in more {
                    *remarks.entry(remark).or_default() += 1;
                }
                continue;
            }
            Ok(_) => "size differs from other pairs".into(),
            Err(why) => why,
        };
        rejected.push(RejectedView { view: file.name.clone(), why });
    }
    let views = if views.len() >= 3 {
        Ok(views)
    } else {
        let found = format!("{} of {} pairs", views.len(), files.len());
        let expected = "at least 3 pairs that show the board in both pictures";
        Err(VisionError::result("calibrate two cameras", expected, found))
    };
    let remarks = remarks.into_iter().map(|(remark, n)| format!("{remark} (in {n} pictures)")).collect();
    MarkerPairs { size, views, rejected, remarks, marker_share: median(&shares) }
}

/// Adds to a refusal what the pictures show in place of the stated board.
pub(crate) fn with_guess(error: VisionError, files: &[PairFiles], board: &Board) -> VisionError {
    match (error, other_pattern(&probes(files, PROBE_PX), board)) {
        (VisionError::Result { action, expected, found }, Some(seen)) => {
            VisionError::Result { action, expected, found: format!("{found}; the pictures show {seen}") }
        }
        (error, _) => error,
    }
}
