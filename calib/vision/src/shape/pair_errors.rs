//! Errors of a pair's observations: its own, and those that all pairs share (`shapes.json`,
//! [`PairErrors`]).
//!
//! ```text
//! curve:   dc = C^-1 n - (K C^-1)' x + G q                       n: noise of the pictures, x: base, q: cameras
//! line:    dp(s) = J(s) dc + l a                                  l: uneven light, a: left camera's axis
//! vertex:  dg = R (-hat(v) w + t) + [hat(g) -I] x,                w: turn of the rig tag, t: its shift
//! tag:     w = M^-1 sum_i (g_w - I_wt I_tt^-1 g_t)_i,   t = I_tt^-1 (g_t - I_tw w),   M = sum_i M_i      g: change of a gradient
//! groove:  ds = u' B (dg - dp(s)),   d(position) = dp(s) + u ds,   B = I - C_t W A (groove.rs),   u: the wire's tangent
//! ```
//! With the base held, the pairs are independent of each other: `x` is one error of all of them, of
//! covariance `(I_tags + sum M_i)^-1`. So is the turn of a rig that only shifts: an error of the
//! cameras turns it by the mean over all its pictures, not by one pair's share. Sources: JCGM
//! 102:2011, 6.2; Triggs et al., "Bundle Adjustment - A Modern Synthesis", 2000, section 6.

use crate::rig::RigGroove;
use crate::rigid::updated;
use crate::shape::curve::CurveState;
use crate::shape::curve_fit::{between, in_camera, node};
use crate::shape::describe::places;
use crate::shape::groove::GrooveFound;
use crate::shape::joint::{PairUncertainty, depth_axis};
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use crate::tags::base_pose::{RigPose, RigPoses};
use crate::tags::pose::gradient_by_calibration;
use nalgebra::{
    DMatrix, DVector, DVectorView, Isometry3, Matrix3, Point3, SMatrix, Vector2, Vector3,
};
use rayon::prelude::*;
use wcal_core::covariance::root;
use wcal_core::shapes_document::{ErrorColumn, PairErrors, SharedParameter};

/// Distance of the stations on the centre line, in points of it: 3 mm.
const STATION_POINTS: usize = 6;
/// Errors of one pair below this sd are left out, mm: far below the noise of any picture.
const LEFT_OUT_MM: f64 = 3e-4;
/// Relative standard deviation of the side of a board's squares: stated for etched and printed
/// boards (2 to 10 um in 60 mm).
const BOARD_SCALE_SD: f64 = 1e-4;
/// Places of the errors other than the cameras', in every list after these: board, base, rig tag's
/// place and turn, light, end.
const BOARD: usize = 0;
const BASE: usize = 1;
const TAG_PLACE: usize = 7;
const TAG_TURN: usize = 10;
const LIGHT: usize = 13;
const END: usize = 14;
/// How many they are.
const SETUP: usize = 15;

/// Errors that all pairs of a folder share: the parameters, their covariance, and the derivatives
/// of the rig tags by the cameras.
pub(crate) struct SharedErrors {
    /// Parameters of the cameras.
    cameras: usize,
    pub parameters: Vec<SharedParameter>,
    pub covariance: DMatrix<f64>,
    /// Derivative of each pair's rig tag gradient by the cameras, 6 x parameters.
    pulls: Vec<Option<DMatrix<f64>>>,
    /// Derivative of the shared turn by the cameras, 3 x parameters; none where each pair has its
    /// own.
    turn: Option<DMatrix<f64>>,
}

