//! Writes `recording.mcap`: chunks with CRC, on disk within a fraction of a second.

use crate::error::AcquisitionError;
use crate::message::{FrameInfo, McapMessage, Scan, StagePosition, SweepEvent, nanoseconds, topic};
use crate::pictures::{lossless, preview};
use foxglove::messages::{CompressedImage, Log, Pose, PoseInFrame, Quaternion, Timestamp, log::Level};
use foxglove::{
    Channel, ChannelBuilder, Context, McapWriteOptions, McapWriterHandle, PartialMetadata, RawChannel,
    WebSocketServer, WebSocketServerHandle,
};
use nalgebra::Vector3;
use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::BufWriter;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use wcal_core::device::{CameraFrame, FbgReading, StageReading};

/// Longest time that a message stays in memory: kill -9 loses less than this.
const FLUSH: Duration = Duration::from_millis(250);
/// Longest time until the disk itself has it.
const SYNC: Duration = Duration::from_secs(2);

/// What a frame is recorded for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FramePurpose {
    /// Its time alone.
    Nothing,
    /// The settled pose of a step.
    Pose(u32),
    /// The calibration board in an attitude.
    Board(u32),
}

/// An open recording. Messages may come from several threads.
pub struct Recorder {
    context: Arc<Context>,
    /// None where there is only a live view.
    file: Option<(McapWriterHandle<BufWriter<File>>, File)>,
    scans: Arc<RawChannel>,
    stage: Arc<RawChannel>,
    events: Arc<RawChannel>,
    frames: Arc<RawChannel>,
    log: Channel<Log>,
    groove: Channel<PoseInFrame>,
    images: Mutex<HashMap<String, Channel<CompressedImage>>>,
    pace: Mutex<Pace>,
    path: PathBuf,
    /// The first failure to write: those after it only say that there was one.
    failed: OnceLock<String>,
}

/// A WebSocket server of the Foxglove protocol; ends when dropped.
pub struct LiveView {
    address: SocketAddr,
    server: Option<WebSocketServerHandle>,
}

impl LiveView {
    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for LiveView {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            // Clients see the end of the connection; nothing is awaited.
            drop(server.stop());
        }
    }
}

struct Pace {
    flushed: Instant,
    synced: Instant,
}

pub(crate) fn timestamp(seconds: f64) -> Option<Timestamp> {
    let nanos = nanoseconds(seconds);
    Timestamp::new_checked((nanos / 1_000_000_000) as u32, (nanos % 1_000_000_000) as u32)
}

pub(crate) fn at(seconds: f64) -> PartialMetadata {
    PartialMetadata { log_time: Some(nanoseconds(seconds)) }
}

impl Recorder {
    /// Creates the file; it must not exist. `about` is written to it as metadata (devices, plan, program).
    ///
    /// # Errors
    /// When the file exists or cannot be written.
    pub fn create(path: &Path, about: BTreeMap<String, String>) -> Result<Self, AcquisitionError> {
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(path)
            .map_err(AcquisitionError::io("creating", path))?;
        let copy = file.try_clone().map_err(AcquisitionError::io("creating", path))?;
        let context = Context::new();
        // Uncompressed: 2 kHz are some 0.2 MB/s, and no C library is needed to read them.
        let options =
            McapWriteOptions::new().chunk_size(Some(512 * 1024)).compression(None).calculate_chunk_crcs(true);
        let failed = |e| not_written(path, &e);
        let writer =
            context.mcap_writer_with_options(options).create(BufWriter::new(file)).map_err(failed)?;
        writer.write_metadata("wcal", about).map_err(failed)?;
        let recorder = Self::on(context, Some((writer, copy)), path)?;
        recorder.flush()?;
        Ok(recorder)
    }

