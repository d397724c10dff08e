//! What the page draws of a pair: the pictures, and in their pixels the curve, the measured pieces,
//! tags and groove.

use anyhow::Result;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use nalgebra::Point3;
use wcal_core::shapes_document::PairDocument;
use wcal_report::ShapePicture;
use wcal_vision::picture::Picture;
use wcal_vision::shape::pair_fit::PairFit;
use wcal_vision::stereo::StereoCameras;

/// The drawing of one picture (0 left, 1 right).
///
/// # Errors
/// Where the picture cannot be encoded.
pub(super) fn drawing(
    picture: &Picture,
    camera: usize,
    stereo: &StereoCameras,
    fit: &PairFit,
    pair: &PairDocument,
) -> Result<ShapePicture> {
    let project = |p: &[f64; 3]| {
        let pose = stereo.in_camera(camera, &fit.left_from_base);
        stereo.cameras[camera]
            .project(&(pose * Point3::from(*p)).coords)
            .map(|p| [p.x, p.y])
    };
    let side = ["left", "right"][camera];
    let tags = pair.tags.iter().filter(|t| t.camera == side);
    let places = |shown: bool| {
        let pieces = fit.pieces[camera]
            .iter()
            .filter(|p| p.shows(fit.polarity) == shown);
        pieces.map(|p| p.position_px().into()).collect()
    };
    Ok(ShapePicture {
        side: side.to_owned(),
        size_px: [picture.width, picture.height],
        jpeg_base64: BASE64.encode(picture.jpeg()?),
        tags: tags.map(|t| t.corners_px.to_vec()).collect(),
        curve: pair.centreline_mm.iter().filter_map(project).collect(),
        seen: places(true),
        unseen: places(false),
        groove: pair.groove.as_ref().and_then(|g| project(&g.position_mm)),
    })
}

/// Distance of every measured piece from the reprojected curve (px) over the arc length (mm), left
/// and right.
pub(super) fn residuals(fit: &PairFit) -> [Vec<[f64; 2]>; 2] {
    [0, 1].map(|camera| {
        let all = fit.observations.iter().zip(&fit.system.residuals_px);
        let own = all.filter(|(sight, r)| sight.camera == camera && r.is_finite());
        own.map(|(sight, r)| [sight.arc_mm, *r]).collect()
    })
}
