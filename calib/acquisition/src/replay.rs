//! Reads recordings back, whole or cut off by a crash, without loading the file into memory.

use crate::error::AcquisitionError;
use crate::message::{
    CompressedImage, FrameInfo, RecordedMessage, Scan, StagePosition, SweepEvent, judge_timestamp, topic,
};
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use prost::Message as _;
use std::collections::HashMap;
use std::fmt;
use std::io::Read;
use std::path::Path;
use wcal_core::ranges::OutOfRange;
use wcal_core::text::brief;

/// One message of a recording.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A scan.
    Scan(Scan),
    /// A stage reading.
    Stage(StagePosition),
    /// An event of the sweep.
    Event(SweepEvent),
    /// A frame of a camera, without its pixels.
    Frame(FrameInfo),
    /// The picture of a settled pose: name of the camera, host time (ns), PNG.
    PosePicture(String, u64, Vec<u8>),
    /// A picture for people: name of the camera, host time, start of exposure by the camera's clock, s.
    Picture(String, f64, f64),
    /// Anything else: topic and host time, s.
    Other(String, f64),
}

/// End of a recording, and its unreadable parts.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct End {
    /// Why reading stopped before the end of the file; everything before was given.
    pub cut_off: Option<String>,
    /// Chunks that were left out: their checksum is wrong, or their content makes no sense.
    pub damaged_chunks: u64,
}

impl End {
    /// Closed properly, and all of it read.
    pub fn is_whole(&self) -> bool {
        *self == Self::default()
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.damaged_chunks, &self.cut_off) {
            (0, None) => write!(f, "closed"),
            (0, Some(why)) => write!(f, "cut off ({why})"),
            (n, None) => write!(f, "{n} damaged chunks left out"),
            (n, Some(why)) => write!(f, "{n} damaged chunks left out, then cut off ({why})"),
        }
    }
}

/// Longest record that is read, bytes: a chunk of this program has half a megabyte, or one picture. A longer one is a damaged length.
const MAX_RECORD_BYTES: u64 = 256 << 20;

/// Passes every message in file order to `take`. A chunk with a wrong checksum is left out whole; at a wrong length the rest
/// cannot be found and reading stops. Neither is an error: the result states what was lost.
///
/// # Errors
/// When the file cannot be opened, is no MCAP file, is compressed, or holds a message that cannot be decoded.
pub fn read(path: &Path, mut take: impl FnMut(Message)) -> Result<End, AcquisitionError> {
    let mut file = wcal_core::files::open(path).map_err(AcquisitionError::io("opening", path))?;
    let size = file.metadata().map_err(AcquisitionError::io("opening", path))?.len();
    // No record is longer than its file, whatever length it states.
    let limit = usize::try_from(size.min(MAX_RECORD_BYTES)).unwrap_or(usize::MAX);
    let options = LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(limit);
    let mut reader = LinearReader::new_with_options(options);
    let (mut end, mut topics) = (End::default(), Topics::default());
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let count = file.read(reader.insert(need)).map_err(AcquisitionError::io("reading", path))?;
                reader.notify_read(count);
            }
            Ok(LinearReadEvent::Record { opcode: op::CHUNK, data }) => {
                let Ok(Record::Chunk { header, data }) = parse_record(op::CHUNK, data) else {
                    end.damaged_chunks += 1;
                    continue;
                };
                if ["zstd", "lz4"].contains(&header.compression.as_str()) {
                    let expected = "chunks without compression, as wcal records them";
                    return Err(AcquisitionError::input(
                        path.display().to_string(),
                        expected,
                        header.compression,
                    ));
                }
                // A chunk is checked before any of its messages is given: a wrong bit must not pass as data.
                let records =
                    records(&data, header.uncompressed_crc).filter(|_| header.compression.is_empty());
                let mut whole = records.is_some();
                for (opcode, body) in records.into_iter().flatten() {
                    whole &= topics.give(path, opcode, body, &mut take)?;
                }
                end.damaged_chunks += u64::from(!whole);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                end.damaged_chunks += u64::from(!topics.give(path, opcode, data, &mut take)?);
            }
            // A recorder that was killed before its first flush leaves an empty file, no other bytes.
            Err(mcap::McapError::BadMagic) if !begins_like_mcap(path)? => {
                return Err(AcquisitionError::input(
                    path.display().to_string(),
                    "an MCAP file",
                    "other bytes",
                ));
            }
            Err(e) => {
                end.cut_off = Some(e.to_string());
                break;
            }
        }
    }
    Ok(end)
}

