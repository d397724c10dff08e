//! A board's corners in a picture: chessboards whole, by OpenCV's finders; ChArUco by OpenCV's
//! detector and AprilGrid by AprilTag, also partly hidden.

use crate::calibrate::board::{Board, Pattern, TagOrder, board_points};
use crate::calibrate::bundle::Corners;
use crate::calibrate::chessboard::{BoardSize, Finder, continues_beyond, find_chessboard, refine};
use crate::calibrate::corner::fit_corner;
use crate::calibrate::noise::GridPlace;
use crate::error::{OpenCvContext, VisionError};
use crate::homography::{homography, mapped};
use crate::median::median;
use crate::picture::Picture;
use crate::tags::apriltag_ffi::{Tag, WIDE_BORDER};
use crate::tags::detection::{Search, find_tags};
use crate::tags::tag_corners;
use nalgebra::{Vector2, Vector3};
use opencv::aruco::{
    CharucoBoard, Dictionary, detect_markers_def, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Mat, Point2f, Ptr, Vector};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::rig_devices::TAG_FAMILIES;

/// A board ready for detection.
#[derive(Clone)]
pub struct BoardLayout {
    pub(crate) board: Board,
    /// Points, mm, one entry a corner.
    pub points: Vec<Vector3<f64>>,
    /// Where the points lie in the grid of squares or tags.
    pub(crate) places: Vec<GridPlace>,
}

/// Difference of the markers' share of their squares that is none of blur and threshold: a pixel on
/// a marker of 25 px.
const SHARE_OFF: f64 = 0.04;

/// OpenCV's predefined dictionaries in the order of its enumeration.
pub(crate) const DICTIONARIES: [&str; 21] = [
    "DICT_4X4_50",
    "DICT_4X4_100",
    "DICT_4X4_250",
    "DICT_4X4_1000",
    "DICT_5X5_50",
    "DICT_5X5_100",
    "DICT_5X5_250",
    "DICT_5X5_1000",
    "DICT_6X6_50",
    "DICT_6X6_100",
    "DICT_6X6_250",
    "DICT_6X6_1000",
    "DICT_7X7_50",
    "DICT_7X7_100",
    "DICT_7X7_250",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
];

impl BoardLayout {
    /// Checks the description and lays out the points.
    ///
    /// # Errors
    /// Where a dictionary or family is unknown, or sizes contradict each other.
    pub fn new(board: &Board) -> Result<Self, VisionError> {
        if let Pattern::Charuco {
            marker_mm,
            dictionary,
            ..
        } = &board.pattern
        {
            if !(*marker_mm > 0.0 && *marker_mm < board.square_mm) {
                return Err(VisionError::result(
                    "lay out the board",
                    format!("a marker smaller than the square of {} mm", board.square_mm),
                    format!("{marker_mm} mm"),
                ));
            }
            index_of(dictionary)?;
        }
        Ok(Self::with_tags(
            board.clone(),
            board.size.columns * board.size.rows,
        ))
    }

    /// Lays out the points; of a grid of tags those with smaller numbers than `tags`.
    pub(crate) fn with_tags(board: Board, tags: usize) -> Self {
        let BoardSize { columns, rows } = board.size;
        let (points, places) = match &board.pattern {
            Pattern::AprilGrid { gap_mm, order, .. } => {
                let TagOrder {
                    by_columns,
                    from_right,
                    from_top,
                    ..
                } = *order;
                // Four corners a tag, in the tags' order; y points down.
                let corners_of = |k: usize| {
                    let (i, j) = if by_columns {
                        (k / rows, k % rows)
                    } else {
                        (k % columns, k / columns)
                    };
                    let [right, down] =
                        [!from_right, from_top].map(|positive| if positive { 1.0 } else { -1.0 });
                    let cell = Vector2::new(right * i as f64, down * j as f64);
                    let centre = cell.push(0.0) * (board.square_mm + gap_mm);
                    let corners = tag_corners(board.square_mm);
                    (0..4).map(move |kind| (corners[kind] + centre, GridPlace { cell, kind }))
                };
                (0..tags).flat_map(corners_of).unzip()
            }
            _ => (
                board_points(columns, rows, board.square_mm),
                grid_places(board.size),
            ),
        };
        Self {
            board,
            points,
            places,
        }
    }