impl SharedErrors {
    pub(crate) fn new(
        stereo: &StereoCameras,
        uncertain: &[Option<PairUncertainty>],
        rigs: &RigPoses,
    ) -> Self {
        let cameras = stereo.parameters();
        let mut covariance = DMatrix::zeros(cameras + SETUP, cameras + SETUP);
        let mut put = |at: usize, block: &DMatrix<f64>| put(&mut covariance, (at, at), block);
        if let Some(c) = &stereo.covariance {
            put(0, c);
        }
        put(
            cameras + BOARD,
            &DMatrix::from_element(1, 1, BOARD_SCALE_SD.powi(2)),
        );
        if let Some(u) = uncertain.iter().flatten().find(|u| u.base_shared) {
            put(cameras + BASE, &dynamic(&u.base));
        }
        let turn_covariance = rigs.shared_turn.and_then(|total| total.try_inverse());
        if let Some(c) = &turn_covariance {
            put(cameras + TAG_TURN, &dynamic(c));
        }
        // Light and end stand in columns of one standard deviation each.
        put(cameras + LIGHT, &DMatrix::identity(2, 2));
        let pull = |p: &Option<RigPose>| {
            let p = p.as_ref()?;
            Some(gradient_by_calibration(
                stereo,
                &p.observations,
                &p.left_from_tag,
            ))
        };
        let pulls: Vec<Option<DMatrix<f64>>> = rigs.poses.par_iter().map(pull).collect();
        let turn = turn_covariance.map(|c| {
            let mut all = DMatrix::zeros(3, cameras);
            for (p, pull) in rigs.poses.iter().zip(&pulls) {
                if let (Some(b), Some(pull)) = (p.as_ref().and_then(|p| p.blocks()), pull) {
                    // g_w - I_wt I_tt^-1 g_t: the pull of a pair on the turn, its shift eliminated.
                    all += pull.rows(0, 3) - b.cross * b.shift * pull.rows(3, 3);
                }
            }
            dynamic(&c) * all
        });
        Self {
            cameras,
            parameters: parameters(stereo),
            covariance,
            pulls,
            turn,
        }
    }

    /// Covariance of a pair's quantities by their own and shared columns.
    fn covariance_of(&self, own: &DMatrix<f64>, shared: &DMatrix<f64>) -> DMatrix<f64> {
        own * own.transpose() + shared * &self.covariance * shared.transpose()
    }

    /// Columns of all shared errors by those of the cameras: the board's size scales the baseline.
    fn columns(&self, stereo: &StereoCameras, by_cameras: DMatrix<f64>) -> DMatrix<f64> {
        let baseline = stereo.right_from_left.translation.vector;
        // d t = t d(scale): lengths by the cameras have no other scale than the baseline.
        let by_board = by_cameras.columns(self.cameras - 3, 3) * baseline;
        let mut columns = by_cameras.resize_horizontally(self.cameras + SETUP, 0.0);
        columns.set_column(self.cameras + BOARD, &by_board);
        columns
    }
}

fn dynamic<const N: usize>(m: &SMatrix<f64, N, N>) -> DMatrix<f64> {
    DMatrix::from_column_slice(N, N, m.as_slice())
}

fn put(to: &mut DMatrix<f64>, at: (usize, usize), block: &DMatrix<f64>) {
    to.view_mut(at, block.shape()).copy_from(block);
}

fn parameters(stereo: &StereoCameras) -> Vec<SharedParameter> {
    let parameter = |name: String, unit: &str, cause: &str| SharedParameter {
        name,
        unit: unit.to_owned(),
        cause: cause.to_owned(),
    };
    let axes = [
        ("rx", "rad"),
        ("ry", "rad"),
        ("rz", "rad"),
        ("tx", "mm"),
        ("ty", "mm"),
        ("tz", "mm"),
    ];
    let mut all = Vec::new();
    for (side, camera) in ["left", "right"].iter().zip(&stereo.cameras) {
        for name in camera.parameter_names() {
            // Pinhole parameters are in pixels, coefficients of the lens have no unit.
            let unit = if crate::camera::PINHOLE_NAMES.contains(&name) {
                "px"
            } else {
                "1"
            };
            all.push(parameter(format!("{side} {name}"), unit, "cameras"));
        }
    }
    all.extend(
        axes.map(|(axis, unit)| parameter(format!("right_from_left {axis}"), unit, "cameras")),
    );
    all.push(parameter("board-scale".to_owned(), "1", "board-scale"));
    all.extend(axes.map(|(axis, unit)| parameter(format!("base-tag {axis}"), unit, "base-tag")));
    all.extend(["x", "y", "z"].map(|axis| parameter(format!("rig-tag {axis}"), "mm", "rig-tag")));
    all.extend(
        ["rx", "ry", "rz"].map(|axis| parameter(format!("rig-tag {axis}"), "rad", "rig-tag")),
    );
    all.extend(["line", "end"].map(|name| parameter(name.to_owned(), "1", name)));
    all
}

/// How the vertex position that the rig tag states, base frame, follows each error: 3 rows, own and
/// shared columns.
pub(crate) struct VertexErrors {
    /// Noise of this pair's corners of the rig tag.
    own: DMatrix<f64>,
    /// Derivative by the base's correction.
    by_base: DMatrix<f64>,
    shared: DMatrix<f64>,
    /// Covariance of all errors together, mm^2.
    pub covariance: Matrix3<f64>,
}

