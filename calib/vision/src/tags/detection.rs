//! Tags: detection by AprilTag, corners by fits to the pixels about their edges.

use crate::camera::{Camera, distorted_px, undistorted_px};
use crate::error::{OpenCvContext, VisionError};
use crate::picture::Picture;
use crate::tags::apriltag_ffi::{MIN_CONTRAST, Region, Tag, WIDE_BORDER, detect};
use crate::tags::edges::{Edges, refine_by_edges};
use crate::tags::regions::tag_regions;
use nalgebra::Vector2;
use opencv::core::{BORDER_REPLICATE, CV_8UC1, Mat, Point, Size};
use opencv::imgproc;
use opencv::prelude::*;

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
) -> Result<Vec<Tag>, VisionError> {
    let whole = |picture: &Picture, decimate| {
        let region = Region {
            low: [0; 2],
            high: [picture.width, picture.height],
            decimate,
        };
        detect(picture, family, &[region], MIN_CONTRAST)
    };
    match search {
        Search::Halved => whole(picture, 2.0),
        Search::StrongContrast if DARK_BORDERS.contains(&family) => {
            let (regions, contrast) = tag_regions(picture)?;
            detect(picture, family, &regions, contrast).map(once_each)
        }
        // The other families' borders are bright.
        Search::StrongContrast | Search::Whole => whole(picture, 1.0),
        Search::Apart => {
            let mut found = whole(&apart(picture)?, 1.0)?;
            // Pixel centres are at integers: the doubled picture's column 0 is this one's -1/4.
            for corner in found.iter_mut().flat_map(|tag| &mut tag.corners_px) {
                *corner = corner.map(|x| 0.5 * (x + 0.5) - 0.5);
            }
            Ok(found)
        }
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
    let mut tags = detect_tags(picture, family, search)?;
    tags.iter_mut().for_each(|tag| refine(picture, tag, camera));
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
fn once_each(mut tags: Vec<Tag>) -> Vec<Tag> {
    tags.sort_by(|a, b| b.decision_margin.total_cmp(&a.decision_margin));
    let mut kept: Vec<Tag> = Vec::with_capacity(tags.len());
    for tag in tags {
        let near = 0.5 * (tag.corners_px[1] - tag.corners_px[0]).norm();
        let same = |k: &Tag| k.id == tag.id && (k.middle_px() - tag.middle_px()).norm() < near;
        if !kept.iter().any(same) {
            kept.push(tag);
        }
    }
    kept
}

/// Fits a tag's corners to the pixels about its edges, where that can be done.
fn refine(picture: &Picture, tag: &mut Tag, camera: Option<&Camera>) {
    let start = tag.corners_px.map(|p| undistorted_px(camera, &p));
    let cells = cells_along_side(&tag.family);
    // By the outline alone a tone curve's shift of all edges is the same as a larger tag; inner
    // edges of cells that are large enough distinguish the two. Small tags have their outline only.
    let by = |from: &[Vector2<f64>; 4], kind| refine_by_edges(picture, camera, from, cells, kind);
    let found = by(&start, Edges::Cells).or_else(|| {
        let outline = by(&start, Edges::Outline)?;
        by(&outline.corners, Edges::Cells).or(Some(outline))
    });
    if let Some(found) = found {
        tag.corners_px = found.corners.map(|c| distorted_px(camera, &c));
        tag.covariances_px2 = found.covariances;
        tag.refined = true;
    }
}
