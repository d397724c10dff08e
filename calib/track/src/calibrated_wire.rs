//! The wire of a whisker as its calibration has it: every way to locate a contact bends this one.

use crate::known_motion::{Friction, MomentField, MotionRow, Settings};
use crate::reading::{Moments, MotionAccuracy, Reading};
use crate::sliding::FrictionPrior;
use nalgebra::{Matrix2, Vector3};
use std::sync::Arc;
use wcal_core::WireFrame;
use wcal_core::observation::MomentAxes;
use wcal_rod::Rod;
use wcal_verify::whisker::groove_motion::AcceptedWire;

/// A wire, in the frame of its wire.
#[derive(Clone)]
pub struct CalibratedWire {
    /// Its moments where it is held at one point.
    pub field: Arc<MomentField>,
    /// The wire itself.
    pub rod: Rod,
    /// Its declared diameter, mm.
    pub diameter_mm: f64,
    /// Relative standard deviation of the diameter of the wire that is tracked; none where it is
    /// the calibration's own, whose stiffness is in the scale of the moments.
    tolerance: Option<f64>,
    /// On what touches it.
    pub friction: FrictionPrior,
}

/// The moments of a rod with the accepted friction of a wire.
fn moment_field(wire: &AcceptedWire, rod: &Rod, axes: &MomentAxes) -> MomentField {
    let friction = Friction {
        coefficient: wire.friction,
        moving_share: wire.moving_share,
    };
    MomentField::new(rod, axes, friction)
}

impl CalibratedWire {
    /// With the wire by one standard deviation of each of the readings' first common unknowns;
    /// `diameter_mm` is the declared one.
    pub fn new(wire: &AcceptedWire, changed: &[AcceptedWire], diameter_mm: f64) -> Self {
        let base = (&WireFrame::default(), &MomentAxes::default());
        Self::of_session((wire, changed), base, diameter_mm)
    }

    /// The wire of a session in a frame, or, where the rod of an accepted one cannot be turned, by
    /// its own axes.
    pub fn of_session(
        (wire, changed): (&AcceptedWire, &[AcceptedWire]),
        (frame, axes): (&WireFrame, &MomentAxes),
        diameter_mm: f64,
    ) -> Self {
        let field = |wire: &AcceptedWire| {
            let turned = wire.rod.turned(&frame.rotation());
            match turned.filter(|_| !frame.is_base()) {
                Some(rod) => moment_field(wire, &rod, &MomentAxes::default()),
                None => moment_field(wire, &wire.rod, axes),
            }
        };
        let mut own = field(wire);
        own.changed = changed.iter().map(field).collect();
        Self {
            field: Arc::new(own),
            rod: wire.rod.clone(),
            diameter_mm,
            tolerance: None,
            friction: FrictionPrior::default(),
        }
    }

    /// Of a rod without friction whose errors are those of the readings alone.
    pub fn of_rod(rod: Rod, diameter_mm: f64) -> Self {
        let wire = AcceptedWire {
            rod,
            friction: 0.0,
            moving_share: 1.0,
            offset_mm: Vector3::zeros(),
        };
        Self::new(&wire, &[], diameter_mm)
    }

    /// Of another wire than the calibration's, whose diameter has a relative standard deviation.
    pub fn with_tolerance(self, diameter_share: Option<f64>) -> Self {
        Self {
            tolerance: diameter_share,
            ..self
        }
    }

    /// With what is known of its friction on an object that it slides over.
    pub fn with_friction(self, friction: FrictionPrior) -> Self {
        Self { friction, ..self }
    }

    /// Relative standard deviation of the stiffness, which goes with the fourth power of the
    /// diameter.
    pub(crate) fn stiffness_sd(&self) -> f64 {
        // E I goes with d^4.
        4.0 * self.tolerance.unwrap_or(0.0)
    }

    /// What regions assume of it, with a bar between: `wire=calibrated` or the diameter's relative
    /// standard deviation, and the friction.
    pub fn assumes(&self) -> String {
        let wire = self.tolerance.map_or_else(
            || "wire=calibrated".to_owned(),
            |sd| format!("diameter-sd={sd}"),
        );
        format!("{wire}|friction={}", self.friction)
    }

    /// Columns of what all readings of a record share, N mm by one standard deviation of each: the
    /// calibration's unknowns, the zero, and the stiffness of another wire, which scales all
    /// moments of a held wire.
    pub fn shared_columns(&self, m: &Moments) -> Vec<[f64; 2]> {
        let mut all = m.shared_nmm.clone();
        // A zero that is known is no unknown.
        if m.zero_nmm2 != Matrix2::zeros() {
            // Z = L L': the columns of L are two unknowns of unit variance.
            let root = m.zero_nmm2.cholesky();
            all.extend(root.map_or_else(Matrix2::zeros, |c| c.l()).data.0);
        }
        if self.stiffness_sd() > 0.0 {
            all.push(m.moment_nmm.map(|m| self.stiffness_sd() * m));
        }
        all
    }

    /// A reading along its motion, where its moments and motion are known; without its own noise it
    /// has that from pose to pose.
    pub fn row(&self, reading: &Reading, accuracy: &MotionAccuracy) -> Option<MotionRow> {
        let (m, motion) = (reading.moments.as_ref()?, reading.motion.as_ref().ok()?);
        // Of slow noise g readings say as much as one: each counts with g times its variance.
        Some(MotionRow {
            t_s: reading.t_s,
            moment_nmm: m.moment_nmm,
            noise_nmm2: m.own_nmm2.unwrap_or(m.pose_nmm2) * m.inefficiency.max(1.0),
            free_nmm2: m.own_nmm2.map(|own| own + m.zero_nmm2),
            shared_displacement_mm: reading.shared_displacement_mm.clone(),
            shared_nmm: self.shared_columns(m),
            moved_mm: motion.moved_mm,
            turn: motion.turn,
            velocity_mm_s: motion.velocity_mm_s,
            moved_sd_mm: accuracy.moved_sd_mm,
            free: reading.in_prefix,
            contact_segment: reading.visit,
        })
    }

    /// What is assumed of a contact at a fixed point.
    pub fn settings(&self, accuracy: &MotionAccuracy) -> Settings {
        Settings {
            clock_sd_s: accuracy.clock_sd_s,
            window_sd_s: accuracy.window_sd_s,
            stiffness_sd: self.stiffness_sd(),
            ..Settings::default()
        }
    }

    /// Middle of the free wire, mm.
    pub fn middle_mm(&self) -> Vector3<f64> {
        self.field.middle_mm()
    }
}