    fn on(
        context: Arc<Context>,
        file: Option<(McapWriterHandle<BufWriter<File>>, File)>,
        path: &Path,
    ) -> Result<Self, AcquisitionError> {
        let now = Instant::now();
        Ok(Self {
            scans: raw::<Scan>(&context, topic::SCAN)?,
            stage: raw::<StagePosition>(&context, topic::STAGE)?,
            events: raw::<SweepEvent>(&context, topic::EVENT)?,
            frames: raw::<FrameInfo>(&context, topic::FRAME)?,
            log: ChannelBuilder::new(topic::LOG).context(&context).build(),
            groove: ChannelBuilder::new(topic::GROOVE).context(&context).build(),
            images: Mutex::new(HashMap::new()),
            pace: Mutex::new(Pace { flushed: now, synced: now }),
            context,
            file,
            path: path.to_owned(),
            failed: OnceLock::new(),
        })
    }

    /// Shows everything that is recorded from now on to Foxglove clients at `address` (port 0: one of the system's choice). A client
    /// that is too slow misses messages; the recording does not.
    ///
    /// # Errors
    /// When the address cannot be used.
    pub fn serve(&self, address: SocketAddr) -> Result<LiveView, AcquisitionError> {
        let server = WebSocketServer::new().name("wcal").context(&self.context);
        let bound = server.bind(address.ip().to_string(), address.port()).start_blocking();
        let server = bound.map_err(|e| {
            AcquisitionError::input(
                format!("live view at {address}"),
                "a free address of this machine",
                e.to_string(),
            )
        })?;
        Ok(LiveView { address: SocketAddr::new(address.ip(), server.port()), server: Some(server) })
    }