    /// Tags that count.
    pub(crate) fn tags(&self) -> usize {
        self.points.len() / 4
    }

    /// What is wrong with the stated sides where the pictures show markers of another share of
    /// their squares.
    pub(crate) fn contradicts(&self, marker_share: f64) -> Option<String> {
        let Board {
            square_mm,
            pattern: Pattern::Charuco { marker_mm, .. },
            ..
        } = &self.board
        else {
            return None;
        };
        let stated = marker_mm / square_mm;
        ((marker_share / stated - 1.0).abs() > SHARE_OFF).then(|| {
            format!(
                "the pictures show markers of {marker_share:.3} of their square's side, stated are {marker_mm} of {square_mm} mm ({stated:.3}): \
                 one of --square-mm and --marker-mm is wrong; the scale follows --square-mm"
            )
        })
    }

    /// Whether corners are found by the markers' numbers alone, wherever these lie on the board.
    pub(crate) fn corners_by_number(&self) -> bool {
        matches!(self.board.pattern, Pattern::AprilGrid { .. })
    }
}

/// Place of a dictionary in OpenCV's enumeration.
fn index_of(dictionary: &str) -> Result<i32, VisionError> {
    let found = DICTIONARIES
        .iter()
        .position(|d| d.eq_ignore_ascii_case(dictionary));
    found.map(|k| k as i32).ok_or_else(|| {
        VisionError::result(
            "lay out the board",
            format!("one of {}", DICTIONARIES.join(", ")),
            dictionary,
        )
    })
}

/// Places of a grid's corners, row by row.
fn grid_places(size: BoardSize) -> Vec<GridPlace> {
    let flat = board_points(size.columns, size.rows, 1.0);
    flat.iter()
        .map(|p| GridPlace {
            cell: p.xy(),
            kind: 0,
        })
        .collect()
}

/// What a picture shows of a board.
#[derive(Debug, Default)]
pub struct MarkerView {
    /// One entry a point of the board.
    pub corners: Corners,
    /// What is to be said of them.
    pub remarks: Vec<String>,
    /// Side of the markers in squares (ChArUco); none where too few corners tell.
    pub marker_share: Option<f64>,
}

/// Corners of the board in a picture, or why there are none or too few.
///
/// # Errors
/// A sentence.
pub fn corners(board: &BoardLayout, picture: &Picture) -> Result<MarkerView, String> {
    let found = match &board.board.pattern {
        Pattern::Chessboard => {
            let size = board.board.size;
            return Ok(MarkerView {
                corners: refine(picture, size, &whole_board(picture, size)?),
                ..MarkerView::default()
            });
        }
        Pattern::Charuco {
            marker_mm,
            dictionary,
            legacy,
        } => charuco_corners(&board.board, (*marker_mm, dictionary, *legacy), picture),
        Pattern::AprilGrid { family, order, .. } => board.tag_corners(family, order.first, picture),
    }
    .map_err(|e| e.to_string())?;
    let count = found.corners.iter().flatten().count();
    if count < 8 {
        return Err(format!(
            "expected at least 8 corners of the board, found {count}"
        ));
    }
    Ok(found)
}

/// Coarse corners of a whole chessboard, or why there are none.
fn whole_board(picture: &Picture, size: BoardSize) -> Result<Vec<Vector2<f64>>, String> {
    let find = |finder| find_chessboard(picture, size, finder).map_err(|e| e.to_string());
    let found = match find(Finder::Classic)? {
        None => find(Finder::Sectors)?,
        found => found,
    };
    let points = found.ok_or(format!(
        "no board of {size} inner corners (absent, cut off or blurred)"
    ))?;
    match continues_beyond(picture, size, &points) {
        None => Ok(points),
        Some(edge) => Err(format!(
            "wrong board size? {size} inner corners found, but the pattern continues beyond its {edge} edge"
        )),
    }
}

