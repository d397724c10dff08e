//! A session in any orientation has the same contacts: wire, moments and motion turned by any
//! rotation.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use nalgebra::{Matrix2, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use wcal_core::observation::{MomentAxes, RestShape, WhiskerSpec};
use wcal_core::wire_frame::WireFrame;
use wcal_rod::Rod;
use wcal_session::MotionUnknown;
use wcal_track::calibrated_wire::CalibratedWire;
use wcal_track::estimator::Estimator;
use wcal_track::known_motion::{Friction, MomentField};
use wcal_track::reading::{Moments, MotionAccuracy, Reading, RowMotion};
use wcal_track::regimes::ANY_OBJECT;
use wcal_track::track_table::TrackRow;
use wcal_track::tracker::ContactTracker;
use wcal_track::whisker_track::{WhiskerFacts, WhiskerTrack};

const NOISE_NMM: f64 = 2e-3;
const ACCURACY: MotionAccuracy = MotionAccuracy {
    moved_sd_mm: 0.02,
    clock_sd_s: 0.01,
    window_sd_s: 0.0,
};

/// The paper's wire as points.
fn wire() -> WhiskerSpec {
    let shape = WhiskerSpec::nominal().rest_shape;
    WhiskerSpec {
        rest_shape: RestShape::Polyline(shape.points(0.5)),
        ..WhiskerSpec::nominal()
    }
}

fn field(whisker: &WhiskerSpec) -> MomentField {
    MomentField::new(
        &Rod::new(whisker, 0.5).unwrap(),
        &MomentAxes::default(),
        Friction::NONE,
    )
}

/// A session: how it describes its wire, and along what its moments are components.
struct Session {
    turn: Rotation3<f64>,
    whisker: WhiskerSpec,
    axes: MomentAxes,
}

impl Session {
    fn new(turn: Rotation3<f64>, axes: [Vector3<f64>; 2], sign: f64) -> Self {
        let RestShape::Polyline(points) = wire().rest_shape else {
            unreachable!("a polyline")
        };
        let rest_shape = RestShape::Polyline(points.iter().map(|p| turn * p).collect());
        let axes = MomentAxes {
            axes: axes.map(|a| turn * a.normalize()),
            sign,
        };
        Self {
            turn,
            whisker: WhiskerSpec {
                rest_shape,
                ..wire()
            },
            axes,
        }
    }

    /// A press of the wire at 42 mm along its arc: the object goes 6 mm along -z and back by 2 mm.
    fn readings(&self) -> Vec<Reading> {
        let field = field(
            &WireFrame::new(&wire(), &MomentAxes::default())
                .unwrap()
                .whisker(&wire()),
        );
        let touch = field.free(42.0).0;
        let way = |k: usize| {
            if k < 36 {
                0.25 * k as f64 - 3.0
            } else {
                6.0 - 0.25 * (k - 36) as f64
            }
        };
        let seen = Matrix2::from_fn(|i, j| {
            let e = [Vector3::y(), Vector3::z()][j];
            self.axes.sign * self.axes.axes[i].dot(&(self.turn * e))
        });
        let one = |k: usize| {
            let moved = Vector3::new(0.0, 0.1, -1.0) * way(k);
            let held =
                (way(k) > 0.0).then(|| field.held(&(touch + moved), 0.0).unwrap().moment_nmm);
            let [y, z] = held.unwrap_or_default();
            let moments = Moments {
                moment_nmm: self
                    .axes
                    .components_nmm(&(self.turn * Vector3::new(0.0, y, z))),
                sd_nmm: [NOISE_NMM; 2],
                valid: true,
                pose_nmm2: seen * seen.transpose() * NOISE_NMM.powi(2),
                own_nmm2: Some(seen * seen.transpose() * NOISE_NMM.powi(2) * 0.5),
                inefficiency: 0.0,
                drift_nmm2: Matrix2::zeros(),
                zero_nmm2: Matrix2::zeros(),
                shared_nmm: Vec::new(),
            };
            let motion = RowMotion {
                moved_mm: self.turn * moved,
                turn: Rotation3::identity(),
                velocity_mm_s: self.turn * Vector3::new(0.0, 0.25, -2.5),
                piece: 0,
                push: None,
            };
            Reading {
                motion: Ok(motion),
                velocity_mm_s: Some(motion.velocity_mm_s * -1.0),
                ..Reading::alone(k as i64, 0.1 * k as f64, Some(moments))
            }
        };
        (0..44).map(one).collect()
    }

