//! Faults of the virtual bench, from the scenario or on command.

use super::scenario::CameraScenario;
use super::unit_clock::UnitClock;
use serde::Deserialize;
use std::collections::VecDeque;

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Fault {
    /// The next motion of the stage stalls.
    Stall,
    /// The limit switch triggers at once.
    Limit,
    /// Somebody pushes the standing carriage.
    Displaced,
    /// The motor driver switches off.
    DriverOff,
    /// Critical system fault.
    Critical,
    /// Stage power lost and back: reference gone, silent for a second.
    PowerCut,
    /// The unit restarts by itself; as after a power cut.
    Reset,
    /// Stage cable out.
    UnplugStage,
    /// Stage cable back in.
    PlugStage,
    /// The next reply of the stage is lost.
    LoseReply,
    /// The next reply has a wrong bit.
    CorruptReply,
    /// The next reply comes in pieces.
    SplitReply,
    /// The next reply comes twice.
    DoubleReply,
    /// Noise before the next reply.
    NoiseReply,
    /// The next reply comes after the client has given it up.
    LateReply,
    /// A reply of another unit before the next reply.
    ForeignReply,
    /// Info and empty lines before the next reply.
    InfoLines,
    /// Alerts (binary: positions that nobody asked for) without an end, and no reply among them.
    AlertFlood {
        /// Begins or ends.
        on: bool,
    },
    /// Replies of another unit without an end, and none of this one.
    ForeignFlood {
        /// Begins or ends.
        on: bool,
    },
    /// The next motion of the stage never ends: it stays BUSY at its target until it is stopped.
    BusyForEver,
    /// Stage and interrogator answer to no new connection.
    NeverAccept {
        /// Begins or ends.
        on: bool,
    },
    /// Scans that are never sent.
    LostSamples {
        /// How many.
        count: u64,
    },
    /// The stream pauses; what the buffer cannot hold is lost.
    StreamGap {
        /// Length, s.
        seconds: f64,
    },
    /// Garbage bytes in the stream.
    StreamGarbage,
    /// Calibration fault bit on or off.
    CalibrationFault {
        /// Set or cleared.
        on: bool,
    },
    /// Cooler over temperature.
    TecFault {
        /// Set or cleared.
        on: bool,
    },
    /// Error code 9, data invalid.
    DataInvalid {
        /// Set or cleared.
        on: bool,
    },
    /// A grating has no peak: 0 reference, 1 and 2 sensing.
    PeakLost {
        /// Which grating.
        grating: usize,
        /// Set or cleared.
        on: bool,
    },
    /// The peak of a grating has no value (Hyperion: NaN, sm130: 0) in some scans.
    NanPeak {
        /// Which grating.
        grating: usize,
        /// How many scans.
        count: u64,
    },
    /// Grating 1 is shifted onto grating 2.
    PeakCrossing {
        /// Set or cleared.
        on: bool,
    },
    /// Interrogator cable out.
    UnplugInterrogator,
    /// Interrogator cable back in.
    PlugInterrogator,
    /// The second camera repeats its last picture.
    FrozenCamera {
        /// Set or cleared.
        on: bool,
    },
    /// The second camera lags.
    CameraSkew {
        /// Delay, ms.
        ms: f64,
    },
    /// Frames of the second camera that are never sent.
    LostFrames {
        /// How many.
        count: u64,
    },
    /// Somebody knocks the second camera: views of the bench are from its new place, those of the
    /// board from the old one.
    CameraMoved {
        /// Shift in the camera's frame, mm.
        mm: [f64; 3],
        /// Rotation vector in the camera's frame, degrees.
        deg: [f64; 3],
    },
    /// Both cameras expose for another time.
    Exposure {
        /// Times the right one.
        factor: f64,
    },
    /// A chessboard is held up before the cameras, or taken away.
    Board {
        /// Attitude, counted from 0; none: taken away.
        view: Option<usize>,
    },
    /// The unit's clock runs wrong from now on.
    ClockDrift {
        /// Parts per million.
        ppm: f64,
    },
    /// The unit's clock is set.
    ClockStep {
        /// By how much, s; negative: back.
        seconds: f64,
    },
    /// The unit's clock stands still, or goes on from where it stood.
    ClockStop {
        /// Stands or goes on.
        on: bool,
    },
    /// The unloaded sensing gratings drift from now on: the signal never settles.
    SignalDrift {
        /// Rate, pm/s.
        pm_per_s: f64,
    },
    /// The room warms at once.
    TemperatureStep {
        /// Step, K.
        degc: f64,
    },
}

/// A fault and its bench time.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct ScheduledFault {
    /// Bench time, s.
    pub at_s: f64,
    /// What happens.
    #[serde(flatten)]
    pub fault: Fault,
}

/// Faults that are on, or that the next replies of the stage will have.
#[derive(Default)]
pub(crate) struct FaultState {
    /// The cables of stage and interrogator are out.
    pub stage_out: bool,
    /// See `stage_out`.
    pub interrogator_out: bool,
    /// Of the next replies, one each.
    pub replies: VecDeque<Fault>,
    /// Instead of replies alerts without an end, or replies of another unit (true).
    pub flood: Option<bool>,
    /// No new connection is answered.
    pub never_accepts: bool,
    /// Bench time until which the stream is held back, s.
    pub pause_until_s: f64,
    /// Garbage bytes go before the next scan.
    pub garbage: bool,
    /// What is wrong with the interrogator's clock.
    pub unit_clock: UnitClock,
    pub cameras: CameraState,
}

/// State of the picture stream.
#[derive(Clone, Copy, Default)]
pub(crate) struct CameraState {
    /// The second camera repeats its last picture.
    pub frozen: bool,
    /// Extra delay of the second camera, ms.
    pub skew_ms: f64,
    /// Attitude of the chessboard that is held up.
    pub board: Option<usize>,
    /// Exposure relative to the right one.
    pub exposure: f64,
    /// Shift (mm) and rotation vector (degrees) of the second camera since the board was shown.
    pub moved: ([f64; 3], [f64; 3]),
    /// Frames of the second camera still to be lost.
    pub lose: u64,
}

impl FaultState {
    /// No fault but those that a scenario's cameras have from the start.
    pub(crate) fn of(cameras: &CameraScenario) -> Self {
        Self {
            cameras: CameraState {
                skew_ms: cameras.skew_ms,
                exposure: cameras.exposure,
                moved: (cameras.errors.moved_mm, cameras.errors.moved_deg),
                ..CameraState::default()
            },
            ..Self::default()
        }
    }
}

/// A fault from a line of text: its name (`stall`), or a JSON object with a `kind`.
///
/// # Errors
/// What was expected and what was found.
pub fn parse(line: &str) -> Result<Fault, String> {
    let line = line.trim();
    let text = if line.starts_with('{') {
        line.to_owned()
    } else {
        format!("{{\"kind\":\"{line}\"}}")
    };
    serde_json::from_str(&text)
        .map_err(|e| format!("expected a fault such as stall, found {line:?}: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_by_name_and_as_json() {
        assert_eq!(parse("stall").unwrap(), Fault::Stall);
        assert_eq!(
            parse("{\"kind\":\"lost-samples\",\"count\":7}").unwrap(),
            Fault::LostSamples { count: 7 }
        );
        assert_eq!(
            parse("{\"kind\":\"board\",\"view\":3}").unwrap(),
            Fault::Board { view: Some(3) }
        );
        assert_eq!(parse("board").unwrap(), Fault::Board { view: None });
        assert!(parse("earthquake").is_err() && parse("").is_err() && parse("{").is_err());
    }
}