type Detected = (Vector<Vector<Point2f>>, Vector<i32>);

fn detect(mat: &Mat, dictionary: &Ptr<Dictionary>) -> Result<Detected, VisionError> {
    let (mut corners, mut ids) = Detected::default();
    detect_markers_def(mat, dictionary, &mut corners, &mut ids).doing("detectMarkers")?;
    Ok((corners, ids))
}

fn charuco_corners(
    board: &Board,
    (marker_mm, dictionary, legacy): (f64, &str, bool),
    picture: &Picture,
) -> Result<MarkerView, VisionError> {
    let BoardSize {
        columns: c,
        rows: r,
    } = board.size;
    // The older layout is today's with a row of squares more, of which the first row is not there.
    let above = usize::from(legacy);
    let dictionary: Ptr<Dictionary> =
        get_predefined_dictionary_i32(index_of(dictionary)?).doing("getPredefinedDictionary")?;
    let (across, down) = (c as i32 + 1, (r + 1 + above) as i32);
    let layout = CharucoBoard::create(
        across,
        down,
        board.square_mm as f32,
        marker_mm as f32,
        &dictionary,
    )
    .doing("CharucoBoard")?;
    let mat = picture.to_mat()?;
    let (marker_corners, ids) = detect(&mat, &dictionary)?;
    let mut out = vec![None; c * r];
    if ids.is_empty() {
        return Ok(MarkerView {
            corners: out,
            ..MarkerView::default()
        });
    }
    let missing = (above * across as usize / 2) as i32;
    let ids: Vector<i32> = ids.iter().map(|id| id + missing).collect();
    let (mut points, mut found) = (Vector::<Point2f>::new(), Vector::<i32>::new());
    interpolate_corners_charuco_def(
        &marker_corners,
        &ids,
        &mat,
        &layout,
        &mut points,
        &mut found,
    )
    .doing("interpolateCornersCharuco")?;
    for (id, p) in found.iter().zip(points.iter()) {
        let place = usize::try_from(id)
            .ok()
            .and_then(|k| k.checked_sub(above * c));
        if let Some(slot) = place.and_then(|k| out.get_mut(k)) {
            *slot = Some(Vector2::new(f64::from(p.x), f64::from(p.y)));
        }
    }
    // The window stays clear of the markers.
    let clear = 0.8 * 0.5 * (1.0 - marker_mm / board.square_mm);
    let coarse = out.clone();
    for (k, slot) in out.iter_mut().enumerate() {
        let Some(here) = coarse[k] else { continue };
        let offset_to = |other: Option<usize>| other.and_then(|o| coarse[o]).map(|p| p - here);
        let row =
            offset_to((k % c + 1 < c).then_some(k + 1)).or(offset_to((k % c > 0).then(|| k - 1)));
        let column =
            offset_to((k + c < coarse.len()).then_some(k + c)).or(offset_to(k.checked_sub(c)));
        *slot = row
            .zip(column)
            .and_then(|(u, v)| {
                fit_corner(
                    picture,
                    &here,
                    [u, v],
                    (clear * u.norm().min(v.norm())).max(3.0),
                )
            })
            .or(Some(here));
    }
    let marker_share = marker_share(board.size, &out, &marker_corners);
    Ok(MarkerView {
        corners: out,
        marker_share,
        ..MarkerView::default()
    })
}

