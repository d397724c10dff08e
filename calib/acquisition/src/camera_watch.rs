//! Records the pairs of a camera pair while a sweep runs, in its own thread.

use crate::camera_pair::{CameraPair, FramePair};
use crate::clocks::ClockPair;
use crate::error::AcquisitionError;
use crate::message::SweepEvent;
use crate::monitor::{Monitor, lock};
use crate::pictures::{PREVIEW_PERIOD_S, exposure_s};
use crate::recorder::Recorder;
use crate::steps::disk;
use crate::sweep::{INTERRUPTED, Watched};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use wcal_core::device::{CameraFrame, DeviceErrorKind};

/// Longest wait for a picture (wall time).
const PATIENCE: Duration = Duration::from_secs(2);
/// Pairs refused in a row that end a sweep: a camera that hangs does not recover.
const REFUSED_LIMIT: u32 = 5;

/// Records pairs until `done`: of every frame when it was made, of a settled pose the pair without
/// loss, and small pictures between. A refused pair is an event and a count; several in a row, a
/// silent or a lost camera end the sweep.
pub(crate) fn watch(
    pair: &mut CameraPair,
    names: &[String; 2],
    monitor: &Mutex<Monitor>,
    recorder: &Recorder,
    done: &AtomicBool,
    clock_scale: f64,
) {
    let _watched = Watched(|e| lock(monitor).fail_with(e));
    let mut refused = 0;
    let mut eyes = [(); 2].map(|()| CameraClock::new(clock_scale));
    let mut shown_s = f64::NEG_INFINITY;
    while !done.load(Ordering::SeqCst) {
        let result = pair.grab(PATIENCE);
        // What a camera reports after the sweep's end is no fault of the sweep.
        if done.load(Ordering::SeqCst) {
            return;
        }
        let outcome = match result {
            Ok(found) => {
                refused = 0;
                lock(monitor).pair(Some(found.skew_ms));
                let wanted = lock(monitor).picture;
                let shows = |(_, since_s): &(u32, f64)| {
                    let mut both = eyes.iter().zip(&found.frames);
                    both.all(|(eye, frame)| eye.exposed_after(*since_s, frame))
                };
                let step = wanted.filter(shows).map(|(step, _)| step);
                // After the judgement: a frame does not vouch for its own time.
                let both = eyes.iter_mut().zip(&found.frames);
                both.for_each(|(eye, frame)| eye.note(frame));
                let host_s = found.frames[0].clocks.host_s;
                let show = host_s - shown_s >= PREVIEW_PERIOD_S;
                if show {
                    shown_s = host_s;
                }
                let recorded = record(&found, names, recorder, step, show);
                // The stage stands until this is cleared: the pictures are in the recording by now.
                if step.is_some() {
                    lock(monitor).picture = None;
                }
                recorded
            }
            Err(e) if e.kind == DeviceErrorKind::DataInvalid => {
                refused += 1;
                lock(monitor).pair(None);
                let detail = e.to_string();
                if refused >= REFUSED_LIMIT {
                    lock(monitor).fail_with(e);
                }
                let event = SweepEvent {
                    kind: "pair-refused".to_owned(),
                    detail,
                    ..SweepEvent::default()
                };
                recorder.event(pair.host_s(), &event)
            }
            // The sweep hears of it by itself.
            Err(e) if e.kind == DeviceErrorKind::Interrupted => {
                std::thread::sleep(INTERRUPTED);
                Ok(())
            }
            Err(e) => return lock(monitor).fail_with(e),
        };
        if let Err(e) = outcome {
            return lock(monitor).fail_with(disk(&e));
        }
    }
}

fn record(
    pair: &FramePair,
    names: &[String; 2],
    recorder: &Recorder,
    step: Option<u32>,
    show: bool,
) -> Result<(), AcquisitionError> {
    for (name, frame) in names.iter().zip(&pair.frames) {
        recorder.frame(name, frame, step)?;
        if show {
            recorder.preview(name, frame)?;
        }
    }
    Ok(())
}

/// What is known of one camera's time.
struct CameraClock {
    clocks: ClockPair,
    /// Host time of the last frame's arrival, s.
    last_host_s: f64,
}

impl CameraClock {
    fn new(clock_scale: f64) -> Self {
        Self {
            clocks: ClockPair::new(clock_scale),
            last_host_s: f64::NEG_INFINITY,
        }
    }

    /// Whether the exposure began after a host time. Frames may wait in a queue, so that their
    /// arrival does not give their exposure. Even the least delayed arrival is late by the exposure
    /// itself, which is added. Without a clock of the camera's own a frame is accepted only when
    /// the previous one arrived after that time, too.
    fn exposed_after(&self, host_s: f64, frame: &CameraFrame) -> bool {
        let exposure_s = exposure_s(frame).unwrap_or(0.0);
        match (frame.clocks.device_s, self.clocks.device_s(host_s)) {
            (Some(begin_s), Some(wanted_s)) => begin_s >= wanted_s + exposure_s,
            _ => self.last_host_s >= host_s,
        }
    }

    fn note(&mut self, frame: &CameraFrame) {
        self.last_host_s = frame.clocks.host_s;
        if let Some(device_s) = frame.clocks.device_s {
            self.clocks.add(frame.clocks.host_s, device_s);
        }
    }
}
