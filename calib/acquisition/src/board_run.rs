//! Pictures of the calibration board before a sweep: one pair an attitude, exposed after the board was held there.

use crate::camera_pair::CameraPair;
use crate::camera_watch::{CameraClock, PATIENCE, REFUSED_LIMIT};
use crate::message::SweepEvent;
use crate::recorder::{FramePurpose, Recorder};
use crate::replay::{Message, read};
use crate::steps::disk;
use std::collections::BTreeSet;
use std::path::PathBuf;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{CameraFrame, DeviceError, DeviceErrorKind};

/// Time for which the board is left to stand before its picture counts, s.
const STAND_S: f64 = 0.5;
/// Pairs by which the cameras' clocks are known before the first picture that counts.
const CLOCK_PAIRS: u32 = 4;

/// Asks a person to hold the board in the attitude of this number, counted from 0; returns when it is held.
pub type AskBoard = fn(u32) -> Result<(), DeviceError>;

/// Attitudes in earlier recordings of a session; a recording that cannot be read has none.
pub fn shown_before(recordings: &[PathBuf]) -> BTreeSet<u32> {
    let mut shown = BTreeSet::new();
    for path in recordings {
        let each = |message| {
            if let Message::Event(event) = message
                && event.kind == "board"
            {
                shown.insert(event.step);
            }
        };
        if read(path, each).is_err() {
            continue;
        }
    }
    shown
}

/// What pictures of the board are taken with.
pub struct BoardRun<'a> {
    /// Cameras.
    pub pair: &'a mut CameraPair,
    /// Their names.
    pub names: &'a [String; 2],
    /// Where the pictures go.
    pub recorder: &'a Recorder,
    /// The host's clock.
    pub clock: HostClock,
    /// Host seconds per wall second.
    pub clock_scale: f64,
    /// Set when the user wants an end.
    pub interrupt: &'a Interrupt,
}

impl BoardRun<'_> {
    /// Records a pair of each of `views` attitudes but those of `skip`.
    ///
    /// # Errors
    /// When a camera is lost or refuses pair after pair, nobody holds the board, the disk does not accept the pictures, or the user interrupts.
    pub fn run(&mut self, views: u32, skip: &BTreeSet<u32>, ask: AskBoard) -> Result<(), DeviceError> {
        let mut eyes = [(); 2].map(|()| CameraClock::new(self.clock_scale));
        for view in (0..views).filter(|view| !skip.contains(view)) {
            // A bench that presents the board by itself needs no person.
            if !self.pair.show_board(Some(view as usize))? {
                ask(view)?;
            }
            let frames = self.exposed_after(self.clock.now_s() + STAND_S, &mut eyes)?;
            for (name, frame) in self.names.iter().zip(&frames) {
                self.recorder.frame(name, frame, FramePurpose::Board(view)).map_err(|e| disk(&e))?;
            }
            let event = SweepEvent { kind: "board".to_owned(), step: view, ..SweepEvent::default() };
            self.recorder.event(self.pair.host_s(), &event).map_err(|e| disk(&e))?;
        }
        self.pair.show_board(None).map(drop)
    }

    /// The first pair whose exposure began after a host time.
    fn exposed_after(
        &mut self,
        since_s: f64,
        eyes: &mut [CameraClock; 2],
    ) -> Result<[CameraFrame; 2], DeviceError> {
        let (mut refused, mut seen) = (0, 0);
        loop {
            self.interrupt.check("cameras", "picture the board")?;
            let found = match self.pair.grab(PATIENCE) {
                Ok(found) => found,
                Err(e) if e.kind == DeviceErrorKind::DataInvalid && refused + 1 < REFUSED_LIMIT => {
                    refused += 1;
                    continue;
                }
                Err(e) => return Err(e),
            };
            seen += 1;
            let after = eyes.iter().zip(&found.frames).all(|(eye, frame)| eye.exposed_after(since_s, frame));
            eyes.iter_mut().zip(&found.frames).for_each(|(eye, frame)| eye.note(frame));
            if after && seen > CLOCK_PAIRS {
                return Ok(found.frames);
            }
        }
    }
}
