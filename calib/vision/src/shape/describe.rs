//! One pair's entry of `shapes.json`: points and their region, gaps, residuals, tags.

use crate::rigid::rows;
use crate::shape::curve_fit::between;
use crate::shape::joint::{PairUncertainty, node_covariance, planar_sd};
use crate::shape::pair_fit::PairFit;
use nalgebra::Matrix3;
use wcal_core::shapes_document::{Gap, PairDocument, TagDocument};

/// Adds the fit's results.
pub(crate) fn describe(
    document: &mut PairDocument,
    fit: &PairFit,
    uncertain: Option<&PairUncertainty>,
) {
    document.status = "ok".into();
    document.left_from_base = rows(&fit.left_from_base).to_vec();
    document.length_mm = fit.length_mm;
    document.length_sd_mm = fit.length_sd_mm;
    document.warnings.extend(fit.warnings.iter().cloned());
    let shape = fit.model.shape(&fit.state);
    let jacobian = fit.model.jacobian(&fit.state);
    for (_, i, f) in places(fit) {
        let p = between(&shape.points, (i, f));
        document.centreline_mm.push(p.into());
        let sd = uncertain.map_or(f64::NAN, |u| {
            let c = node_covariance(fit, &jacobian, i + usize::from(f > 0.5), u);
            let t = shape.tangents[i];
            // A place along the wire has no mark: only what lies across it is an error of the line.
            let across = Matrix3::identity() - t * t.transpose();
            let mut e: [f64; 3] = (across * c * across).symmetric_eigenvalues().into();
            e.sort_by(f64::total_cmp);
            // The least eigenvalue is that along the wire, which is 0.
            planar_sd(e[2].max(0.0), e[1].max(0.0))
        });
        document.centreline_sd_mm.push(sd);
    }
    document.gaps = gaps(fit);
    document.residual_rms_px = [0, 1].map(|camera| {
        let all = fit.observations.iter().zip(&fit.system.residuals_px);
        let own = all.filter(|(s, r)| s.camera == camera && r.is_finite());
        let (n, sum) = own.fold((0.0, 0.0), |(n, sum), (_, r)| (n + 1.0, sum + r * r));
        f64::sqrt(sum / f64::max(n, 1.0))
    });
}

/// Places of the centre line half a millimetre apart: arc length (mm), node before, and the
/// fraction of the interval to the next.
pub(crate) fn places(fit: &PairFit) -> impl Iterator<Item = (f64, usize, f64)> + '_ {
    let last = fit.model.nodes as f64 - 1.001;
    let count = (fit.length_mm / 0.5).round().max(1.0) as usize;
    (0..=count).map(move |k| {
        let s = fit.length_mm * k as f64 / count as f64;
        let x = (s / fit.model.step_mm).min(last);
        (s, x.floor() as usize, x.fract())
    })
}

/// Stretches of more than a millimetre that one or both pictures do not show.
fn gaps(fit: &PairFit) -> Vec<Gap> {
    let cell = 0.25;
    let n = (fit.length_mm / cell).ceil() as usize;
    let mut hidden = vec![[true; 2]; n];
    for (camera, piece) in fit.seen() {
        let k = (piece.station.arc_mm / cell) as usize;
        for h in hidden.iter_mut().take(k + 2).skip(k.saturating_sub(1)) {
            h[camera] = false;
        }
    }
    let mut gaps = Vec::new();
    let mut from = 0;
    while from < n {
        let kind = hidden[from];
        let to = (from..n).find(|&k| hidden[k] != kind).unwrap_or(n);
        if kind != [false; 2] && (to - from) as f64 * cell >= 1.0 {
            let names = ["left", "right"];
            gaps.push(Gap {
                from_mm: from as f64 * cell,
                to_mm: (to as f64 * cell).min(fit.length_mm),
                hidden_in: (0..2)
                    .filter(|&c| kind[c])
                    .map(|c| names[c].to_string())
                    .collect(),
            });
        }
        from = to;
    }
    gaps
}

/// A tag of one picture.
pub(crate) fn tag_document(camera: usize, tag: &crate::tags::apriltag_ffi::Tag) -> TagDocument {
    TagDocument {
        id: tag.id,
        camera: if camera == 0 { "left" } else { "right" }.into(),
        corners_px: tag.corners_px.map(|c| [c.x, c.y]),
        corners_sd_px: tag.covariances_px2.map(|c| (0.5 * c.trace()).sqrt()),
    }
}