impl VertexErrors {
    /// None where the tag's corners leave its pose open.
    pub(crate) fn new(
        stereo: &StereoCameras,
        shared: &SharedErrors,
        rigs: &RigPoses,
        pair: usize,
        fit: &PairFit,
        groove: &RigGroove,
        u: &PairUncertainty,
    ) -> Option<Self> {
        let (pose, pull) = (rigs.poses[pair].as_ref()?, shared.pulls[pair].as_ref()?);
        let cameras = shared.cameras;
        let base_from_left = fit.left_from_base.inverse();
        let in_left = pose.left_from_tag * Point3::from(groove.position_in_tag_mm);
        let vertex = (base_from_left * in_left).coords;
        let to_base: Matrix3<f64> = *(base_from_left.rotation * pose.left_from_tag.rotation)
            .to_rotation_matrix()
            .matrix();
        // A turn w of the tag moves the vertex v by w x v = -hat(v) w.
        let lever = -groove.position_in_tag_mm.cross_matrix();
        let (own, by_cameras, by_turn) = match &shared.turn {
            // The shift that minimises chi2 at a turn: t = I_tt^-1 (g_t - I_tw w).
            Some(turn) => {
                let b = pose.blocks()?;
                // A turn moves the vertex by itself, and by the shift that follows the turn.
                let by_turn = dynamic(&(to_base * (lever - b.shift * b.cross.transpose())));
                // At a given turn the shift has the covariance I_tt^-1.
                let own = to_base * root(&b.shift).ok()?;
                let by_cameras = &by_turn * turn + dynamic(&(to_base * b.shift)) * pull.rows(3, 3);
                (dynamic(&own), by_cameras, by_turn)
            }
            None => {
                let covariance = pose.information.try_inverse()?;
                let mut by_pose = DMatrix::zeros(3, 6);
                by_pose.columns_mut(0, 3).copy_from(&(to_base * lever));
                by_pose.columns_mut(3, 3).copy_from(&to_base);
                let by_cameras = &by_pose * (covariance * pull);
                let own = by_pose * dynamic(&root(&covariance).ok()?);
                (own, by_cameras, DMatrix::zeros(3, 3))
            }
        };
        // A base that is turned by w and shifted by d sees the point at p - d - w x p.
        let mut by_base = DMatrix::zeros(3, 6);
        by_base.columns_mut(0, 3).copy_from(&vertex.cross_matrix());
        by_base.columns_mut(3, 3).copy_from(&-Matrix3::identity());
        let by_cameras = by_cameras + &by_base * u.by_calibration.rows(0, 6);
        let mut columns = shared.columns(stereo, by_cameras);
        put(&mut columns, (0, cameras + TAG_TURN), &by_turn);
        if u.base_shared {
            put(&mut columns, (0, cameras + BASE), &by_base);
        }
        // A displaced tag displaces the vertex that it states by the same vector.
        put(&mut columns, (0, cameras + TAG_PLACE), &dynamic(&to_base));
        let mut covariance = shared.covariance_of(&own, &columns);
        if !u.base_shared {
            covariance += &by_base * dynamic(&u.base) * by_base.transpose();
        }
        Some(Self {
            own,
            by_base,
            shared: columns,
            covariance: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        })
    }
}