/// Median side of the markers, in squares, by the homography of the board's corners.
fn marker_share(
    size: BoardSize,
    corners: &Corners,
    markers: &Vector<Vector<Point2f>>,
) -> Option<f64> {
    let seen = grid_places(size)
        .into_iter()
        .zip(corners)
        .filter_map(|(p, c)| Some((p.cell, (*c)?)));
    let (cells, at): (Vec<_>, Vec<_>) = seen.unzip();
    let back = homography(&cells, &at)?.try_inverse()?;
    let on_board = |p: Point2f| mapped(&back, &Vector2::new(f64::from(p.x), f64::from(p.y)));
    // On the board's plane perspective does not change the sides.
    let side = |marker: Vector<Point2f>| {
        let ends: Vec<_> = marker.iter().map(on_board).collect::<Option<_>>()?;
        Some(
            (0..4)
                .map(|k| (ends[(k + 1) % 4] - ends[k]).norm())
                .sum::<f64>()
                / 4.0,
        )
    };
    Some(median(markers.iter().filter_map(side))).filter(|share| share.is_finite())
}

impl BoardLayout {
    /// Corners of the grid's tags. Of a tag that is seen twice that one counts which lies where the
    /// others put it.
    fn tag_corners(
        &self,
        family: &str,
        first: u32,
        picture: &Picture,
    ) -> Result<MarkerView, VisionError> {
        let places = &self.places;
        let mut seen: BTreeMap<usize, Vec<Tag>> = BTreeMap::new();
        for tag in board_tags(picture, family, self.tags())?
            .into_iter()
            .filter(|tag| tag.refined)
        {
            if let Some(place) = tag
                .id
                .checked_sub(first)
                .filter(|place| (*place as usize) < self.tags())
            {
                seen.entry(place as usize).or_default().push(tag);
            }
        }
        // A tag seen twice has no place of its own: the grid comes from the others.
        let once = seen.iter().filter(|(_, tags)| tags.len() == 1);
        let (cells, middles): (Vec<_>, Vec<_>) = once
            .map(|(id, tags)| (places[4 * id].cell, tags[0].middle_px()))
            .unzip();
        let grid = homography(&cells, &middles);
        let (mut out, mut remarks) = (vec![None; self.points.len()], Vec::new());
        for (id, mut tags) in seen {
            if tags.len() > 1 {
                remarks.push(format!(
                    "tag {} is seen {} times: counted once",
                    tags[0].id,
                    tags.len()
                ));
                let Some(expected) = grid.as_ref().and_then(|h| mapped(h, &places[4 * id].cell))
                else {
                    continue;
                };
                let off = |t: &Tag| (t.middle_px() - expected).norm();
                tags.sort_by(|a, b| off(a).total_cmp(&off(b)));
            }
            for (slot, corner) in out[4 * id..4 * id + 4].iter_mut().zip(tags[0].corners_px) {
                *slot = Some(corner);
            }
        }
        Ok(MarkerView {
            corners: out,
            remarks,
            marker_share: None,
        })
    }
}

/// The tags of a board, whose border may be of one cell or two: the same picture shows no tags of
/// the other kind, but by chance. Where some of the `wanted` are missing they are searched for
/// apart from the squares that touch them.
fn board_tags(picture: &Picture, family: &str, wanted: usize) -> Result<Vec<Tag>, VisionError> {
    let wide = family.to_owned() + WIDE_BORDER;
    let kinds = [family, &wide]
        .into_iter()
        .filter(|kind| *kind == family || TAG_FAMILIES.contains(kind));
    let mut best = Vec::new();
    for kind in kinds {
        let mut tags = find_tags(picture, kind, None, Search::Whole)?;
        if tags.len() < wanted {
            let more = find_tags(picture, kind, None, Search::Apart)?;
            let known: Vec<u32> = tags.iter().map(|tag| tag.id).collect();
            tags.extend(more.into_iter().filter(|tag| !known.contains(&tag.id)));
        }
        if tags.len() > best.len() {
            best = tags;
        }
    }
    Ok(best)
}

