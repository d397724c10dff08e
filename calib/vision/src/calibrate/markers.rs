//! Boards with markers: ChArUco by OpenCV's detector, AprilGrid by AprilTag. Partly hidden boards are welcome.

use crate::calibrate::board::{Board, Pattern, TagOrder, board_points};
use crate::calibrate::chessboard::BoardSize;
use crate::calibrate::corner::fit_corner;
use crate::calibrate::homography::{homography, mapped};
use crate::calibrate::initial::{Corners, median};
use crate::calibrate::noise::GridPlace;
use crate::error::{OpenCvContext, VisionError};
use crate::picture::Picture;
use crate::tags::detection::{Search, Tag, find_tags, tag_corners};
use nalgebra::{Vector2, Vector3};
use opencv::aruco::{
    CharucoBoard, Dictionary, detect_markers_def, get_predefined_dictionary_i32,
    interpolate_corners_charuco_def,
};
use opencv::core::{Mat, Point2f, Ptr, Vector};
use std::collections::BTreeMap;

/// A marker board ready for detection.
#[derive(Clone)]
pub struct MarkerBoard {
    /// Points, mm, one entry a corner.
    pub points: Vec<Vector3<f64>>,
    /// Where the points lie in the grid of squares or tags.
    pub(crate) places: Vec<GridPlace>,
    markers: Markers,
}

/// Which markers, and how they are laid out.
#[derive(Clone)]
pub(crate) enum Markers {
    Charuco(Charuco),
    Tags(TagGrid),
}

/// Difference of the markers' share of their squares that is none of blur and threshold: a pixel on a marker of 25 px.
const SHARE_OFF: f64 = 0.04;

/// A ChArUco board.
#[derive(Debug, Clone)]
pub(crate) struct Charuco {
    /// Inner corners.
    pub size: BoardSize,
    pub square_mm: f64,
    pub marker_mm: f64,
    /// Place in OpenCV's enumeration.
    pub dictionary: i32,
    /// The layout before OpenCV 4.6: with an even number of rows of squares it begins with a light one.
    pub legacy: bool,
}

/// A grid of upright tags, numbered from one corner.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct TagGrid {
    /// Tags along a row and along a column.
    pub size: BoardSize,
    pub side_mm: f64,
    pub gap_mm: f64,
    pub family: String,
    /// Tags that count: those with smaller numbers.
    pub count: usize,
    pub order: TagOrder,
}

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

impl MarkerBoard {
    /// Checks the description and lays out the points; none for a chessboard, which has no markers.
    ///
    /// # Errors
    /// Where a dictionary or family is unknown, or sizes contradict each other.
    pub fn new(board: &Board) -> Result<Option<Self>, VisionError> {
        let (size, square_mm) = (board.size, board.square_mm);
        let markers = match &board.pattern {
            Pattern::Chessboard => return Ok(None),
            Pattern::Charuco { marker_mm, dictionary, legacy } => {
                if !(*marker_mm > 0.0 && *marker_mm < square_mm) {
                    return Err(VisionError::result(
                        "lay out the board",
                        format!("a marker smaller than the square of {square_mm} mm"),
                        format!("{marker_mm} mm"),
                    ));
                }
                let known = |d: &str| d.eq_ignore_ascii_case(dictionary);
                let index = DICTIONARIES.iter().position(|d| known(d)).ok_or_else(|| {
                    let expected = format!("one of {}", DICTIONARIES.join(", "));
                    VisionError::result("lay out the board", expected, dictionary)
                })?;
                Markers::Charuco(Charuco {
                    size,
                    square_mm,
                    marker_mm: *marker_mm,
                    dictionary: index as i32,
                    legacy: *legacy,
                })
            }
            Pattern::AprilGrid { gap_mm, family, order } => Markers::Tags(TagGrid {
                size,
                side_mm: square_mm,
                gap_mm: *gap_mm,
                family: family.clone(),
                count: size.columns * size.rows,
                order: *order,
            }),
        };
        Ok(Some(Self::of(markers)))
    }

    /// Lays out the points.
    pub(crate) fn of(markers: Markers) -> Self {
        let (points, places) = match &markers {
            Markers::Charuco(board) => {
                let BoardSize { columns, rows } = board.size;
                (board_points(columns, rows, board.square_mm), grid_places(board.size))
            }
            Markers::Tags(grid) => grid.laid_out(),
        };
        Self { points, places, markers }
    }

