//! One contact: what a wire shows when a force acts on it at one place.
//!
//! ```text
//! x = (q, f, phi, a, c)         place along the wire, normal force, its azimuth, friction along the wire and across
//! s = min(q, L)                 arc length of the contact (mm);  tilt = max(q - L, 0) / 10 mm: how far the normal leans toward the root at the tip
//! n = n0 cos(tilt) - t sin(tilt),  n0 = e2 cos(phi) + e3 sin(phi),  b = t x n0,  u = t cos(tilt) + n0 sin(tilt)
//! F = f (n + a u + c b),        P = r(s; F) - radius n,        m = r(s; F) x F
//! ```
//!
//! t, e2, e3: frame of the wire at the contact. The equilibrium is explicit from the contact inward
//! (`DiscreteRod::under_point_load`). The links' frames jump at the joints; within a link the frame
//! is turned by the wire's rest curvature, which is all that it has where no moment acts.

use super::friction::FrictionPrior;
use crate::calibrated_wire::CalibratedWire;
use nalgebra::{Matrix2, Rotation3, SMatrix, SVector, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};
use wcal_core::observation::MomentAxes;
use wcal_rod::{DiscreteRod, Rod, RodError};

/// Unknowns of a contact.
pub(super) const STATE: usize = 5;
/// See the module: (q, f, phi, a, c).
pub(super) type State = SVector<f64, STATE>;
/// Numbers of a [`ContactQuantities`].
const SHOWN: usize = 18;
/// Derivative of a [`ContactQuantities`] by its state.
pub(super) type Rates = SMatrix<f64, SHOWN, STATE>;

/// Tilt of the normal at the tip for one radian, mm of q.
pub(super) const TIP_MM: f64 = 10.0;
/// Links of the wire.
const LINKS: usize = 60;
/// Steps of the differences.
const STEPS: [f64; STATE] = [1e-3, 1e-4, 1e-4, 1e-3, 1e-3];
/// Newton steps for the force that gives a moment, and its tolerance, N mm.
const FORCE_STEPS: usize = 12;
const TOLERANCE_NMM: f64 = 1e-7;
/// A fold is looked for where the moment grows with less than this power of the force, in steps by
/// this factor.
const FOLD_NEAR: f64 = 0.6;
const FOLD_STEP: f64 = 1.12;
const FOLD_STEPS: i32 = 14;

/// What a contact shows, base frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct ContactQuantities(pub SVector<f64, SHOWN>);

impl ContactQuantities {
    fn vector(&self, at: usize) -> Vector3<f64> {
        self.0.fixed_rows::<3>(at).into()
    }

    /// Moments, N mm.
    pub(crate) fn moment_nmm(&self) -> Vector2<f64> {
        self.0.fixed_rows::<2>(0).into()
    }

    /// Point of the object, mm.
    pub(crate) fn point_mm(&self) -> Vector3<f64> {
        self.vector(2)
    }

    /// Outward normal of the object.
    pub(crate) fn normal(&self) -> Vector3<f64> {
        self.vector(5)
    }

    /// Direction of friction along the wire.
    pub(crate) fn along(&self) -> Vector3<f64> {
        self.vector(8)
    }

    /// Direction of friction across.
    pub(crate) fn across(&self) -> Vector3<f64> {
        self.vector(11)
    }

    /// Direction of the wire.
    pub(crate) fn tangent(&self) -> Vector3<f64> {
        self.vector(14)
    }

    /// Arc length, mm.
    pub(crate) fn arclength_mm(&self) -> f64 {
        self.0[17]
    }

    /// Seen from an object that the base sees at `turn p + moved`.
    pub(super) fn on_object(&self, turn: &Rotation3<f64>, moved_mm: &Vector3<f64>) -> Self {
        let mut seen = *self;
        let back = turn.inverse();
        seen.0
            .fixed_rows_mut::<3>(2)
            .copy_from(&(back * (self.point_mm() - moved_mm)));
        for at in [5, 8, 11, 14] {
            seen.0
                .fixed_rows_mut::<3>(at)
                .copy_from(&(back * self.vector(at)));
        }
        seen
    }
}

