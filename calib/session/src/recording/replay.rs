//! Reads recordings back, whole or cut off by a crash, without loading the file into memory.

use super::error::RecordingError;
use super::message::{Scan, StagePosition, SweepEvent, topic};
use mcap::sans_io::linear_reader::LinearReaderOptions;
use mcap::sans_io::message_reader::{MessageReadEvent, MessageReader};
use prost::Message as _;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// One message of a recording.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A scan.
    Scan(Scan),
    /// A stage reading.
    Stage(StagePosition),
    /// An event of the sweep.
    Event(SweepEvent),
    /// A picture: name of the camera, host time, start of exposure by the camera's clock, s.
    Picture(String, f64, f64),
    /// Anything else: topic and host time, s.
    Other(String, f64),
}

/// How a recording ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum End {
    /// Closed properly.
    Closed,
    /// Cut off; everything before was given.
    CutOff(String),
}

/// Gives every message in file order to `take`.
///
/// # Errors
/// When the file cannot be opened, is no MCAP file, or holds a message that cannot be decoded.
pub fn read(path: &Path, mut take: impl FnMut(Message)) -> Result<End, RecordingError> {
    let mut file = File::open(path).map_err(RecordingError::io("opening", path))?;
    // A chunk is checked before any of its messages is given: a wrong bit must not pass as data.
    let mut reader =
        MessageReader::new_with_options(LinearReaderOptions::default().with_prevalidate_chunk_crcs(true));
    while let Some(event) = reader.next_event() {
        match event {
            Ok(MessageReadEvent::ReadRequest(need)) => {
                let count = file.read(reader.insert(need)).map_err(RecordingError::io("reading", path))?;
                reader.notify_read(count);
            }
            Ok(MessageReadEvent::Message(message)) => {
                take(decode(path, &message)?);
            }
            // A recorder that was killed before its first flush leaves an empty file, no other bytes.
            Err(mcap::McapError::BadMagic) if !begins_like_mcap(path)? => {
                return Err(RecordingError::input(path.display().to_string(), "an MCAP file", "other bytes"));
            }
            Err(e) => return Ok(End::CutOff(e.to_string())),
        }
    }
    Ok(End::Closed)
}

/// Whether as much of the magic bytes is there as the file's length allows.
fn begins_like_mcap(path: &Path) -> Result<bool, RecordingError> {
    let mut start = Vec::new();
    let file = File::open(path).map_err(RecordingError::io("opening", path))?;
    let size = mcap::MAGIC.len();
    file.take(size as u64).read_to_end(&mut start).map_err(RecordingError::io("reading", path))?;
    Ok(mcap::MAGIC.starts_with(&start))
}

fn decode(path: &Path, message: &mcap::Message<'_>) -> Result<Message, RecordingError> {
    let topic = message.channel.topic.as_str();
    let bytes = &*message.data;
    let bad = |e: prost::DecodeError| {
        RecordingError::input(
            format!("{}: {topic}", path.display()),
            "a message of its schema",
            e.to_string(),
        )
    };
    Ok(match topic {
        topic::SCAN => Message::Scan(Scan::decode(bytes).map_err(bad)?),
        topic::STAGE => Message::Stage(StagePosition::decode(bytes).map_err(bad)?),
        topic::EVENT => Message::Event(SweepEvent::decode(bytes).map_err(bad)?),
        other => {
            let host_s = message.log_time as f64 * 1e-9;
            match other.strip_prefix(topic::CAMERA) {
                Some(name) => {
                    let at = PictureTime::decode(bytes).map_err(bad)?.timestamp.unwrap_or_default();
                    Message::Picture(name.to_owned(), host_s, at.seconds as f64 + f64::from(at.nanos) * 1e-9)
                }
                None => Message::Other(other.to_owned(), host_s),
            }
        }
    })
}

/// The time stamp of a `foxglove.RawImage`; its pixels are passed over.
#[derive(Clone, PartialEq, prost::Message)]
struct PictureTime {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<prost_types::Timestamp>,
}

/// Steps that a recording has completed; a sweep that is resumed leaves them out.
///
/// # Errors
/// As for [`read`].
pub fn completed_steps(path: &Path) -> Result<Vec<u32>, RecordingError> {
    let mut done = Vec::new();
    read(path, |message| {
        if let Message::Event(event) = message
            && event.kind == "done"
        {
            done.push(event.step);
        }
    })?;
    Ok(done)
}