    pub(crate) fn markers(&self) -> &Markers {
        &self.markers
    }

    /// What is wrong with the stated sides where the pictures show markers of another share of their squares.
    pub(crate) fn contradicts(&self, marker_share: f64) -> Option<String> {
        let Markers::Charuco(Charuco { square_mm, marker_mm, .. }) = &self.markers else { return None };
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
        matches!(self.markers, Markers::Tags(_))
    }
}

/// Places of a grid's corners, row by row.
pub(crate) fn grid_places(size: BoardSize) -> Vec<GridPlace> {
    let flat = board_points(size.columns, size.rows, 1.0);
    flat.iter().map(|p| GridPlace { cell: p.xy(), kind: 0 }).collect()
}

impl TagGrid {
    /// Four corners a tag, in the tags' order: points and places. y points down.
    fn laid_out(&self) -> (Vec<Vector3<f64>>, Vec<GridPlace>) {
        let BoardSize { columns, rows } = self.size;
        (0..self.count)
            .flat_map(|k| {
                let TagOrder { by_columns, from_right, from_top } = self.order;
                let (i, j) = if by_columns { (k / rows, k % rows) } else { (k % columns, k / columns) };
                let signed =
                    |step: usize, positive: bool| if positive { step as f64 } else { -(step as f64) };
                let cell = Vector2::new(signed(i, !from_right), signed(j, from_top));
                let centre = cell.push(0.0) * (self.side_mm + self.gap_mm);
                let corners = tag_corners(self.side_mm);
                (0..4).map(move |kind| (corners[kind] + centre, GridPlace { cell, kind }))
            })
            .unzip()
    }
}

/// What a picture shows of a board with markers.
#[derive(Debug, Default)]
pub struct MarkerView {
    /// One entry a point of the board.
    pub corners: Corners,
    /// What is to be said of them.
    pub remarks: Vec<String>,
    /// Side of the markers in squares (ChArUco); none where too few corners tell.
    pub marker_share: Option<f64>,
}

/// Corners of the board in a picture, or why there are too few.
///
/// # Errors
/// A sentence.
pub fn corners(board: &MarkerBoard, picture: &Picture) -> Result<MarkerView, String> {
    let found = match &board.markers {
        Markers::Charuco(charuco) => charuco.corners(picture),
        Markers::Tags(grid) => grid.corners(&board.places, picture),
    }
    .map_err(|e| e.to_string())?;
    let count = found.corners.iter().flatten().count();
    if count < 8 {
        return Err(format!("expected at least 8 corners of the board, found {count}"));
    }
    Ok(found)
}

type Detected = (Vector<Vector<Point2f>>, Vector<i32>);

fn detect(mat: &Mat, dictionary: &Ptr<Dictionary>) -> Result<Detected, VisionError> {
    let (mut corners, mut ids) = Detected::default();
    detect_markers_def(mat, dictionary, &mut corners, &mut ids).doing("detectMarkers")?;
    Ok((corners, ids))
}