/// A wire that is touched at one place.
#[derive(Debug, Clone)]
pub struct TouchedWire {
    rod: DiscreteRod,
    axes: MomentAxes,
    /// Length, mm.
    pub length_mm: f64,
    /// Bending stiffness, N mm^2.
    pub ei_nmm2: f64,
    /// What is known of its friction on what touches it.
    pub friction: FrictionPrior,
    /// Turn of each joint at rest, rad.
    rest: Vec<Vector3<f64>>,
}

impl CalibratedWire {
    /// As one that is touched at one place, whatever touches it.
    ///
    /// # Errors
    /// Where it cannot be bent.
    pub fn touched(&self) -> Result<TouchedWire, RodError> {
        Ok(TouchedWire {
            friction: self.friction,
            ..TouchedWire::new(&self.rod, self.diameter_mm, &MomentAxes::default())?
        })
    }
}

impl TouchedWire {
    /// Of a rod with its accepted mechanics, its weight aside.
    ///
    /// # Errors
    /// Where the wire has no stiffness.
    pub fn new(rod: &Rod, diameter_mm: f64, axes: &MomentAxes) -> Result<Self, RodError> {
        let links = DiscreteRod::of_rod(rod, diameter_mm, LINKS)?;
        let rest = links.joints().iter().map(|j| j.0).collect();
        let (length_mm, ei_nmm2) = (rod.shape.length_mm, rod.section.ei_nmm2);
        Ok(Self {
            rest,
            axes: axes.clone(),
            friction: FrictionPrior::default(),
            length_mm,
            ei_nmm2,
            rod: links,
        })
    }

    /// What a contact shows.
    pub(super) fn show(&self, x: &State) -> ContactQuantities {
        let [q, f, phi, a, c] = [x[0], x[1], x[2], x[3], x[4]];
        let s = q.clamp(0.0, self.length_mm);
        let (sin_tilt, cos_tilt) = ((q - self.length_mm).max(0.0) / TIP_MM).sin_cos();
        let (sin, cos) = phi.sin_cos();
        let n0 = Vector3::new(0.0, cos, sin);
        let n = n0 * cos_tilt - Vector3::x() * sin_tilt;
        let u = Vector3::x() * cos_tilt + n0 * sin_tilt;
        let b = Vector3::new(0.0, -sin, cos);
        // From the smooth frame at the contact into that of the link.
        let link = s / self.rod.link_mm;
        let j = (link as usize).min(self.rod.links() - 1);
        let off = link - j as f64 - 0.5;
        // The turn of a joint at rest is spread evenly over the half links at its two sides.
        let joint = if off < 0.0 {
            j
        } else {
            (j + 1).min(self.rod.links() - 1)
        };
        let smooth = Rotation3::from_scaled_axis(self.rest[joint] * off);
        // Beyond the contact the wire is free: its equilibrium follows from the force inward.
        let load = self
            .rod
            .under_point_load(s, &(smooth * ((n + u * a + b * c) * f)));
        let frame = load.frame * smooth.matrix();
        let m = self.axes.components_nmm(&load.moment_nmm);
        let mut y = SVector::<f64, SHOWN>::zeros();
        y[0] = m[0];
        y[1] = m[1];
        let n = frame * n;
        // The object pushes along the normal: its surface lies one radius against it.
        let point = load.axis_mm - n * self.rod.radius_mm;
        for (at, v) in [
            (2, point),
            (5, n),
            (8, frame * u),
            (11, frame * b),
            (14, frame.column(0).into()),
        ] {
            y.fixed_rows_mut::<3>(at).copy_from(&v);
        }
        y[17] = s;
        ContactQuantities(y)
    }