/// Another board than the stated one that a few pictures from all over the set show, in words: of
/// other tags, or with one row or column more or less.
pub(crate) fn other_board(board: &Board, pictures: &[&Path]) -> Option<String> {
    const LOOK: usize = 2;
    let some = pictures
        .iter()
        .step_by(pictures.len().div_ceil(LOOK).max(1));
    let some: Vec<Picture> = some.filter_map(|path| Picture::read(path).ok()).collect();
    // Shown by most of them, or by one alone where there is no other.
    let shown =
        |of: &dyn Fn(&Picture) -> bool| some.iter().filter(|picture| of(picture)).count().min(2);
    let enough = some.len().clamp(1, 2);
    match &board.pattern {
        Pattern::Charuco { .. } => None,
        Pattern::AprilGrid { family, .. } => {
            let tags = board.size.columns * board.size.rows;
            // Small tags are seen by chance here and there, half a board of them is not.
            let most = |p: &Picture, kind: &str| {
                board_tags(p, kind, tags).is_ok_and(|seen| 2 * seen.len() > tags)
            };
            if shown(&|p| most(p, family)) > 0 {
                return None;
            }
            let others = TAG_FAMILIES
                .iter()
                .filter(|kind| *kind != family && !kind.ends_with(WIDE_BORDER));
            let seen = others
                .into_iter()
                .find(|kind| shown(&|p| most(p, kind)) >= enough)?;
            Some(format!(
                "tags of {seen}, none of {family} (--dictionary {seen})"
            ))
        }
        Pattern::Chessboard => {
            /// Longest side on which whole boards are counted, px: the finder's time goes with the
            /// area where it finds nothing.
            const COUNTED_PX: usize = 800;
            let BoardSize { columns, rows } = board.size;
            let whole = |p: &Picture, size| {
                let p = &p.reduced(p.width.max(p.height).div_ceil(COUNTED_PX));
                let found = find_chessboard(p, size, Finder::Classic).ok().flatten();
                found.is_some_and(|points| continues_beyond(p, size, &points).is_none())
            };
            if shown(&|p| whole(p, board.size)) > 0 {
                return None;
            }
            // Squares counted for their corners, then each side by itself.
            let sizes = [(-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1)]
                .into_iter()
                .filter_map(|(c, r)| {
                    let size = BoardSize {
                        columns: columns.checked_add_signed(c)?,
                        rows: rows.checked_add_signed(r)?,
                    };
                    (size.columns.min(size.rows) > 1).then_some(size)
                });
            let seen = sizes
                .into_iter()
                .find(|size| shown(&|p| whole(p, *size)) >= enough)?;
            Some(format!("{seen} inner corners (--board {seen})"))
        }
    }
}

/// What is to be said of pictures that show other tags than stated, and the board with the first tag
/// that they show where they tell it.
pub(crate) fn renumbered(board: &Board, pictures: &[&Path]) -> Option<(Option<Board>, String)> {
    /// Pictures that are looked at, and those of them that show a number which is none by chance.
    const LOOK: usize = 8;
    const SEEN: usize = 2;
    let Pattern::AprilGrid { family, order, .. } = &board.pattern else {
        return None;
    };
    let tags = board.size.columns * board.size.rows;
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for path in pictures
        .iter()
        .step_by(pictures.len().div_ceil(LOOK).max(1))
    {
        let seen = Picture::read(path).and_then(|picture| board_tags(&picture, family, tags));
        seen.unwrap_or_default()
            .iter()
            .for_each(|tag| *counts.entry(tag.id).or_default() += 1);
    }
    counts.retain(|_, count| *count >= SEEN);
    let (low, high) = (*counts.keys().next()?, *counts.keys().next_back()?);
    let last = order.first + tags as u32 - 1;
    if low >= order.first && high <= last {
        return None;
    }
    let seen = format!(
        "tags {low} to {high} are seen, the stated board has {} to {last}",
        order.first
    );
    if (high - low) as usize + 1 != tags {
        let why = format!("{seen} (--first-tag states the first, --board how many)");
        return Some((None, why));
    }
    let mut other = board.clone();
    if let Pattern::AprilGrid { order, .. } = &mut other.pattern {
        order.first = low;
    }
    Some((Some(other), format!("{seen}: taken as --first-tag {low}")))
}
