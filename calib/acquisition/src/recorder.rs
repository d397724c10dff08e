//! Writes `recording.mcap`: chunks with CRC, on disk within a fraction of a second.

use crate::error::AcquisitionError;
use crate::message::{
    CompressedImage, FrameInfo, Log, RecordedMessage, Refused, Scan, StagePosition, SweepEvent,
    nanoseconds, stamp, topic,
};
use crate::pictures::{exposure_s, lossless, preview};
use mcap::records::{MessageHeader, Metadata};
use mcap::{McapError, McapResult, WriteOptions, Writer};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use wcal_core::device::{CameraFrame, FbgReading, StageReading};
use wcal_core::files::FileError;

/// Longest time that a message stays in memory: kill -9 loses less than this.
const FLUSH: Duration = Duration::from_millis(250);
/// Between two syncs to the disk itself, where that is fast enough.
const SYNC: Duration = Duration::from_secs(2);

/// How much a line of text matters, by the numbers of `foxglove.Log`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Something to look at.
    Warning = 3,
    /// What ended the run.
    Error = 4,
}

/// An open recording. Messages may come from several threads.
pub struct Recorder {
    open: Mutex<Open>,
    file: File,
    path: PathBuf,
    syncing: Mutex<Option<JoinHandle<io::Result<()>>>>,
    /// The first failure to write: those after it only say that there was one.
    failed: OnceLock<String>,
}

struct Open {
    writer: Writer<BufWriter<File>>,
    /// Number of each topic's channel, and of its last message.
    channels: HashMap<String, (u16, u32)>,
    flushed: Instant,
    synced: Instant,
    refused: Refused,
}

impl Open {
    fn write<M: RecordedMessage>(
        &mut self,
        topic: &str,
        message: &M,
        host_s: f64,
    ) -> McapResult<()> {
        let writer = &mut self.writer;
        let (channel_id, sequence) = match self.channels.get(topic) {
            Some((channel, last)) => (*channel, last.wrapping_add(1)),
            None => {
                let schema = writer.add_schema(&M::full_name(), "protobuf", M::schema())?;
                let about = BTreeMap::new();
                (writer.add_channel(schema, topic, "protobuf", &about)?, 0)
            }
        };
        let own = (channel_id, sequence);
        self.channels.insert(topic.to_owned(), own);
        let time = nanoseconds(host_s);
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, &message.encode_to_vec())
    }
}

impl Recorder {
    /// Creates the file; it must not exist. `about` is written to it as metadata (devices, plan,
    /// program).
    ///
    /// # Errors
    /// When the file exists or cannot be written.
    pub fn create(path: &Path, about: BTreeMap<String, String>) -> Result<Self, AcquisitionError> {
        let io = FileError::of("creating", path);
        let file = File::create_new(path).map_err(&io)?;
        let copy = file.try_clone().map_err(io)?;
        let failed = |e: McapError| AcquisitionError::Recorder(why(path, &e));
        // Uncompressed: 2 kHz are some 0.2 MB/s, and no C library is needed to read them.
        let options = WriteOptions::new()
            .chunk_size(Some(512 * 1024))
            .compression(None)
            .calculate_chunk_crcs(true);
        let mut writer = options.create(BufWriter::new(file)).map_err(failed)?;
        writer
            .write_metadata(&Metadata {
                name: "wcal".to_owned(),
                metadata: about,
            })
            .map_err(failed)?;
        let now = Instant::now();
        let recorder = Self {
            open: Mutex::new(Open {
                writer,
                channels: HashMap::new(),
                flushed: now,
                synced: now,
                refused: Refused::default(),
            }),
            file: copy,
            path: path.to_owned(),
            syncing: Mutex::default(),
            failed: OnceLock::new(),
        };
        // The head of the file at once: a run that is killed early leaves a readable recording.
        recorder.flush()?;
        Ok(recorder)
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn failed(&self, error: &dyn std::error::Error) -> AcquisitionError {
        let first = self.failed.get_or_init(|| why(&self.path, error));
        AcquisitionError::Recorder(first.clone())
    }

    /// Records a message; false where a reader would refuse it: it is omitted and counted.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn message<M: RecordedMessage>(
        &self,
        topic: &str,
        message: &M,
        host_s: f64,
    ) -> Result<bool, AcquisitionError> {
        let mut open = self.lock();
        if let Err(why) = message.check() {
            open.refused.add(topic, why);
            return Ok(false);
        }
        open.write(topic, message, host_s)
            .map_err(|e| self.failed(&e))?;
        let now = Instant::now();
        if now - open.flushed < FLUSH {
            return Ok(true);
        }
        open.flushed = now;
        open.writer.flush().map_err(|e| self.failed(&e))?;
        if now - open.synced >= SYNC {
            open.synced = now;
            // Unlocked first: the other threads record on while the disk is busy.
            drop(open);
            self.begin_sync().map_err(|e| self.failed(&e))?;
        }
        Ok(true)
    }

