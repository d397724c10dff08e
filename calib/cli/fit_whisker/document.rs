//! `whisker.toml` as it is written.

use super::dynamics::Dynamics;
use super::stiffness::Stiffness;
use serde::Serialize;
use wcal_core::Provenance;
use wcal_core::observation::RestShape;
use wcal_rod::{RestFit, RestModel};

/// Elastic moduli of NiTi, GPa: only their ratio bears on a held wire's shape, and little.
pub(crate) const YOUNGS_GPA: f64 = 75.0;
pub(crate) const SHEAR_GPA: f64 = 28.2;

/// `whisker.toml`.
#[derive(Debug, Serialize)]
pub(crate) struct WhiskerDocument {
    pub format: &'static str,
    pub whisker: Geometry,
    pub root: Root,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curvature: Option<Curvature>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<Stiffness>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dynamics: Option<Dynamics>,
    pub fit: Fit,
    /// What BIC chose from.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rest_models: Vec<RestModelRow>,
    pub provenance: Provenance,
}

#[derive(Debug, Serialize)]
pub(crate) struct Geometry {
    pub diameter_mm: f64,
    pub length_mm: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub straight_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arc_radius_mm: Option<f64>,
    /// Of a wire of free curvature.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest_shape: Option<Vec<[f64; 3]>>,
    /// Where moments are known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub youngs_gpa: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shear_gpa: Option<f64>,
}

/// The clamp in the base frame: turn as a rotation vector.
#[derive(Debug, Serialize)]
pub(crate) struct Root {
    pub turn_rad: [f64; 3],
    pub offset_mm: [f64; 3],
}

#[derive(Debug, Serialize)]
pub(crate) struct Fit {
    pub model: String,
    pub parameters: Vec<String>,
    pub sd: Vec<f64>,
    pub covariance: Vec<Vec<f64>>,
    /// The part of the covariance that comes from errors common to all shapes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub covariance_shared: Vec<Vec<f64>>,
    pub rms_mm: f64,
    pub rms_over_sd: f64,
    pub warnings: Vec<String>,
    pub shapes: Vec<ShapeRow>,
}

#[derive(Debug, Serialize)]
pub(crate) struct ShapeRow {
    pub name: String,
    pub rms_mm: f64,
    pub largest_mm: f64,
    pub largest_at_mm: f64,
}

/// A free curvature along the wire.
#[derive(Debug, Serialize)]
pub(crate) struct Curvature {
    pub s_mm: Vec<f64>,
    pub bend_y_per_mm: Vec<f64>,
    pub bend_y_sd_per_mm: Vec<f64>,
    pub bend_z_per_mm: Vec<f64>,
    pub bend_z_sd_per_mm: Vec<f64>,
}

/// A model of the rest shape that was tried.
#[derive(Debug, Serialize)]
pub(crate) struct RestModelRow {
    pub model: String,
    pub unknowns: usize,
    pub bic: f64,
}

impl Geometry {
    /// From the fitted shape; the moduli where moments are known.
    pub(crate) fn new(diameter_mm: f64, rest: &RestShape, stiffness: Option<&Stiffness>) -> Self {
        let (mut straight_mm, mut arc_radius_mm, mut rest_shape) = (None, None, None);
        let length = match rest {
            RestShape::StraightArc {
                straight_mm: straight,
                arc_radius_mm: radius,
                length_mm,
            } => {
                (straight_mm, arc_radius_mm) = (Some(*straight), Some(*radius));
                *length_mm
            }
            RestShape::Polyline(points) => {
                rest_shape = Some(points.iter().map(|p| (*p).into()).collect());
                points.windows(2).map(|w| (w[1] - w[0]).norm()).sum()
            }
        };
        let youngs_gpa = stiffness.map(|s| s.youngs_gpa);
        // The ratio is kept: at a pose the moment barely distinguishes the two.
        let shear_gpa = youngs_gpa.map(|e| SHEAR_GPA * e / YOUNGS_GPA);
        Self {
            diameter_mm,
            length_mm: length,
            straight_mm,
            arc_radius_mm,
            rest_shape,
            youngs_gpa,
            shear_gpa,
        }
    }
}

/// Free curvatures of the fit, if that is its model.
pub(crate) fn curvature(fit: &RestFit) -> Option<Curvature> {
    let RestModel::FreeCurvature(n) = fit.model else {
        return None;
    };
    let values = |from: usize| fit.values.iter().skip(from).take(n).copied().collect();
    let sds = |from: usize| (from..from + n).filter_map(|k| fit.sd(k)).collect();
    Some(Curvature {
        s_mm: fit.model.places_mm(&fit.values),
        bend_y_per_mm: values(0),
        bend_y_sd_per_mm: sds(0),
        bend_z_per_mm: values(n),
        bend_z_sd_per_mm: sds(n),
    })
}

/// Models that BIC chose from; a fit that did not converge has no finite one and is omitted.
pub(crate) fn rest_models(fit: &RestFit) -> Vec<RestModelRow> {
    let row = |c: &wcal_rod::fit::ModelScore| RestModelRow {
        model: c.model.name(),
        unknowns: c.model.names().len(),
        bic: c.bic,
    };
    fit.candidates
        .iter()
        .filter(|c| c.bic.is_finite())
        .map(row)
        .collect()
}

/// The fit as it is written.
pub(crate) fn described(fit: &RestFit, warnings: &[String]) -> Fit {
    let rows =
        |c: &nalgebra::DMatrix<f64>| c.row_iter().map(|r| r.iter().copied().collect()).collect();
    Fit {
        model: fit.model.name(),
        parameters: fit.model.names(),
        sd: (0..fit.values.len()).filter_map(|k| fit.sd(k)).collect(),
        covariance: fit.covariance.as_ref().map(rows).unwrap_or_default(),
        covariance_shared: fit.common.as_ref().map(rows).unwrap_or_default(),
        rms_mm: fit.rms_mm,
        rms_over_sd: fit.rms_over_sd,
        warnings: warnings.to_vec(),
        shapes: fit
            .shapes
            .iter()
            .map(|s| ShapeRow {
                name: s.name.clone(),
                rms_mm: s.rms_mm,
                largest_mm: s.largest_mm[0],
                largest_at_mm: s.largest_mm[1],
            })
            .collect(),
    }
}