    /// The same with its derivative, by forward differences.
    pub(super) fn rates(&self, x: &State) -> (ContactQuantities, Rates) {
        let y = self.show(x);
        let mut rates = Rates::zeros();
        for (k, step) in STEPS.into_iter().enumerate() {
            // The force's own scale: moments of a tenth of a millinewton millimetre.
            let h = if k == 1 {
                step * x[1].abs().max(1e-3)
            } else {
                step
            };
            let mut other = *x;
            other[k] += h;
            rates.set_column(k, &((self.show(&other).0 - y.0) / h));
        }
        (y, rates)
    }

    /// Axis of the wire at the contact, mm.
    pub(super) fn axis_mm(&self, y: &ContactQuantities) -> Vector3<f64> {
        y.point_mm() + y.normal() * self.rod.radius_mm
    }

    /// Normal force and azimuth that give a moment at a place along the wire, from a guess; none
    /// where none is found.
    pub(super) fn frictionless(
        &self,
        q: f64,
        moment_nmm: &Vector2<f64>,
        guess: Option<State>,
    ) -> Option<State> {
        let mut x = guess.unwrap_or_else(|| self.light(q, moment_nmm));
        x[0] = q;
        for _ in 0..FORCE_STEPS {
            let y = self.show(&x).moment_nmm();
            let off = y - moment_nmm;
            if off.norm() < TOLERANCE_NMM.max(1e-5 * moment_nmm.norm()) {
                // An object only pushes: a negative force is no contact.
                return (x[1] > 0.0).then_some(x);
            }
            let by = |k: usize, h: f64| {
                let mut other = x;
                other[k] += h;
                (self.show(&other).moment_nmm() - y) / h
            };
            // Newton's step in force and azimuth, by forward differences.
            let j = Matrix2::from_columns(&[by(1, 1e-4 * x[1].abs().max(1e-4)), by(2, 1e-5)]);
            let step = j.try_inverse()? * off;
            // A step is cut to half of the force and half a radian: beyond lies another branch.
            let cut = (step[0].abs() / (0.5 * x[1].abs().max(1e-4)))
                .max(step[1].abs() / 0.5)
                .max(1.0);
            x[1] -= step[0] / cut;
            x[2] -= step[1] / cut;
        }
        None
    }

    /// The second contact with the same moment at the same place, past the fold where more force
    /// gives no more moment as the wire turns away; none where the fold is far.
    pub(super) fn past_fold(&self, low: &State, moment_nmm: &Vector2<f64>) -> Option<State> {
        // Past the fold the wire turns away: more force gives no more moment.
        let size = |x: &State| self.show(x).moment_nmm().norm();
        let scaled = |by: f64| {
            let mut x = *low;
            x[1] *= by;
            x
        };
        let m = moment_nmm.norm();
        // With m ~ f^p one percent of force gives p percent of moment: at a fold p is 0.
        if size(&scaled(1.01)) > m * (1.0 + 0.01 * FOLD_NEAR) {
            return None;
        }
        // The first larger force with less moment lies past the fold.
        let from = (1..FOLD_STEPS)
            .map(|k| FOLD_STEP.powi(k))
            .find(|by| size(&scaled(*by)) < m)?;
        let found = self.frictionless(low[0], moment_nmm, Some(scaled(from)))?;
        // Nearly the same force is the first contact again.
        (found[1] > 1.02 * low[1]).then_some(found)
    }

