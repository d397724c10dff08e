//! Scans from the devices to the tracker: recorded first, then queued; a full queue drops and
//! counts, and never waits.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use wcal_acquisition::AcquisitionError;
use wcal_acquisition::message::{StagePosition, SweepEvent};
use wcal_acquisition::recorder::Recorder;
use wcal_core::device::{DeviceError, FbgReading};

/// Scans of one place in the queue.
const BATCH: usize = 50;

/// What arrives.
#[derive(Debug)]
pub(crate) enum FeedItem {
    /// Scans, and how many were dropped before the first.
    Scans(Vec<FbgReading>, u64),
    /// A position of the stage.
    Stage(StagePosition),
    /// What a sweep did.
    Event(SweepEvent),
    /// Another recording begins.
    Recording,
    /// The source failed.
    Failed(DeviceError),
}

/// The end that takes what the devices give. Recording and queue see everything in the same order,
/// so that a replay does too.
pub(crate) struct FeedInput {
    recorder: Option<Arc<Recorder>>,
    line: Mutex<Line>,
}

struct Line {
    sender: SyncSender<FeedItem>,
    /// Dropped since the last scan that found room, and in all.
    dropped: [u64; 2],
}

impl FeedInput {
    /// An intake and the end of its queue; `scans` may wait.
    pub(crate) fn new(scans: usize, recorder: Option<Arc<Recorder>>) -> (Self, Receiver<FeedItem>) {
        let (sender, receiver) = sync_channel(scans.div_ceil(BATCH).max(1));
        (
            Self {
                recorder,
                line: Mutex::new(Line {
                    sender,
                    dropped: [0; 2],
                }),
            },
            receiver,
        )
    }

    /// Takes scans; false when the tracker is gone.
    ///
    /// # Errors
    /// When the disk does not take them.
    pub(crate) fn scans(&self, readings: Vec<FbgReading>) -> Result<bool, AcquisitionError> {
        let mut line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        let mut taken = Vec::with_capacity(readings.len());
        for reading in readings {
            // A scan that the recording lacks is not tracked either, or a replay would differ.
            if self
                .recorder
                .as_ref()
                .map_or(Ok(true), |recorder| recorder.scan(&reading))?
            {
                taken.push(reading);
            }
        }
        for batch in taken.chunks(BATCH) {
            // Waiting for room would let the device's own buffer run over.
            match line
                .sender
                .try_send(FeedItem::Scans(batch.to_vec(), line.dropped[0]))
            {
                Ok(()) => line.dropped[0] = 0,
                Err(TrySendError::Full(_)) => {
                    line.dropped = line.dropped.map(|n| n + batch.len() as u64)
                }
                Err(TrySendError::Disconnected(_)) => return Ok(false),
            }
        }
        Ok(true)
    }

    /// Takes a position of the stage. A full queue drops it: the rows then have no pose of the
    /// base.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub(crate) fn stage(
        &self,
        position: StagePosition,
        reading: &wcal_core::device::StageReading,
    ) -> Result<(), AcquisitionError> {
        let line = self.line.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(recorder) = &self.recorder {
            recorder.stage(reading)?;
        }
        let _ = line.sender.try_send(FeedItem::Stage(position));
        Ok(())
    }

    /// Tells the tracker that the source failed; waits for room.
    pub(crate) fn fail(&self, error: DeviceError) {
        let sender = self
            .line
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .sender
            .clone();
        // Nobody listens any more: then nobody needs to know.
        let _ = sender.send(FeedItem::Failed(error));
    }

    /// Scans dropped so far.
    pub(crate) fn dropped(&self) -> u64 {
        self.line
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .dropped[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scans(from: u64, count: u64) -> Vec<FbgReading> {
        (from..from + count)
            .map(|serial| FbgReading {
                serial,
                ..FbgReading::default()
            })
            .collect()
    }

    #[test]
    fn a_full_queue_drops_counts_and_says_where() {
        let (intake, receiver) = FeedInput::new(100, None);
        // Room for two batches: the third and fourth are dropped.
        assert!(intake.scans(scans(0, 200)).unwrap());
        assert_eq!(intake.dropped(), 100);
        let next = || match receiver.try_recv() {
            Ok(FeedItem::Scans(scans, dropped)) => Some((scans[0].serial, scans.len(), dropped)),
            _ => None,
        };
        assert_eq!(
            (next(), next(), next()),
            (Some((0, 50, 0)), Some((50, 50, 0)), None)
        );
        intake.scans(scans(200, 50)).unwrap();
        assert_eq!(
            next(),
            Some((200, 50, 100)),
            "the gap is reported with the first scan after it"
        );
        intake.scans(scans(250, 50)).unwrap();
        assert_eq!(next(), Some((250, 50, 0)));
        // Control: with room nothing is dropped.
        let (roomy, _receiver) = FeedInput::new(10_000, None);
        roomy.scans(scans(0, 200)).unwrap();
        assert_eq!(roomy.dropped(), 0);
    }
    /// Without the guard nobody heard of it, and the track waited for a thread that was gone.
    #[test]
    fn a_panic_of_the_thread_that_reads_is_told() {
        let heard = |panics: bool| {
            let (intake, receiver) = FeedInput::new(10, None);
            let reads = || {
                let _watched = wcal_acquisition::sweep::Watched(|e| intake.fail(e));
                assert!(!panics, "a driver that fails");
            };
            let _ = std::thread::scope(|scope| scope.spawn(reads).join());
            matches!(receiver.try_recv(), Ok(FeedItem::Failed(_)))
        };
        // Control: a thread that ends tells nothing.
        assert!(heard(true) && !heard(false));
    }
}