    /// Rows of an estimator in `frame`, which is the session's unless somebody forgets it.
    fn rows(&self, which: usize, frame: WireFrame) -> Vec<TrackRow> {
        let whisker = frame.whisker(&self.whisker);
        let wire = CalibratedWire::of_rod(Rod::new(&whisker, 0.5).unwrap(), whisker.diameter_mm);
        let estimator: Box<dyn Estimator> = match which {
            0 => Box::new(ContactTracker::of_record(wire, ACCURACY, ANY_OBJECT)),
            _ => Box::new(ContactTracker::of_stream(wire, ACCURACY, ANY_OBJECT)),
        };
        let mut track = WhiskerTrack::new(WhiskerFacts::default(), (frame, estimator), 0.0, true);
        let mut rows = Vec::new();
        for reading in self.readings() {
            let motion = if which == 2 {
                Err(MotionUnknown::Unknown)
            } else {
                reading.motion
            };
            rows.extend(track.push(Reading { motion, ..reading }).unwrap());
        }
        rows.extend(track.finish().unwrap());
        rows
    }

    fn frame(&self) -> WireFrame {
        WireFrame::new(&self.whisker, &self.axes).unwrap()
    }
}

/// Largest distance of places and difference of regions between a session and one that is not
/// turned, mm; none where one has a place alone.
fn apart(session: &Session, rows: &[TrackRow], plain: &[TrackRow]) -> Option<f64> {
    let mut far: f64 = 0.0;
    let contacts = rows
        .iter()
        .zip(plain)
        .map(|(a, b)| (&a.contact, &b.contact));
    for (row, plain) in contacts {
        match (row.estimate, plain.estimate) {
            (Some(a), Some(b)) => {
                let a = a.turned(&session.turn.inverse());
                far = far.max((a.place_mm - b.place_mm).norm());
                far = far.max((a.covariance_mm2 - b.covariance_mm2).norm());
            }
            (None, None) => {}
            _ => return None,
        }
        if row.regions.len() != plain.regions.len() || row.flags != plain.flags {
            return None;
        }
        for (a, b) in row.regions.iter().zip(&plain.regions) {
            far = far
                .max((a.from_mm - b.from_mm).abs())
                .max((a.to_mm - b.to_mm).abs());
        }
    }
    Some(far)
}

#[test]
fn a_turned_session_has_the_same_contacts() {
    let right = [Vector3::y(), Vector3::z()];
    let plain = Session::new(Rotation3::identity(), right, 1.0);
    let expected: Vec<Vec<TrackRow>> = (0..3)
        .map(|which| plain.rows(which, plain.frame()))
        .collect();
    for rows in &expected {
        assert!(rows.iter().filter(|r| r.contact.estimate.is_some()).count() > 20);
    }
    // The place is the true one, to begin with.
    let end = expected[0].last().unwrap().contact.estimate.unwrap();
    let touch = field(&wire()).free(42.0).0 + Vector3::new(0.0, 0.1, -1.0) * 4.25;
    let off = end.place_mm - touch;
    // Of an object of which nothing is known the point may have crept: by the stated covariance.
    let squared = end
        .covariance_mm2
        .cholesky()
        .map(|c| off.dot(&c.solve(&off)));
    assert!(
        off.norm() < 1.0 && squared.is_some_and(|z2| z2 < 7.8),
        "{end:?} {touch}"
    );
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let (mut forgotten, mut largest) = (0, 0.0_f64);
    for k in 0..4 {
        let angle = || std::f64::consts::TAU;
        let turn = Rotation3::from_euler_angles(
            rng.random_range(0.0..angle()),
            rng.random_range(0.0..angle()),
            rng.random_range(0.0..angle()),
        );
        // Moments about two axes that are not at right angles, of either sign.
        let axes = [Vector3::new(0.0, 1.0, 0.3), Vector3::new(0.0, -0.4, 1.0)];
        let session = Session::new(turn, axes, if k % 2 == 0 { 1.0 } else { -1.0 });
        for (which, plain) in expected.iter().enumerate() {
            let far = apart(&session, &session.rows(which, session.frame()), plain);
            assert!(
                far.is_some_and(|mm| mm < 1e-6),
                "turn {k}, estimator {which}: {far:?}"
            );
            largest = largest.max(far.unwrap_or(f64::NAN));
        }
        // Control: the axes of another session.
        let frame = WireFrame::new(
            &session.whisker,
            &MomentAxes {
                axes: right.map(|a| turn * a),
                sign: 1.0,
            },
        );
        let far = apart(&session, &session.rows(0, frame.unwrap()), &expected[0]);
        forgotten += usize::from(far.is_none_or(|mm| mm > 0.5));
    }
    println!("turned sessions: at most {largest:.1e} mm apart");
    assert_eq!(forgotten, 4, "control");
}
