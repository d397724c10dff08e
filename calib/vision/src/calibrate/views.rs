//! Pairs of pictures of a board: read, judged, and their corners found.

use crate::calibrate::bundle::BoardView;
use crate::calibrate::chessboard::{BoardSize, Finder, continues_beyond, find_chessboard, refine};
use crate::calibrate::document::RejectedView;
use crate::calibrate::initial::median;
use crate::calibrate::markers::{self, MarkerBoard};
use crate::error::VisionError;
use crate::pairs::PairFiles;
use crate::picture::Picture;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::collections::BTreeMap;

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

/// A pair of pictures that can be used.
pub(crate) struct View {
    pub name: String,
    pub pictures: [Picture; 2],
    /// Corners as the finder gave them.
    pub coarse: [Vec<Vector2<f64>>; 2],
}

impl View {
    /// With refined corners.
    pub fn refined(&self, size: BoardSize) -> BoardView {
        let [left, right] = [0, 1].map(|k| {
            let corners = refine(&self.pictures[k], size, &self.coarse[k]);
            corners.into_iter().map(|c| c.map(|c| c.position_px)).collect()
        });
        BoardView { name: self.name.clone(), left, right }
    }
}

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