impl Charuco {
    fn corners(&self, picture: &Picture) -> Result<MarkerView, VisionError> {
        let BoardSize { columns: c, rows: r } = self.size;
        // The older layout is today's with a row of squares more, of which the first row is not there.
        let above = usize::from(self.legacy);
        let dictionary: Ptr<Dictionary> =
            get_predefined_dictionary_i32(self.dictionary).doing("getPredefinedDictionary")?;
        let (across, down) = (c as i32 + 1, (r + 1 + above) as i32);
        let layout =
            CharucoBoard::create(across, down, self.square_mm as f32, self.marker_mm as f32, &dictionary)
                .doing("CharucoBoard")?;
        let mat = picture.to_mat()?;
        let (marker_corners, ids) = detect(&mat, &dictionary)?;
        let mut out = vec![None; c * r];
        if ids.is_empty() {
            return Ok(MarkerView { corners: out, ..MarkerView::default() });
        }
        let missing = (above * across as usize / 2) as i32;
        let ids: Vector<i32> = ids.iter().map(|id| id + missing).collect();
        let (mut points, mut found) = (Vector::<Point2f>::new(), Vector::<i32>::new());
        interpolate_corners_charuco_def(&marker_corners, &ids, &mat, &layout, &mut points, &mut found)
            .doing("interpolateCornersCharuco")?;
        for (id, p) in found.iter().zip(points.iter()) {
            let place = usize::try_from(id).ok().and_then(|k| k.checked_sub(above * c));
            if let Some(slot) = place.and_then(|k| out.get_mut(k)) {
                *slot = Some(Vector2::new(f64::from(p.x), f64::from(p.y)));
            }
        }
        // The window stays clear of the markers.
        let clear = 0.8 * 0.5 * (1.0 - self.marker_mm / self.square_mm);
        let coarse = out.clone();
        for (k, slot) in out.iter_mut().enumerate() {
            let Some(here) = coarse[k] else { continue };
            let offset_to = |other: Option<usize>| other.and_then(|o| coarse[o]).map(|p| p - here);
            let row = offset_to((k % c + 1 < c).then_some(k + 1)).or(offset_to((k % c > 0).then(|| k - 1)));
            let column = offset_to((k + c < coarse.len()).then_some(k + c)).or(offset_to(k.checked_sub(c)));
            *slot = row
                .zip(column)
                .and_then(|(u, v)| {
                    fit_corner(picture, &here, [u, v], (clear * u.norm().min(v.norm())).max(3.0))
                })
                .map(|f| f.position_px)
                .or(Some(here));
        }
        let marker_share = self.marker_share(&out, &marker_corners);
        Ok(MarkerView { corners: out, marker_share, ..MarkerView::default() })
    }

    /// Median side of the markers, in squares, by the homography of the board's corners.
    fn marker_share(&self, corners: &Corners, markers: &Vector<Vector<Point2f>>) -> Option<f64> {
        let seen = grid_places(self.size).into_iter().zip(corners).filter_map(|(p, c)| Some((p.cell, (*c)?)));
        let (cells, at): (Vec<_>, Vec<_>) = seen.unzip();
        let back = homography(&cells, &at)?.try_inverse()?;
        let on_board = |p: Point2f| mapped(&back, &Vector2::new(f64::from(p.x), f64::from(p.y)));
        let sides: Vec<f64> = markers
            .iter()
            .filter_map(|marker| {
                let ends: Vec<_> = marker.iter().map(on_board).collect::<Option<_>>()?;
                Some((0..4).map(|k| (ends[(k + 1) % 4] - ends[k]).norm()).sum::<f64>() / 4.0)
            })
            .collect();
        Some(median(&sides)).filter(|share| share.is_finite())
    }
}

impl TagGrid {
    /// Corners of the grid's tags. Of a tag that is seen twice that one counts which lies where the others put it.
    fn corners(&self, places: &[GridPlace], picture: &Picture) -> Result<MarkerView, VisionError> {
        let mut seen: BTreeMap<usize, Vec<Tag>> = BTreeMap::new();
        for tag in find_tags(picture, &self.family, None, Search::Whole)? {
            if tag.refined && (tag.id as usize) < self.count {
                seen.entry(tag.id as usize).or_default().push(tag);
            }
        }
        let once = seen.iter().filter(|(_, tags)| tags.len() == 1);
        let (cells, middles): (Vec<_>, Vec<_>) =
            once.map(|(id, tags)| (places[4 * id].cell, tags[0].middle_px())).unzip();
        let grid = homography(&cells, &middles);
        let (mut out, mut remarks) = (vec![None; 4 * self.count], Vec::new());
        for (id, mut tags) in seen {
            if tags.len() > 1 {
                remarks.push(format!("tag {id} is seen {} times: counted once", tags.len()));
                let Some(expected) = grid.as_ref().and_then(|h| mapped(h, &places[4 * id].cell)) else {
                    continue;
                };
                let off = |t: &Tag| (t.middle_px() - expected).norm();
                tags.sort_by(|a, b| off(a).total_cmp(&off(b)));
            }
            for (slot, corner) in out[4 * id..4 * id + 4].iter_mut().zip(tags[0].corners_px) {
                *slot = Some(corner);
            }
        }
        Ok(MarkerView { corners: out, remarks, marker_share: None })
    }
}
