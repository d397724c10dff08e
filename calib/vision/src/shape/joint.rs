//! The base's correction that all pairs of a folder agree on, and the covariance of each pair's
//! curve: the pictures' noise, the base that they share, and the calibration's own uncertainty.
//!
//! ```text
//! pair i: [B_i  K_i] [x]   [g_i]     M_i = B_i - K_i C_i^-1 K_i^T,  h_i = g_i - K_i C_i^-1 f_i      x: base,  c_i: curve
//!         [K_i' C_i] [c] = [f_i]     (I_tags + sum M_i) x = sum h_i
//! covariance_i = N_i^-1 + G_i C_cal G_i^T,   G_i = N_i^-1 d(gradient) / d(calibration)
//! ```
//! N_i: pair i's normal matrix with the information of tags and other pairs on the base. G_i is the
//! implicit function theorem at the minimum: the calibration is no parameter of the fit but moves
//! its solution. Sources: JCGM 102:2011, 6.2 (propagation through a fitted model); Triggs et al.,
//! "Bundle Adjustment - A Modern Synthesis", 2000, section 6 (elimination).

use crate::rigid::updated;
use crate::shape::curve_fit::{Prior, between, in_camera, node, stepped, with_prior};
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use crate::tags::base_pose::FolderBase;
use crate::tags::pose::gradient_by_calibration;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Root offsets where the base's tags and the wire agree on the frame: the clamp holds to a few
/// micrometres (mm, rad).
pub(crate) const ROOT_CLAMPED: [f64; 2] = [0.003, 1e-4];
/// Shift of a whole line that pieces share, in widths of the wire: uneven light across it and the
/// camera's tone curve on unequal sides.
const LINE_FLOOR_WIDTHS: f64 = 0.004;
/// Width in blurs above which a picture resolves the light across the wire, and that shift grows
/// with the width.
const RESOLVED_BLURS: f64 = 3.5;

/// The base correction shared by the folder.
pub(crate) struct Joint {
    /// Base correction that all agree on.
    step: Vector6<f64>,
    /// Disagreement of wires and tags about the base, chi2 with 6 degrees of freedom.
    pub disagreement: f64,
}

impl Joint {
    pub(crate) fn new(
        base: &FolderBase,
        fits: &[Result<PairFit, String>],
        root_sd: [f64; 2],
    ) -> Self {
        let mut information = base.pose.information;
        let mut rhs = Vector6::zeros();
        for (k, fit) in fits.iter().enumerate() {
            if let Ok(fit) = fit
                && !base.moved.contains(&k)
                && let Some(part) = SchurComplement::new(fit, root_sd)
            {
                information += part.information;
                rhs += part.rhs;
            }
        }
        // What tags and wires together say of the base.
        let step = information
            .cholesky()
            .map_or_else(Vector6::zeros, |c| c.solve(&rhs));
        let disagreement = (step.transpose() * base.pose.information * step)[0];
        Self { step, disagreement }
    }

    /// Moves a pair to the joint base and lets its curve follow.
    pub(crate) fn apply(&self, stereo: &StereoCameras, fit: &mut PairFit, root_sd: [f64; 2]) {
        fit.left_from_base *= updated(&Isometry3::identity(), &self.step);
        let prior = held(root_sd, fit.smoothing);
        for _ in 0..3 {
            fit.system = fit.linearised(stereo);
            let Some(next) = stepped(&fit.system, &prior, &fit.state, &fit.model) else {
                return;
            };
            fit.state = next;
        }
        fit.system = fit.linearised(stereo);
    }
}

/// Covariance of base correction and curve parameters, and their derivative by the calibration.
pub(crate) struct PairUncertainty {
    /// (6 + parameters) square.
    pub covariance: DMatrix<f64>,
    /// Rows as above, a column for each parameter of the cameras.
    pub by_calibration: DMatrix<f64>,
    /// Error in depth that all places of the wire share and that the pictures' scatter does not
    /// include, mm.
    pub shared_mm: f64,
    /// Columns: independent errors of the curve's parameters by the pair's own pictures, base and
    /// cameras held; one standard deviation each.
    pub own: DMatrix<f64>,
    /// Derivative of the curve's parameters by the base's correction.
    pub by_base: DMatrix<f64>,
    /// Covariance of the base's correction by the pictures' noise and the clamp.
    pub base: Matrix6<f64>,
    /// Whether all pairs share that base; a pair whose base moved has its own.
    pub base_shared: bool,
}

