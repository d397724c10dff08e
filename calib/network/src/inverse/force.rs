//! Forces whose moments at the root are given: from one entry of the table to the next.
//!
//! Zero of `g(F) = m(s, F) - m` (at the tip with the tilt's sine as third component) by Newton
//! steps with a carried derivative:
//!
//! ```text
//! dF = -J^-1 g(F),  |dF| <= |F| / 2,   J+ = J + (g(F + dF) - g(F) - J dF) dF^T / |dF|^2
//! ```
//!
//! Source: C. G. Broyden, Mathematics of Computation 19 (1965) 577. J is recomputed by central
//! differences where the residual falls slowly.

use super::grid::{InverseGrid, TableEntry};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use std::f64::consts::TAU;
use wcal_rod::{DiscreteRod, PointLoad};

/// Newton steps for one moment.
const NEWTON_STEPS: usize = 24;
/// A step with a carried derivative is accepted where it reduces the residual below this ratio.
const MAX_BROYDEN_RATIO: f64 = 0.6;
/// Tolerance of the moments, N mm.
const TOLERANCE_NMM: f64 = 1e-7;
/// Moment that represents first touch, N mm.
const FIRST_NMM: f64 = 1e-4;

/// Moments at the root of a cell, N mm.
pub(super) fn moment(direction: usize, step: usize, grid: &InverseGrid) -> Vector2<f64> {
    let angle = TAU * direction as f64 / grid.directions as f64;
    let size = if step == 0 {
        FIRST_NMM
    } else {
        grid.max_nmm * step as f64 / grid.steps as f64
    };
    Vector2::new(angle.cos(), angle.sin()) * size
}

/// Touched point and normal under a force (N, frame of the wire at the contact).
fn entry(
    rod: &DiscreteRod,
    arclength_mm: f64,
    force: &Vector3<f64>,
    reachable: bool,
) -> TableEntry {
    let push = rod.under_point_load(arclength_mm, force);
    let normal = push.force_n.normalize();
    // The force on the wire points off the object, whose surface lies one radius against it.
    let point = push.axis_mm - normal * rod.radius_mm;
    (
        [point.x, point.y, point.z, normal.x, normal.y, normal.z].map(|x| x as f32),
        reachable,
    )
}

/// Forces perpendicular to the wire at an arc length, mm, in one direction: moments from none to
/// the largest.
pub(super) fn solve_ray(
    rod: &DiscreteRod,
    arclength_mm: f64,
    direction: usize,
    grid: &InverseGrid,
) -> Vec<(TableEntry, Option<Vector3<f64>>)> {
    let across = |f: Vector2<f64>| Vector3::new(0.0, f.x, f.y);
    // At zero force the normal is the limit of small forces.
    let mut rate = None;
    let mut force = solve_square(
        rod,
        arclength_mm,
        moment(direction, 0, grid),
        Vector2::zeros(),
        &mut rate,
    );
    let mut last = force.unwrap_or(Vector2::new(1e-6, 0.0));
    let mut found = vec![(
        entry(rod, arclength_mm, &across(last), force.is_some()),
        force.map(across),
    )];
    let mut before = Vector2::zeros();
    for m in 1..=grid.steps {
        if let Some(from) = force {
            let to = moment(direction, m, grid);
            // Linear extrapolation from the two entries before.
            let guess = if m > 1 {
                from * 2.0 - before
            } else {
                from * (to.norm() / FIRST_NMM)
            };
            before = if m > 1 { from } else { Vector2::zeros() };
            force = solve_square(rod, arclength_mm, to, guess, &mut rate);
            last = force.unwrap_or(last);
        }
        found.push((
            entry(rod, arclength_mm, &across(last), force.is_some()),
            force.map(across),
        ));
    }
    found
}

/// Transverse force (N) whose moments at the root are these; `None` where none is found near the
/// guess.
fn solve_square(
    rod: &DiscreteRod,
    arclength_mm: f64,
    moment_nmm: Vector2<f64>,
    guess: Vector2<f64>,
    rate: &mut Option<Matrix2<f64>>,
) -> Option<Vector2<f64>> {
    let first = guess == Vector2::zeros();
    let arm = arclength_mm.max(1.0);
    // Of a straight wire M_y = -s F_z and M_z = s F_y.
    let start = if first {
        Vector2::new(moment_nmm.y, -moment_nmm.x) / arm
    } else {
        guess
    };
    let off = |f: &Vector2<f64>| {
        let m = rod
            .under_point_load(arclength_mm, &Vector3::new(0.0, f.x, f.y))
            .moment_nmm;
        Vector2::new(m.y, m.z) - moment_nmm
    };
    // A force that reversed between two entries belongs to another branch.
    broyden(off, start, rate).filter(|force| first || force.dot(&start) > 0.0)
}