/// Errors of a pair's centre line, groove and length, and the covariance of groove position and
/// contact arc length by their sum.
pub(crate) fn pair_errors(
    stereo: &StereoCameras,
    shared: &SharedErrors,
    fit: &PairFit,
    u: &PairUncertainty,
    groove: Option<(&GrooveFound, &VertexErrors)>,
) -> (PairErrors, DMatrix<f64>) {
    let stations: Vec<(usize, (f64, usize, f64))> =
        places(fit).enumerate().step_by(STATION_POINTS).collect();
    let jacobian = fit.model.jacobian(&fit.state);
    let at = |node: usize, f: f64| {
        (jacobian.columns(3 * node, 3) * (1.0 - f) + jacobian.columns(3 * node + 3, 3) * f)
            .transpose()
    };
    // Rows: stations, foot point of the vertex on the wire, vertex by the tag, length.
    let m = 3 * stations.len();
    let mut by_curve = DMatrix::zeros(m + 3, fit.model.parameters());
    for (row, (_, (_, node, f))) in stations.iter().enumerate() {
        by_curve.rows_mut(3 * row, 3).copy_from(&at(*node, *f));
    }
    if let Some((found, _)) = groove {
        by_curve
            .rows_mut(m, 3)
            .copy_from(&at(found.at.0, found.at.1));
    }
    let own = own_columns(fit, u, &by_curve, groove.map(|g| g.1));
    let all = shared_columns(stereo, shared, fit, u, &by_curve, groove.map(|g| g.1));
    let observed = |columns: &DMatrix<f64>| observations(columns, m, groove.map(|g| g.0));
    let (own, all) = (observed(&own), observed(&all));
    let covariance =
        shared.covariance_of(&own.rows(m, 4).into_owned(), &all.rows(m, 4).into_owned());
    let (kept, floor_mm) = principal(own);
    let column = |c: DVectorView<f64>, digits: fn(f64) -> f64| ErrorColumn {
        centreline_mm: (0..stations.len())
            .map(|k| std::array::from_fn(|d| digits(c[3 * k + d])))
            .collect(),
        groove_mm: std::array::from_fn(|d| digits(c[m + d])),
        contact_arclength_mm: digits(c[m + 3]),
        length_mm: digits(c[m + 4]),
    };
    let document = PairErrors {
        stations: stations.iter().map(|s| s.0).collect(),
        stations_mm: stations.iter().map(|s| nanometres(s.1.0)).collect(),
        own: kept
            .iter()
            .map(|c| column(c.as_view(), nanometres))
            .collect(),
        floor_mm,
        shared: all.column_iter().map(|c| column(c, significant)).collect(),
    };
    (document, covariance)
}

/// Own errors: curve with base and cameras held, the base where it is this pair's own, corners of
/// the rig tag, the end.
fn own_columns(
    fit: &PairFit,
    u: &PairUncertainty,
    by_curve: &DMatrix<f64>,
    vertex: Option<&VertexErrors>,
) -> DMatrix<f64> {
    let rows = by_curve.nrows();
    let base = match u.base_shared {
        true => None,
        false => root(&u.base).ok(),
    };
    let base = base.as_ref().map_or(DMatrix::zeros(6, 0), dynamic);
    let of_curve = by_curve * &u.own;
    let (base_at, tag_at) = (of_curve.ncols(), of_curve.ncols() + base.ncols());
    let end_at = tag_at + vertex.map_or(0, |v| v.own.ncols());
    let mut columns = DMatrix::zeros(rows + 4, end_at + 1);
    put(&mut columns, (0, 0), &of_curve);
    put(&mut columns, (0, base_at), &(by_curve * &u.by_base * &base));
    if let Some(v) = vertex {
        put(&mut columns, (rows, base_at), &(&v.by_base * base));
        put(&mut columns, (rows, tag_at), &v.own);
    }
    // What all pairs share of the end's error stands in the shared columns.
    let end_mm2 = fit.length_sd_mm.powi(2) - fit.length_shared_mm.powi(2);
    columns[(rows + 3, end_at)] = end_mm2.max(0.0).sqrt();
    columns
}

/// Derivatives by the shared parameters.
fn shared_columns(
    stereo: &StereoCameras,
    shared: &SharedErrors,
    fit: &PairFit,
    u: &PairUncertainty,
    by_curve: &DMatrix<f64>,
    vertex: Option<&VertexErrors>,
) -> DMatrix<f64> {
    let (cameras, rows) = (shared.cameras, by_curve.nrows());
    let by_cameras = by_curve * u.by_calibration.rows(6, fit.model.parameters());
    let mut columns = shared.columns(stereo, by_cameras);
    if u.base_shared {
        put(&mut columns, (0, cameras + BASE), &(by_curve * &u.by_base));
    }
    // A line that is off in one picture moves the whole wire in depth.
    let depth = depth_axis(fit) * u.shared_mm;
    for row in (0..rows).step_by(3) {
        columns
            .view_mut((row, cameras + LIGHT), (3, 1))
            .copy_from(&depth);
    }
    let by_cameras = DMatrix::from_fn(1, cameras, |_, k| {
        let h = stereo.difference_step(k);
        let error = DVector::from_fn(cameras, |i, _| if i == k { h } else { 0.0 });
        length_change_mm(stereo, fit, u, &error) / h
    });
    let mut length = shared.columns(stereo, by_cameras);
    length[cameras + END] = fit.length_shared_mm;
    let mut columns = columns.resize_vertically(rows + 4, 0.0);
    if let Some(v) = vertex {
        put(&mut columns, (rows, 0), &v.shared);
    }
    put(&mut columns, (rows + 3, 0), &length);
    columns
}