/// The left camera's axis in the base frame.
pub(crate) fn depth_axis(fit: &PairFit) -> Vector3<f64> {
    fit.left_from_base.inverse().rotation * Vector3::z()
}

/// Uncertainty of every fitted pair.
pub(crate) fn uncertainties(
    stereo: &StereoCameras,
    base: &FolderBase,
    fits: &[Result<PairFit, String>],
    root_sd: [f64; 2],
) -> Vec<Option<PairUncertainty>> {
    type Part = (SchurComplement, DMatrix<f64>, DMatrix<f64>);
    let parts: Vec<Option<Part>> = fits
        .par_iter()
        .map(|fit| {
            let fit = fit.as_ref().ok()?;
            let part = SchurComplement::new(fit, root_sd)?;
            let full = sensitivity(stereo, fit);
            let reduced = part.eliminate(&full);
            Some((part, full, reduced))
        })
        .collect();
    let tags = gradient_by_calibration(stereo, &base.observations, &base.pose.left_from_body);
    // Normal equations of the base: tags plus the Schur complement of every pair whose base did not
    // move.
    let mut information = base.pose.information;
    let mut pull = tags.clone();
    for (k, part) in parts.iter().enumerate() {
        if let Some((part, _, reduced)) = part
            && !base.moved.contains(&k)
        {
            information += part.information;
            pull += reduced;
        }
    }
    fits.par_iter()
        .enumerate()
        .map(|(k, fit)| {
            let fit = fit.as_ref().ok()?;
            let (part, full, reduced) = parts[k].as_ref()?;
            // Information of the other pairs on the base. A base at another place has its own tags
            // only, seen by the same cameras.
            let base_shared = !base.moved.contains(&k);
            let (others, their_pull) = if base_shared {
                (information - part.information, &pull - reduced)
            } else {
                (fit.base_information, tags.clone())
            };
            let (covariance, by_calibration) =
                covariance(stereo, fit, root_sd, &others, &their_pull, full.clone())?;
            Some(PairUncertainty {
                covariance,
                by_calibration,
                shared_mm: line_shift_mm(stereo, fit),
                own: part.own.clone(),
                // dc / dx = -C^-1 K': the curve gives way to a correction of the base.
                by_base: -part.carried.transpose(),
                base: (others + part.information).try_inverse()? + clamp_covariance(root_sd),
                base_shared,
            })
        })
        .collect()
}

/// Covariance of base correction and curve, and their derivative by the calibration.
fn covariance(
    stereo: &StereoCameras,
    fit: &PairFit,
    root_sd: [f64; 2],
    others: &Matrix6<f64>,
    their_pull: &DMatrix<f64>,
    mut by_calibration: DMatrix<f64>,
) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    let prior = Prior {
        base: *others,
        ..held(root_sd, fit.smoothing)
    };
    let (full, _) = with_prior(&fit.system, &prior, &fit.state, &fit.model);
    let mut pull = by_calibration.rows_mut(0, 6);
    pull += their_pull;
    let mut covariance = full.cholesky()?.inverse();
    // Implicit function theorem: how the minimum follows the cameras.
    let response = &covariance * by_calibration;
    if let Some(c) = &stereo.covariance {
        covariance += &response * c * response.transpose();
    }
    Some((covariance, response))
}

/// Covariance of the base by the clamp's own offsets. All pairs have the same clamp, so that its
/// error does not average out over them.
fn clamp_covariance(root_sd: [f64; 2]) -> Matrix6<f64> {
    if root_sd != ROOT_CLAMPED {
        // With a free root the frame is that of the tags alone.
        return Matrix6::zeros();
    }
    // A clamped root has no offset along the wire's axis x and no turn about it.
    let (shift, turn) = (root_sd[0].powi(2), root_sd[1].powi(2));
    Matrix6::from_diagonal(&Vector6::new(0.0, turn, turn, 0.0, shift, shift))
}

/// Shift in depth of a whole line by uneven light across it, mm.
fn line_shift_mm(stereo: &StereoCameras, fit: &PairFit) -> f64 {
    // A shift of one picture's line by a pixel moves the wire in depth by z^2 / (f b), and a width
    // is f d / z pixels.
    let depth_mm = fit.left_from_base.translation.vector.norm();
    let baseline_mm = stereo.right_from_left.translation.vector.norm();
    let by_width_mm = fit.diameter_mm * depth_mm / baseline_mm;
    let width_px = fit.diameter_mm * stereo.cameras[0].focal_px[0] / depth_mm;
    let blur_px = 0.5 * (fit.appearances[0].blur_px + fit.appearances[1].blur_px);
    let resolved = (width_px / (RESOLVED_BLURS * blur_px)).max(1.0);
    LINE_FLOOR_WIDTHS * resolved * by_width_mm
}