    /// Messages that were left out so far.
    pub fn refused(&self) -> Refused {
        self.lock().refused.clone()
    }

    /// Sends what is in the file to the disk, beside what goes on: a busy disk takes seconds, and
    /// no device waits for it.
    fn begin_sync(&self) -> io::Result<()> {
        let mut running = self.syncing.lock().unwrap_or_else(PoisonError::into_inner);
        // One sync at a time: on a slow disk they would pile up.
        if running.as_ref().is_some_and(|sync| !sync.is_finished()) {
            return Ok(());
        }
        let file = self.file.try_clone()?;
        let ended = running.replace(std::thread::spawn(move || file.sync_data()));
        // A sync that failed is reported when the next one begins: nobody waits for it before.
        ended.and_then(|sync| sync.join().ok()).unwrap_or(Ok(()))
    }

    /// Records a scan; false as for [`Recorder::message`].
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn scan(&self, reading: &FbgReading) -> Result<bool, AcquisitionError> {
        self.message(topic::SCAN, &Scan::from(reading), reading.clocks.host_s)
    }

    /// Records a stage reading; false as for [`Recorder::message`].
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn stage(&self, reading: &StageReading) -> Result<bool, AcquisitionError> {
        self.message(
            topic::STAGE,
            &StagePosition::from(reading),
            reading.clocks.host_s,
        )
    }

    /// Records an event of the sweep, at once in the file; the disk has it when it is synced next.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn event(&self, host_s: f64, event: &SweepEvent) -> Result<(), AcquisitionError> {
        self.message(topic::EVENT, event, host_s)?;
        self.flush()
    }

    /// Records a line of text.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn text(&self, host_s: f64, level: Level, text: &str) -> Result<(), AcquisitionError> {
        let line = Log {
            timestamp: Some(stamp(host_s)),
            level: level as i32,
            message: text.to_owned(),
            name: "wcal".to_owned(),
        };
        self.message(topic::LOG, &line, host_s).map(drop)
    }

    /// Records the arrival of a frame and, where it shows the settled pose of a step, the picture
    /// without loss.
    ///
    /// # Errors
    /// When the frame cannot be stored or the disk does not take it.
    pub fn frame(
        &self,
        name: &str,
        frame: &CameraFrame,
        step: Option<u32>,
    ) -> Result<(), AcquisitionError> {
        let info = FrameInfo {
            camera: name.to_owned(),
            trigger: frame.trigger,
            host_s: frame.clocks.host_s,
            device_s: frame.clocks.device_s,
            exposure_s: exposure_s(frame),
            step,
        };
        if self.message(topic::FRAME, &info, frame.clocks.host_s)? && step.is_some() {
            self.picture(topic::POSE_PICTURE, name, frame, "png", lossless(frame)?)?;
        }
        Ok(())
    }

    /// Records a small picture for people under `/camera/NAME`.
    ///
    /// # Errors
    /// When the frame cannot be stored or the disk does not take it.
    pub fn preview(&self, name: &str, frame: &CameraFrame) -> Result<(), AcquisitionError> {
        self.picture(topic::CAMERA, name, frame, "jpeg", preview(frame)?)
    }

    fn picture(
        &self,
        topic: &str,
        name: &str,
        frame: &CameraFrame,
        format: &str,
        data: Vec<u8>,
    ) -> Result<(), AcquisitionError> {
        let image = CompressedImage {
            timestamp: Some(stamp(frame.clocks.device_s.unwrap_or(frame.clocks.host_s))),
            frame_id: name.to_owned(),
            data,
            format: format.to_owned(),
        };
        let topic = format!("{topic}{name}");
        self.message(&topic, &image, frame.clocks.host_s).map(drop)
    }

    /// Closes the file with its index.
    ///
    /// # Errors
    /// When the disk does not take it; what was flushed before stays readable.
    pub fn finish(self) -> Result<(), AcquisitionError> {
        self.lock().writer.finish().map_err(|e| self.failed(&e))?;
        self.file.sync_all().map_err(|e| self.failed(&e))
    }

    /// Writes everything so far to the file.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn flush(&self) -> Result<(), AcquisitionError> {
        self.lock().writer.flush().map_err(|e| self.failed(&e))
    }
}

/// Which file was not written, and why: a full disk says so in its own words.
fn why(path: &Path, error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |e| e.source()).map(ToString::to_string);
    let place = std::iter::once(path.display().to_string());
    place.chain(causes).collect::<Vec<_>>().join(": ")
}
