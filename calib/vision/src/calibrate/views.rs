//! Pairs of pictures of a board: read, judged, and their corners found.

use crate::calibrate::bundle::BoardView;
use crate::calibrate::document::RejectedView;
use crate::calibrate::markers::{self, BoardLayout, MarkerView};
use crate::error::VisionError;
use crate::median::median;
use crate::pairs::PairFiles;
use crate::picture::{Picture, exif_orientation};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
use std::path::PathBuf;

/// Adds to a refusal what was said of the pictures, and the reasons why views were missing.
pub(crate) fn with_rejections(
    error: VisionError,
    said: Option<&str>,
    rejected: &[RejectedView],
) -> VisionError {
    let each = rejected
        .iter()
        .take(4)
        .map(|r| format!("{}: {}", r.view, r.why));
    let more = (rejected.len() > 4).then(|| format!("and {} more", rejected.len() - 4));
    let said = said.map(str::to_owned);
    let reasons: Vec<String> = said.into_iter().chain(each).chain(more).collect();
    if reasons.is_empty() {
        return error;
    }
    error.and(&format!(" ({})", reasons.join("; ")))
}

/// The size that most pictures have; others are rejected.
fn common_size(sizes: impl Iterator<Item = [usize; 2]>) -> Option<[usize; 2]> {
    let mut counts: BTreeMap<[usize; 2], usize> = BTreeMap::new();
    for s in sizes {
        *counts.entry(s).or_default() += 1;
    }
    counts.into_iter().max_by_key(|c| c.1).map(|c| c.0)
}

/// What the pairs of a folder show of a board.
pub(crate) struct BoardPairs {
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

/// A pair that could be read.
struct Read {
    size: [usize; 2],
    /// Tells pictures that are the same.
    hashes: [u64; 2],
    /// What both pictures show of the board, or why one does not.
    seen: Result<[MarkerView; 2], String>,
}

fn read(files: &PairFiles, board: &BoardLayout) -> Result<Read, String> {
    let pictures = files.read(None)?;
    let [left, right] = pictures.each_ref().map(|p| [p.width, p.height]);
    if left != right {
        return Err(format!(
            "different sizes: left {}x{}, right {}x{} px",
            left[0], left[1], right[0], right[1]
        ));
    }
    let side = |k: usize| {
        let name = ["left", "right"][k];
        markers::corners(board, &pictures[k]).map_err(|why| format!("{name} picture: {why}"))
    };
    let hash = |p: &Picture| BuildHasherDefault::<DefaultHasher>::default().hash_one(&p.data);
    Ok(Read {
        size: left,
        hashes: [hash(&pictures[0]), hash(&pictures[1])],
        seen: side(0).and_then(|left| Ok([left, side(1)?])),
    })
}

/// What is to be said of pictures that other programs turn when they read them.
fn orientations(files: &[PairFiles]) -> Vec<String> {
    let side = |name: &str, of: fn(&PairFiles) -> Option<&PathBuf>| {
        let mut counts: BTreeMap<u8, usize> = BTreeMap::new();
        for path in files.iter().filter_map(of) {
            *counts
                .entry(exif_orientation(path).unwrap_or(1))
                .or_default() += 1;
        }
        if counts.keys().all(|orientation| *orientation == 1) {
            return None;
        }
        let each: Vec<String> = counts.iter().map(|(o, n)| format!("{o} in {n}")).collect();
        let differ = if counts.len() > 1 {
            ": was the camera turned between them?"
        } else {
            ""
        };
        Some(format!(
            "{name} pictures have an EXIF orientation ({}){differ}; taken as stored, where other programs turn them: OpenCV reads them so with IMREAD_IGNORE_ORIENTATION",
            each.join(", ")
        ))
    };
    [
        side("left", |f| f.left.as_ref()),
        side("right", |f| f.right.as_ref()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Corners of a board in all pairs.
pub(crate) fn board_pairs(files: &[PairFiles], board: &BoardLayout) -> BoardPairs {
    let found: Vec<Result<Read, String>> = files.par_iter().map(|f| read(f, board)).collect();
    let with_corners = found.iter().flatten().filter(|r| r.seen.is_ok());
    let size = common_size(with_corners.map(|r| r.size))
        .or_else(|| common_size(found.iter().flatten().map(|r| r.size)));
    let (mut views, mut rejected, mut shares) = (Vec::new(), Vec::new(), Vec::new());
    let mut used: Vec<(&str, [u64; 2])> = Vec::new();
    let mut remarks: BTreeMap<String, usize> = BTreeMap::new();
    for (file, pair) in files.iter().zip(found) {
        let judged = pair.and_then(|pair| {
            let (own, hashes, seen) = (pair.size, pair.hashes, pair.seen?);
            if Some(own) != size {
                return Err(format!("size {}x{} px, other pairs differ", own[0], own[1]));
            }
            let same = used
                .iter()
                .find(|(_, other)| (0..2).any(|k| other[k] == hashes[k]));
            same.map_or(Ok((seen, hashes)), |(name, _)| {
                Err(format!("shares a picture with {name}"))
            })
        });
        match judged {
            Err(why) => rejected.push(RejectedView {
                view: file.name.clone(),
                why,
            }),
            Ok((seen, hashes)) => {
                used.push((&file.name, hashes));
                for view in &seen {
                    shares.extend(view.marker_share);
                    for remark in &view.remarks {
                        *remarks.entry(remark.clone()).or_default() += 1;
                    }
                }
                views.push(BoardView {
                    name: file.name.clone(),
                    corners: seen.map(|view| view.corners),
                });
            }
        }
    }
    let views = if views.len() >= 3 {
        Ok(views)
    } else {
        Err(VisionError::result(
            "calibrate two cameras",
            "at least 3 pairs that show the board in both pictures",
            format!("{} of {} pairs", views.len(), files.len()),
        ))
    };
    let counted = remarks
        .into_iter()
        .map(|(remark, n)| format!("{remark} (in {n} pictures)"));
    let remarks = counted.chain(orientations(files)).collect();
    BoardPairs {
        size,
        views,
        rejected,
        remarks,
        marker_share: median(shares),
    }
}