/// Zero of a function of a force, N mm. Its derivative `rate` is carried from one solution to the
/// next by Broyden's update (1965, Math. Comp. 19:577) and recomputed by central differences where
/// the residual falls slowly.
fn broyden<const N: usize>(
    off: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
    start: SVector<f64, N>,
    rate: &mut Option<SMatrix<f64, N, N>>,
) -> Option<SVector<f64, N>> {
    let by_differences = |force: &SVector<f64, N>| {
        let h = 1e-4 * force.norm();
        let columns = std::array::from_fn::<_, N, _>(|k| {
            let e = SVector::from_fn(|i, _| if i == k { h } else { 0.0 });
            (off(&(force + e)) - off(&(force - e))) / (2.0 * h)
        });
        SMatrix::from_columns(&columns)
    };
    let (mut force, mut value) = (start, off(&start));
    for _ in 0..NEWTON_STEPS {
        if value.norm() < TOLERANCE_NMM {
            return Some(force);
        }
        let carried = rate.take();
        let slope = carried.unwrap_or_else(|| by_differences(&force));
        let step = -slope.try_inverse()? * value;
        // A step of more than half the force would leave the branch.
        let largest = 0.5 * force.norm();
        let step = if step.norm() > largest {
            step * (largest / step.norm())
        } else {
            step
        };
        let next = off(&(force + step));
        let fast = next.norm() < MAX_BROYDEN_RATIO * value.norm();
        if fast {
            *rate = Some(
                slope + (next - value - slope * step) * step.transpose() / step.norm_squared(),
            );
        }
        // A carried derivative that failed is made anew at the same force.
        if fast || carried.is_none() {
            (force, value) = (force + step, next);
        }
    }
    None
}

/// The tip under forces with the same moments at the root that tilt more and more, from one that is
/// square to the wire.
pub(super) fn solve_tilts(
    rod: &DiscreteRod,
    tip_mm: f64,
    square: Option<Vector3<f64>>,
    moment_nmm: Vector2<f64>,
    grid: &InverseGrid,
) -> Vec<TableEntry> {
    let mut last = square.unwrap_or(Vector3::y() * 1e-6);
    let angle = square.map(|f| tilt_sine(&rod.under_point_load(tip_mm, &f)).asin());
    let (mut force, mut rate) = (square, None);
    (1..=grid.tilts)
        .map(|k| {
            let part = k as f64 / (grid.tilts + 1) as f64;
            force = force.zip(angle).and_then(|(from, angle)| {
                let angle = angle + (std::f64::consts::FRAC_PI_2 - angle) * part;
                solve_tilted(rod, tip_mm, &from, moment_nmm, angle.sin(), &mut rate)
            });
            last = force.unwrap_or(last);
            entry(rod, tip_mm, &last, force.is_some())
        })
        .collect()
}

/// Sine of the angle by which a force tilts toward the root.
fn tilt_sine(push: &PointLoad) -> f64 {
    -push.force_n.normalize().dot(&push.axis_mm.normalize())
}

/// Force at the tip with these moments and this tilt, from one near it.
fn solve_tilted(
    rod: &DiscreteRod,
    tip_mm: f64,
    from: &Vector3<f64>,
    moment_nmm: Vector2<f64>,
    sine: f64,
    rate: &mut Option<Matrix3<f64>>,
) -> Option<Vector3<f64>> {
    let off = |f: &Vector3<f64>| {
        let push = rod.under_point_load(tip_mm, f);
        let m = push.moment_nmm;
        // The tilt times the moment has the unit of the other two equations.
        Vector3::new(
            m.y - moment_nmm.x,
            m.z - moment_nmm.y,
            (tilt_sine(&push) - sine) * moment_nmm.norm(),
        )
    };
    broyden(off, *from, rate)
}
