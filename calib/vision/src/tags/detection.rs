//! Tags: detection by AprilTag, corners by fits to the pixels about their edges.

use crate::camera::{Camera, distorted_px, undistorted_px};
use crate::error::{OpenCvContext, VisionError};
use crate::picture::Picture;
use crate::tags::apriltag_ffi::{MIN_CONTRAST, RawTag, Region, WIDE_BORDER, detect};
use crate::tags::edges::{Edges, refine_by_edges};
use crate::tags::regions::tag_regions;
use nalgebra::{Matrix2, Vector2};
use opencv::core::{BORDER_REPLICATE, CV_8UC1, Mat, Point, Size};
use opencv::imgproc;
use opencv::prelude::*;

/// A tag in one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tag {
    /// Family.
    pub family: String,
    /// Number.
    pub id: u32,
    /// Contrast of the decision, DN.
    pub decision_margin: f64,
    /// Corners, px, in the tag's frame (x right, y down): (-,+), (+,+), (+,-), (-,-).
    pub corners_px: [Vector2<f64>; 4],
    /// Covariances of the corners, px^2.
    pub covariances_px2: [Matrix2<f64>; 4],
    /// Whether the edges could be fitted; otherwise the library's corners stand, with a wide
    /// covariance.
    pub refined: bool,
}

impl Tag {
    /// Mean of the corners, px.
    pub(crate) fn middle_px(&self) -> Vector2<f64> {
        self.corners_px.iter().sum::<Vector2<f64>>() / 4.0
    }
}

/// Cells (bits) along the side between the detected corners; the outermost ring is of one colour,
/// its outside neighbour of the other.
fn cells_along_side(family: &str) -> usize {
    if let Some(plain) = family.strip_suffix(WIDE_BORDER) {
        return cells_along_side(plain) + 2;
    }
    match family {
        "tag25h9" => 7,
        "tag16h5" => 6,
        "tagStandard41h12" => 5,
        "tagStandard52h13" => 6,
        "tagCircle21h7" => 5,
        _ => 8,
    }
}

/// Where tags are searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// Where the picture shows dark pieces of strong contrast, like a tag's border: a third of the
    /// time. A tag in the shade may be missed.
    StrongContrast,
    /// All of the picture at half its size: whatever the contrast, but no small tags.
    Halved,
    /// All of the picture.
    Whole,
    /// All of the picture at twice its size and with dark places half a pixel smaller: tags whose
    /// corners dark squares touch, as on Kalibr's grids, come apart from them.
    Apart,
}

/// Detects the tags of a family, with the corners of AprilTag's quads.
///
/// # Errors
/// Where the family is unknown.
pub fn detect_tags(
    picture: &Picture,
    family: &str,
    search: Search,
) -> Result<Vec<RawTag>, VisionError> {
    let whole = Region::whole(picture);
    match search {
        Search::Halved => detect(
            picture,
            family,
            &[Region {
                decimate: 2.0,
                ..whole
            }],
            MIN_CONTRAST,
        ),
        Search::StrongContrast if DARK_BORDERS.contains(&family) => {
            let (regions, contrast) = tag_regions(picture);
            detect(picture, family, &regions, contrast).map(once_each)
        }
        Search::Apart => {
            let larger = apart(picture)?;
            let found = detect(&larger, family, &[Region::whole(&larger)], MIN_CONTRAST)?;
            let back = |tag: RawTag| RawTag {
                corners_px: tag
                    .corners_px
                    .map(|corner| corner.map(|x| 0.5 * (x + 0.5) - 0.5)),
                ..tag
            };
            Ok(found.into_iter().map(back).collect())
        }
        // The other families' borders are bright.
        Search::StrongContrast | Search::Whole => detect(picture, family, &[whole], MIN_CONTRAST),
    }
}

/// Detects and refines the tags of a family. With a camera, edges are straight in the undistorted
/// picture; without, in the picture itself.
///
/// # Errors
/// Where the family is unknown.
pub fn find_tags(
    picture: &Picture,
    family: &str,
    camera: Option<&Camera>,
    search: Search,
) -> Result<Vec<Tag>, VisionError> {
    let found = detect_tags(picture, family, search)?;
    let mut tags: Vec<Tag> = found
        .into_iter()
        .map(|raw| refine(picture, raw, camera))
        .collect();
    tags.sort_by_key(|t| t.id);
    Ok(tags)
}

/// The picture at twice its size, each pixel as bright as the brightest beside it.
fn apart(picture: &Picture) -> Result<Picture, VisionError> {
    let doing = "search for tags";
    let (width, height) = (2 * picture.width, 2 * picture.height);
    let (mut larger, mut opened) = (Mat::default(), Mat::default());
    let size = Size::new(width as i32, height as i32);
    imgproc::resize(
        &picture.to_mat()?,
        &mut larger,
        size,
        0.0,
        0.0,
        imgproc::INTER_LINEAR,
    )
    .doing(doing)?;
    let square = Mat::ones(3, 3, CV_8UC1)
        .doing(doing)?
        .to_mat()
        .doing(doing)?;
    let border = imgproc::morphology_default_border_value().doing(doing)?;
    let anchor = Point::new(-1, -1);
    imgproc::dilate(
        &larger,
        &mut opened,
        &square,
        anchor,
        1,
        BORDER_REPLICATE,
        border,
    )
    .doing(doing)?;
    Picture::new(width, height, opened.data_bytes().doing(doing)?.to_vec())
}

/// Families with a black border about their cells.
const DARK_BORDERS: [&str; 3] = ["tag36h11", "tag25h9", "tag16h5"];

/// Of the same tag found in two regions the more certain one stays.
fn once_each(mut tags: Vec<RawTag>) -> Vec<RawTag> {
    tags.sort_by(|a, b| b.decision_margin.total_cmp(&a.decision_margin));
    let corner = |t: &RawTag, k: usize| Vector2::from(t.corners_px[k]);
    let middle = |t: &RawTag| (0..4).map(|k| corner(t, k)).sum::<Vector2<f64>>() / 4.0;
    let mut kept: Vec<RawTag> = Vec::with_capacity(tags.len());
    for tag in tags {
        let near = 0.5 * (corner(&tag, 1) - corner(&tag, 0)).norm();
        if !kept
            .iter()
            .any(|k| k.id == tag.id && (middle(k) - middle(&tag)).norm() < near)
        {
            kept.push(tag);
        }
    }
    kept
}

fn refine(picture: &Picture, raw: RawTag, camera: Option<&Camera>) -> Tag {
    let start = raw
        .corners_px
        .map(|p| undistorted_px(camera, &Vector2::new(p[0], p[1])));
    let cells = cells_along_side(&raw.family);
    // By the outline alone a tone curve's shift of all edges is the same as a larger tag; inner
    // edges of cells that are large enough distinguish the two. Small tags have their outline only.
    let by = |from: &[Vector2<f64>; 4], kind| {
        let found = refine_by_edges(picture, camera, from, cells, kind)?;
        Some((found.corners, found.covariances))
    };
    let found = by(&start, Edges::Cells).or_else(|| {
        let outline = by(&start, Edges::Outline)?;
        by(&outline.0, Edges::Cells).or(Some(outline))
    });
    let refined = found.is_some();
    // Unrefined corners of the library are good to a few tenths of a pixel.
    let (corners, covariances_px2) = found.unwrap_or((start, [Matrix2::identity() * 0.04; 4]));
    Tag {
        family: raw.family,
        id: raw.id,
        decision_margin: raw.decision_margin,
        corners_px: corners.map(|c| distorted_px(camera, &c)),
        covariances_px2,
        refined,
    }
}