/// Operation code and body of each record of a chunk; none where it is damaged.
fn records(mut rest: &[u8], checksum: u32) -> Option<Vec<(u8, &[u8])>> {
    // 0: the writer made no checksum.
    if checksum != 0 && checksum != crc32fast::hash(rest) {
        return None;
    }
    let mut records = Vec::new();
    while !rest.is_empty() {
        let (head, behind) = rest.split_at_checked(9)?;
        let length = u64::from_le_bytes(head[1..].try_into().ok()?);
        let (body, behind) = behind.split_at_checked(usize::try_from(length).ok()?)?;
        records.push((head[0], body));
        rest = behind;
    }
    Some(records)
}

/// Topics of the channels seen so far.
#[derive(Default)]
struct Topics(HashMap<u16, String>);

impl Topics {
    /// Notes a channel, or gives a message to `take`; false where the record is neither whole nor of a known channel (its channel stood in
    /// a damaged chunk).
    fn give(
        &mut self,
        path: &Path,
        opcode: u8,
        body: &[u8],
        take: &mut impl FnMut(Message),
    ) -> Result<bool, AcquisitionError> {
        // Of others nothing is read.
        if ![op::CHANNEL, op::MESSAGE].contains(&opcode) {
            return Ok(true);
        }
        match parse_record(opcode, body) {
            Ok(Record::Channel(channel)) => {
                self.0.insert(channel.id, channel.topic);
                Ok(true)
            }
            Ok(Record::Message { header, data }) => match self.0.get(&header.channel_id) {
                Some(topic) => {
                    take(decode(path, topic, header.log_time, &data)?);
                    Ok(true)
                }
                None => Ok(false),
            },
            _ => Ok(false),
        }
    }
}

/// Whether as much of the magic bytes is there as the file's length allows.
fn begins_like_mcap(path: &Path) -> Result<bool, AcquisitionError> {
    let mut start = Vec::new();
    let file = wcal_core::files::open(path).map_err(AcquisitionError::io("opening", path))?;
    let size = mcap::MAGIC.len();
    file.take(size as u64).read_to_end(&mut start).map_err(AcquisitionError::io("reading", path))?;
    Ok(mcap::MAGIC.starts_with(&start))
}

/// Why a message is none: its bytes, or a number in it.
enum BadMessage {
    Bytes(prost::DecodeError),
    Number(OutOfRange),
}

impl From<prost::DecodeError> for BadMessage {
    fn from(error: prost::DecodeError) -> Self {
        Self::Bytes(error)
    }
}

impl From<OutOfRange> for BadMessage {
    fn from(error: OutOfRange) -> Self {
        Self::Number(error)
    }
}

/// A message whose numbers are in their ranges.
fn checked<M: RecordedMessage>(bytes: &[u8]) -> Result<M, BadMessage> {
    let message = M::decode(bytes)?;
    message.check()?;
    Ok(message)
}

fn decode(path: &Path, topic: &str, log_time: u64, bytes: &[u8]) -> Result<Message, AcquisitionError> {
    let bad = |e: BadMessage| {
        let place = format!("{}: {}", path.display(), brief(topic));
        match e {
            BadMessage::Bytes(e) => AcquisitionError::input(place, "a message of its schema", e.to_string()),
            BadMessage::Number(e) => {
                AcquisitionError::input(format!("{place}: {}", e.key), e.expected, e.found)
            }
        }
    };
    Ok(match topic {
        topic::SCAN => Message::Scan(checked(bytes).map_err(bad)?),
        topic::STAGE => Message::Stage(checked(bytes).map_err(bad)?),
        topic::EVENT => Message::Event(checked(bytes).map_err(bad)?),
        topic::FRAME => Message::Frame(checked(bytes).map_err(bad)?),
        other => {
            let host_s = log_time as f64 * 1e-9;
            if let Some(name) = other.strip_prefix(topic::POSE_PICTURE) {
                let picture = CompressedImage::decode(bytes).map_err(|e| bad(e.into()))?;
                return Ok(Message::PosePicture(name.to_owned(), log_time, picture.data));
            }
            match other.strip_prefix(topic::CAMERA) {
                Some(name) => {
                    let at =
                        PictureTime::decode(bytes).map_err(|e| bad(e.into()))?.timestamp.unwrap_or_default();
                    let at_s = at.seconds as f64 + f64::from(at.nanos) * 1e-9;
                    judge_timestamp(at_s).map_err(|e| bad(e.into()))?;
                    Message::Picture(name.to_owned(), host_s, at_s)
                }
                None => Message::Other(other.to_owned(), host_s),
            }
        }
    })
}

/// The time stamp of a `foxglove.CompressedImage`, or of the `foxglove.RawImage` of older recordings; pixels are passed over.
#[derive(Clone, PartialEq, prost::Message)]
struct PictureTime {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<prost_types::Timestamp>,
}

/// Steps that a recording has completed; a sweep that is resumed leaves them out.
///
/// # Errors
/// As for [`read`].
pub fn completed_steps(path: &Path) -> Result<Vec<u32>, AcquisitionError> {
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