fn held(root_sd: [f64; 2], smoothing: f64) -> Prior {
    Prior {
        base: Matrix6::zeros(),
        root_sd,
        smoothing,
    }
}

/// A pair's information on the base with the curve eliminated.
struct SchurComplement {
    information: Matrix6<f64>,
    rhs: Vector6<f64>,
    /// K C^-1, 6 x parameters: coupling of the curve into the base.
    carried: DMatrix<f64>,
    /// L^-T of C = L L^T: independent errors of the curve's parameters with the base held.
    own: DMatrix<f64>,
}

impl SchurComplement {
    fn new(fit: &PairFit, root_sd: [f64; 2]) -> Option<Self> {
        let (h, g) = with_prior(
            &fit.system,
            &held(root_sd, fit.smoothing),
            &fit.state,
            &fit.model,
        );
        let n = h.nrows() - 6;
        let cross = h.view((0, 6), (6, n)).into_owned();
        let curve = h.view((6, 6), (n, n)).into_owned().cholesky()?;
        // Elimination of the curve: what is left is on the base alone.
        let carried = curve.solve(&cross.transpose()).transpose();
        let own = curve.l().transpose().try_inverse()?;
        let information = h.view((0, 0), (6, 6)) - &carried * cross.transpose();
        let rhs = g.rows(0, 6) - &carried * g.rows(6, n);
        Some(Self {
            information: information.fixed_view::<6, 6>(0, 0).into_owned(),
            rhs: rhs.fixed_rows::<6>(0).into_owned(),
            carried,
            own,
        })
    }

    /// The base's rows of right-hand sides with the curve eliminated.
    fn eliminate(&self, full: &DMatrix<f64>) -> DMatrix<f64> {
        full.rows(0, 6) - &self.carried * full.rows(6, full.nrows() - 6)
    }
}

/// Derivative of the observations' right-hand side by the calibration.
fn sensitivity(stereo: &StereoCameras, fit: &PairFit) -> DMatrix<f64> {
    let points = fit.model.shape(&fit.state).points;
    // Observed minus predicted along the normal, px.
    let residuals = |s: &StereoCameras| {
        let each = fit.observations.iter().map(|o| {
            let p = between(&points, node(o.arc_mm, fit.model.step_mm, points.len()));
            in_camera(s, &fit.left_from_base, o.camera, &p)
                .map_or(0.0, |(px, _, _)| o.normal.dot(&(o.observed_px - px)))
        });
        DVector::from_iterator(fit.observations.len(), each)
    };
    let now = residuals(stereo);
    let mut out = DMatrix::zeros(fit.system.data.nrows(), stereo.parameters());
    for k in 0..stereo.parameters() {
        // d(J' W r) / dq = J' W dr/dq: times the small residuals, changes of J and W are left out.
        let h = stereo.difference_step(k);
        let change = (residuals(&stereo.moved(k, h)) - &now) / h;
        out.set_column(k, &(&fit.system.rows_weighted * change));
    }
    out
}

/// Radius of the circle with 95 % of a plane Gaussian with these variances, over sqrt(chi2_2(0.95))
/// (F. E. Satterthwaite, Biometrics Bulletin 2 (1946) 110: the sum of squares as a scaled
/// chi-squared).
pub(crate) fn planar_sd(a: f64, b: f64) -> f64 {
    let mean = a + b;
    if !(mean > 0.0) || !mean.is_finite() {
        return f64::NAN;
    }
    let variance = 2.0 * (a * a + b * b);
    // Satterthwaite's degrees of freedom: mean and variance of the sum agree.
    let degrees = 2.0 * mean * mean / variance;
    let quantile = ChiSquared::new(degrees).map_or(5.991, |c| c.inverse_cdf(0.95));
    (variance / (2.0 * mean) * quantile / 5.991_464_547).sqrt()
}

/// Position covariance of a node, base frame.
pub(crate) fn node_covariance(
    fit: &PairFit,
    jacobian: &DMatrix<f64>,
    node: usize,
    u: &PairUncertainty,
) -> Matrix3<f64> {
    let n = fit.model.parameters();
    let j = jacobian.columns(3 * node, 3);
    let c = u.covariance.view((6, 6), (n, n));
    let m = j.tr_mul(&(c * j)).fixed_view::<3, 3>(0, 0).into_owned();
    m + Matrix3::identity() * u.shared_mm.powi(2)
}
