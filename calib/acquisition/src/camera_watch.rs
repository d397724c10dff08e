//! Records the pairs of a camera pair while a sweep runs, in a thread of its own.

use crate::camera_pair::CameraPair;
use crate::message::SweepEvent;
use crate::monitor::Monitor;
use crate::recorder::Recorder;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use wcal_core::device::{DeviceError, DeviceErrorKind};

/// Longest wait for a picture (wall time).
const PATIENCE: Duration = Duration::from_secs(2);
/// Pairs refused in a row that end a sweep: a camera that hangs does not recover.
const REFUSED_LIMIT: u32 = 5;

/// Records pairs until `done`. A refused pair is an event and a count; several in a row, a silent or a lost camera end
/// the sweep.
pub fn watch(
    pair: &mut CameraPair,
    names: &[String; 2],
    monitor: &Mutex<Monitor>,
    recorder: &Recorder,
    done: &AtomicBool,
) {
    let mut refused = 0;
    while !done.load(Ordering::SeqCst) {
        let result = pair.grab(PATIENCE);
        if done.load(Ordering::SeqCst) {
            return;
        }
        let disk = match result {
            Ok(found) => {
                refused = 0;
                lock(monitor).pair(Some(found.skew_ms));
                names.iter().zip(&found.frames).try_for_each(|(name, f)| recorder.picture(name, f))
            }
            Err(e) if e.kind == DeviceErrorKind::DataInvalid => {
                refused += 1;
                lock(monitor).pair(None);
                let detail = e.to_string();
                if refused >= REFUSED_LIMIT {
                    lock(monitor).fail_with(e);
                }
                let kind = "pair-refused".to_owned();
                recorder.event(pair.host_s(), &SweepEvent { kind, detail, ..SweepEvent::default() })
            }
            Err(e) => return lock(monitor).fail_with(e),
        };
        if let Err(e) = disk {
            let kind = DeviceErrorKind::Configuration;
            let error = DeviceError::new(kind, "recorder", "record", "space on disk", e.to_string());
            return lock(monitor).fail_with(error);
        }
    }
}

fn lock(monitor: &Mutex<Monitor>) -> MutexGuard<'_, Monitor> {
    monitor.lock().unwrap_or_else(PoisonError::into_inner)
}