    /// Records a scan.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn scan(&self, reading: &FbgReading) -> Result<(), AcquisitionError> {
        log_raw(&self.scans, &Scan::from(reading), reading.clocks.host_s);
        self.keep_pace()
    }

    /// Records a stage reading.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn stage(&self, reading: &StageReading) -> Result<(), AcquisitionError> {
        log_raw(&self.stage, &StagePosition::from(reading), reading.clocks.host_s);
        self.keep_pace()
    }

    /// Records where the groove is, base frame, mm (stored in metres as Foxglove wants).
    pub fn groove(&self, host_s: f64, position_mm: &Vector3<f64>) {
        let p = position_mm / 1000.0;
        let pose = Pose {
            position: Some(foxglove::messages::Vector3 { x: p.x, y: p.y, z: p.z }),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        };
        let message =
            PoseInFrame { timestamp: timestamp(host_s), frame_id: "base".to_owned(), pose: Some(pose) };
        self.groove.log_with_meta(&message, at(host_s));
    }

    /// Records an event of the sweep, at once on disk.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn event(&self, host_s: f64, event: &SweepEvent) -> Result<(), AcquisitionError> {
        log_raw(&self.events, event, host_s);
        self.flush()
    }

    /// Records a line of text.
    pub fn text(&self, host_s: f64, level: Level, text: &str) {
        let message = Log {
            timestamp: timestamp(host_s),
            level: level as i32,
            message: text.to_owned(),
            name: "wcal".to_owned(),
            ..Default::default()
        };
        self.log.log_with_meta(&message, at(host_s));
    }

    /// Records the arrival of a frame and, where it shows a settled pose or the board, the picture without loss.
    ///
    /// # Errors
    /// When the frame cannot be stored or the disk does not take it.
    pub fn frame(
        &self,
        name: &str,
        frame: &CameraFrame,
        shows: FramePurpose,
    ) -> Result<(), AcquisitionError> {
        let (step, board) = match shows {
            FramePurpose::Nothing => (None, None),
            FramePurpose::Pose(step) => (Some(step), None),
            FramePurpose::Board(view) => (None, Some(view)),
        };
        let info = FrameInfo {
            camera: name.to_owned(),
            trigger: frame.trigger,
            host_s: frame.clocks.host_s,
            device_s: frame.clocks.device_s,
            exposure_s: frame.measured_exposure_ms.or(frame.commanded_exposure_ms).map(|ms| ms * 1e-3),
            step,
            board,
        };
        log_raw(&self.frames, &info, frame.clocks.host_s);
        if shows != FramePurpose::Nothing {
            self.picture(&format!("{}{name}", topic::POSE_PICTURE), name, frame, "png", lossless(frame)?);
        }
        self.keep_pace()
    }

    /// Records a small picture for people under `/camera/NAME`.
    ///
    /// # Errors
    /// When the frame cannot be stored or the disk does not take it.
    pub fn preview(&self, name: &str, frame: &CameraFrame) -> Result<(), AcquisitionError> {
        self.picture(&format!("{}{name}", topic::CAMERA), name, frame, "jpeg", preview(frame)?);
        self.keep_pace()
    }

    fn picture(&self, topic: &str, name: &str, frame: &CameraFrame, format: &str, data: Vec<u8>) {
        let mut images = self.images.lock().unwrap_or_else(PoisonError::into_inner);
        let channel = images
            .entry(topic.to_owned())
            .or_insert_with(|| ChannelBuilder::new(topic).context(&self.context).build());
        let message = CompressedImage {
            timestamp: timestamp(frame.clocks.device_s.unwrap_or(frame.clocks.host_s)),
            frame_id: name.to_owned(),
            data: data.into(),
            format: format.to_owned(),
        };
        channel.log_with_meta(&message, at(frame.clocks.host_s));
    }

    /// Closes the file with its index.
    ///
    /// # Errors
    /// When the disk does not take it; what was flushed before stays readable.
    pub fn finish(self) -> Result<(), AcquisitionError> {
        let Some((writer, file)) = self.file else { return Ok(()) };
        let failed = |e: &dyn std::error::Error| first_failure(&self.path, &self.failed, e);
        writer.close().map_err(|e| failed(&e))?;
        file.sync_all().map_err(|e| failed(&e))
    }

    /// Writes everything so far to the file.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn flush(&self) -> Result<(), AcquisitionError> {
        self.file.as_ref().map_or(Ok(()), |(writer, _)| {
            writer.flush().map_err(|e| first_failure(&self.path, &self.failed, &e))
        })
    }

    fn keep_pace(&self) -> Result<(), AcquisitionError> {
        let now = Instant::now();
        let sync = {
            let mut pace = self.pace.lock().unwrap_or_else(PoisonError::into_inner);
            if now - pace.flushed < FLUSH {
                return Ok(());
            }
            pace.flushed = now;
            let sync = now - pace.synced >= SYNC;
            if sync {
                pace.synced = now;
            }
            sync
        };
        self.flush()?;
        match &self.file {
            Some((_, file)) if sync => {
                file.sync_data().map_err(|e| first_failure(&self.path, &self.failed, &e))
            }
            _ => Ok(()),
        }
    }
}

pub(crate) fn raw<M: McapMessage>(
    context: &Arc<Context>,
    topic: &str,
) -> Result<Arc<RawChannel>, AcquisitionError> {
    ChannelBuilder::new(topic)
        .context(context)
        .message_encoding("protobuf")
        .schema(M::schema())
        .build_raw()
        .map_err(broken)
}

pub(crate) fn log_raw<M: McapMessage>(channel: &RawChannel, message: &M, host_s: f64) {
    channel.log_with_meta(&message.encode_to_vec(), at(host_s));
}

fn first_failure(path: &Path, first: &OnceLock<String>, error: &dyn std::error::Error) -> AcquisitionError {
    AcquisitionError::Recorder(first.get_or_init(|| why(path, error)).clone())
}

/// Which file was not written, and why: a full disk says so in its own words.
fn why(path: &Path, error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |e| e.source()).map(ToString::to_string);
    format!("{}: {}", path.display(), causes.collect::<Vec<_>>().join(": "))
}

fn not_written(path: &Path, error: &dyn std::error::Error) -> AcquisitionError {
    AcquisitionError::Recorder(why(path, error))
}

fn broken(error: foxglove::FoxgloveError) -> AcquisitionError {
    AcquisitionError::Recorder(error.to_string())
}