/// From (stations, foot, vertex, length) to (stations, groove position, contact arc length,
/// length).
fn observations(columns: &DMatrix<f64>, m: usize, groove: Option<&GrooveFound>) -> DMatrix<f64> {
    let count = columns.ncols();
    let mut out = DMatrix::zeros(m + 5, count);
    out.rows_mut(0, m).copy_from(&columns.rows(0, m));
    out.row_mut(m + 4).copy_from(&columns.row(m + 6));
    let Some(found) = groove else { return out };
    for k in 0..count {
        let [foot, vertex] = [m, m + 3].map(|row| columns.fixed_view::<3, 1>(row, k));
        // The tag says where along the wire, the wire itself where across.
        let along = found.tangent.dot(&(found.follow * (vertex - foot)));
        out.view_mut((m, k), (3, 1))
            .copy_from(&(foot + found.tangent * along));
        out[(m + 3, k)] = along;
    }
    out
}

/// The same covariance by the fewest independent columns that leave out less than [`LEFT_OUT_MM`]
/// anywhere, and the part left out.
fn principal(columns: DMatrix<f64>) -> (Vec<DVector<f64>>, f64) {
    // Principal axes: most of the variance in the fewest columns.
    let parts = (&columns * columns.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..columns.nrows()).collect();
    order.sort_by(|a, b| parts.eigenvalues[*b].total_cmp(&parts.eigenvalues[*a]));
    let scaled = |k: usize| parts.eigenvectors.column(k) * parts.eigenvalues[k].max(0.0).sqrt();
    let mut left = DVector::from_fn(columns.nrows(), |k, _| columns.row(k).norm_squared());
    let mut kept = Vec::new();
    for k in order {
        let largest = left.max().max(0.0).sqrt();
        if largest <= LEFT_OUT_MM {
            return (kept, largest);
        }
        let column: DVector<f64> = scaled(k);
        left -= column.component_mul(&column);
        kept.push(column);
    }
    (kept, 0.0)
}

/// To a nanometre: an error of an error.
fn nanometres(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}

/// Eight digits: parameters of cameras are strongly correlated, and their parts cancel.
fn significant(x: f64) -> f64 {
    format!("{x:.7e}").parse().unwrap_or(x)
}

/// The pictures show the tip where they do: with other cameras that is another arc length.
fn length_change_mm(
    stereo: &StereoCameras,
    fit: &PairFit,
    u: &PairUncertainty,
    error: &DVector<f64>,
) -> f64 {
    let other = (0..stereo.parameters()).fold(stereo.clone(), |s, k| s.moved(k, error[k]));
    let step = &u.by_calibration * error;
    let correction = updated(
        &Isometry3::identity(),
        &step.fixed_rows::<6>(0).into_owned(),
    );
    let (pose, mut state) = (fit.left_from_base * correction, fit.state.clone());
    state.add(&step.as_slice()[6..]);
    let end = |state: &CurveState, arc_mm: f64| {
        let at = node(arc_mm, fit.model.step_mm, fit.model.nodes);
        between(&fit.model.shape(state).points, at)
    };
    let seen = |s: &StereoCameras, pose: &Isometry3<f64>, p: &Vector3<f64>, camera: usize| {
        in_camera(s, pose, camera, p).map(|(px, _, _)| px)
    };
    let tip = end(&fit.state, fit.length_mm);
    let before = end(&fit.state, fit.length_mm - fit.model.step_mm);
    let moved = end(&state, fit.length_mm);
    let changes: Vec<f64> = (0..2)
        .filter_map(|camera| {
            let at = seen(stereo, &fit.left_from_base, &tip, camera)?;
            let along: Vector2<f64> = at - seen(stereo, &fit.left_from_base, &before, camera)?;
            let off: Vector2<f64> = seen(&other, &pose, &moved, camera)? - at;
            // The end stays where it is seen: a curve that moves on along itself ends earlier.
            Some(-off.dot(&along) / along.norm_squared() * fit.model.step_mm)
        })
        .collect();
    changes.iter().sum::<f64>() / changes.len().max(1) as f64
}