    /// The light force of the free wire that gives a moment: with the moments of a force of 1 N
    /// along e2, e3 and -t (at the tip), `f (M e(phi) - z) = m`, so that `|a + f b| = f`,
    /// `a = M^-1 m`, `b = M^-1 z`.
    fn light(&self, q: f64, moment_nmm: &Vector2<f64>) -> State {
        const LIGHT_N: f64 = 1e-6;
        let by = |phi: f64| {
            self.show(&State::from([q, LIGHT_N, phi, 0.0, 0.0]))
                .moment_nmm()
                / LIGHT_N
        };
        // What turns with the azimuth changes its sign over half a turn, the tilt's part does not.
        let (here, opposite) = (by(0.0), by(PI));
        let across = Matrix2::from_columns(&[
            (here - opposite) / 2.0,
            (by(FRAC_PI_2) - by(-FRAC_PI_2)) / 2.0,
        ]);
        let inverse = across.try_inverse().unwrap_or_else(Matrix2::zeros);
        let (a, b) = (inverse * moment_nmm, inverse * (here + opposite) / -2.0);
        // (1 - b^2) f^2 - 2 a.b f - a^2 = 0: the least positive root.
        let (square, half) = (1.0 - b.norm_squared(), a.dot(&b));
        let root = (half * half + square * a.norm_squared()).max(0.0).sqrt();
        let roots = [(half + root) / square, (half - root) / square];
        let f = roots
            .into_iter()
            .filter(|f| *f > 0.0 && f.is_finite())
            .fold(f64::INFINITY, f64::min);
        let f = if f.is_finite() { f } else { a.norm() }.max(1e-6);
        let along = a + b * f;
        State::from([q, f, along.y.atan2(along.x), 0.0, 0.0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::known_motion::{Friction, MomentField};
    use wcal_core::observation::WhiskerSpec;
    use wcal_rod::Softening;

    fn wire() -> TouchedWire {
        let rod = Rod::new(&WhiskerSpec::nominal(), 0.25).unwrap();
        TouchedWire::new(
            &rod,
            WhiskerSpec::nominal().diameter_mm,
            &MomentAxes::default(),
        )
        .unwrap()
    }

    /// A point that holds the accepted wire is found again from its moments, and by the declared
    /// wire it is not.
    #[test]
    fn a_wire_that_verify_accepted_is_the_one_that_is_bent() {
        let declared = Rod::new(&WhiskerSpec::nominal(), 0.25).unwrap();
        let mut accepted = declared.clone();
        accepted.section.taper = -0.3;
        accepted.section.softening = Some(Softening::Bilinear {
            onset_per_m: 8.0,
            ratio: 0.6,
        });
        accepted.compliance_rad_per_nmm = 0.01;
        let axes = MomentAxes::default();
        let field = MomentField::new(&accepted, &axes, Friction::NONE);
        let place = field.free(40.0).0 + Vector3::new(0.0, 1.0, -5.0);
        let held = field.held(&place, 0.0).unwrap();
        let off_mm = |rod: &Rod| {
            let wire = TouchedWire::new(rod, 0.3, &axes).unwrap();
            let moment = Vector2::from(held.moment_nmm);
            let found = wire.frictionless(held.arclength_mm, &moment, None).unwrap();
            (wire.axis_mm(&wire.show(&found)) - place).norm()
        };
        assert!(off_mm(&accepted) < 0.05, "{}", off_mm(&accepted));
        assert!(off_mm(&declared) > 0.2, "{}", off_mm(&declared));
    }

    /// A contact that gives its own moments is found again, and the frame does not jump at the
    /// joints.
    #[test]
    fn forces_are_found_again_and_the_wire_is_smooth() {
        let wire = wire();
        for q in [12.0, 33.3, 58.0, 64.0] {
            let x = State::from([q, 0.02, 0.7, 0.0, 0.0]);
            let found = wire
                .frictionless(q, &wire.show(&x).moment_nmm(), None)
                .unwrap();
            assert!((found - x).amax() < 1e-3, "{q}: {found:?}");
            // Control: at another place the same moments take another force.
            let other = wire
                .frictionless(q - 4.0, &wire.show(&x).moment_nmm(), None)
                .unwrap();
            assert!((other[1] - 0.02).abs() > 1e-4, "{q}");
        }
        let normal = |q: f64| wire.show(&State::from([q, 0.02, 0.7, 0.0, 0.0])).normal();
        let steps: Vec<f64> = (0..200)
            .map(|k| {
                (normal(30.5 + 0.1 * f64::from(k + 1)) - normal(30.5 + 0.1 * f64::from(k))).norm()
            })
            .collect();
        let largest = steps.iter().copied().fold(0.0, f64::max);
        assert!(
            largest < 3.0 * steps[100] + 1e-3,
            "{largest} {}",
            steps[100]
        );
    }
}
