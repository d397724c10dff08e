//! Readings and contacts in the frame of the wire ([`WireFrame`]).

use crate::estimator::ContactEstimate;
use crate::reading::{Moments, Reading, RowMotion};
use nalgebra::{Matrix2, Vector2};
use wcal_core::wire_frame::WireFrame;

/// A reading in the frame of the wire; the pose of the base stays that of the session's base.
pub(crate) fn in_wire_frame(frame: &WireFrame, reading: &Reading) -> Reading {
    if frame.is_base() {
        return reading.clone();
    }
    let turn = frame.rotation();
    // Vectors turn by R; a rotation Q of the object is R Q R^-1 in the turned frame.
    let motion = reading.motion.map(|m| RowMotion {
        moved_mm: turn * m.moved_mm,
        turn: turn * m.turn * turn.inverse(),
        velocity_mm_s: turn * m.velocity_mm_s,
        push: m.push.map(|p| turn * p),
        ..m
    });
    let velocity_mm_s = reading.velocity_mm_s.map(|v| turn * v);
    let by_unknowns = reading.shared_displacement_mm.iter();
    Reading {
        moments: reading.moments.as_ref().map(|m| turned(frame, m)),
        motion,
        velocity_mm_s,
        // The speed along this frame's +z, where the velocity is known.
        base_mm_s: velocity_mm_s.map(|v| v.z).or(reading.base_mm_s),
        shared_displacement_mm: by_unknowns.map(|w| turn * w).collect(),
        ..reading.clone()
    }
}

fn turned(frame: &WireFrame, m: &Moments) -> Moments {
    let pose_nmm2 = frame.covariance(&m.pose_nmm2);
    let shared_nmm: Vec<[f64; 2]> = m.shared_nmm.iter().map(|h| frame.moment(*h)).collect();
    let outer = |h: &[f64; 2]| Vector2::from(*h) * Vector2::from(*h).transpose();
    let shared: Matrix2<f64> = shared_nmm.iter().map(outer).sum();
    // Standard deviations do not turn as vectors do: they come from the turned covariance.
    Moments {
        moment_nmm: frame.moment(m.moment_nmm),
        sd_nmm: (pose_nmm2 + shared)
            .diagonal()
            .map(|v| v.max(0.0).sqrt())
            .into(),
        pose_nmm2,
        own_nmm2: m.own_nmm2.map(|n| frame.covariance(&n)),
        drift_nmm2: frame.covariance(&m.drift_nmm2),
        zero_nmm2: frame.covariance(&m.zero_nmm2),
        shared_nmm,
        ..*m
    }
}

/// A contact of the wire's frame in base coordinates.
pub(crate) fn in_base_frame(frame: &WireFrame, estimate: ContactEstimate) -> ContactEstimate {
    if frame.is_base() {
        estimate
    } else {
        estimate.turned(&frame.rotation().inverse())
    }
}
