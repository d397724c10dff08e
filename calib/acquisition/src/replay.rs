//! Reads recordings back, whole or cut off by a crash, without loading the file into memory.

use crate::error::AcquisitionError;
use crate::message::{
    CompressedImage, FrameInfo, RecordedMessage, Refused, Scan, StagePosition, SweepEvent,
    nanoseconds, picture_time_s, topic,
};
use mcap::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use prost::Message as _;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::Read;
use std::path::Path;
use wcal_core::files::{FileError, open};
use wcal_core::ranges::OutOfRange;

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
    /// A picture for people: name of the camera, host time, start of exposure by the camera's
    /// clock, s.
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
    /// Messages that were left out.
    pub refused: Refused,
    /// Messages that the file holds once more; each was given once.
    pub repeated: u64,
}

impl End {
    /// Closed properly, and all of it read.
    pub fn is_whole(&self) -> bool {
        *self
            == Self {
                repeated: self.repeated,
                ..Self::default()
            }
    }
}

impl fmt::Display for End {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chunks = self.damaged_chunks;
        let damaged = (chunks > 0).then(|| format!("{chunks} damaged chunks left out"));
        let cut_off = self.cut_off.as_ref().map(|why| format!("cut off ({why})"));
        let all: Vec<String> = damaged
            .into_iter()
            .chain(self.refused.text())
            .chain(cut_off)
            .collect();
        f.write_str(
            if self.is_whole() {
                "closed".to_owned()
            } else {
                all.join(", then ")
            }
            .as_str(),
        )
    }
}

/// Longest record that is read, bytes: a chunk of this program has half a megabyte, or one picture.
/// A longer one is a damaged length.
const MAX_RECORD_BYTES: u64 = 256 << 20;

/// Passes every message in file order to `take`, each once. A chunk with a wrong checksum is
/// omitted whole, a message that makes no sense alone; at a wrong length the rest cannot be found
/// and reading stops. None is an error: the result states what was lost.
///
/// # Errors
/// When the file cannot be opened, is no MCAP file, or is compressed.
pub fn read(path: &Path, mut take: impl FnMut(Message)) -> Result<End, AcquisitionError> {
    let mut file = open(path)?;
    let size = file
        .metadata()
        .map_err(FileError::of("opening", path))?
        .len();
    // No record is longer than its file, whatever length it states.
    let limit = usize::try_from(size.min(MAX_RECORD_BYTES)).unwrap_or(usize::MAX);
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_record_length_limit(limit);
    let mut reader = LinearReader::new_with_options(options);
    let mut messages = Messages::default();
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let count = file
                    .read(reader.insert(need))
                    .map_err(FileError::of("reading", path))?;
                reader.notify_read(count);
            }
            Ok(LinearReadEvent::Record {
                opcode: op::CHUNK,
                data,
            }) => {
                let Ok(Record::Chunk { header, data }) = parse_record(op::CHUNK, data) else {
                    messages.end.damaged_chunks += 1;
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
                // A chunk is checked before any of its messages is given: a wrong bit must not pass
                // as data.
                let records = records(&data, header.uncompressed_crc)
                    .filter(|_| header.compression.is_empty());
                let mut whole = records.is_some();
                for (opcode, body) in records.into_iter().flatten() {
                    whole &= messages.give(opcode, body, &mut take);
                }
                messages.end.damaged_chunks += u64::from(!whole);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                let whole = messages.give(opcode, data, &mut take);
                messages.end.damaged_chunks += u64::from(!whole);
            }
            // A recorder that was killed before its first flush leaves an empty file, no other
            // bytes.
            Err(mcap::McapError::BadMagic) if !begins_like_mcap(path)? => {
                return Err(AcquisitionError::input(
                    path.display().to_string(),
                    "an MCAP file",
                    "other bytes",
                ));
            }
            Err(e) => {
                messages.end.cut_off = Some(e.to_string());
                break;
            }
        }
    }
    Ok(messages.end)
}

/// Operation code and body of each record of a chunk; none where it is damaged.
fn records(mut rest: &[u8], checksum: u32) -> Option<Vec<(u8, &[u8])>> {
    // 0: the writer made no checksum.
    if checksum != 0 && checksum != crc32fast::hash(rest) {
        return None;
    }
    let mut records = Vec::new();
    while !rest.is_empty() {
        // A record of MCAP: one byte of operation code, eight of length, and the body.
        let (head, behind) = rest.split_at_checked(9)?;
        let length = u64::from_le_bytes(head[1..].try_into().ok()?);
        let (body, behind) = behind.split_at_checked(usize::try_from(length).ok()?)?;
        records.push((head[0], body));
        rest = behind;
    }
    Some(records)
}

/// The messages of a file, given one by one.
#[derive(Default)]
struct Messages {
    /// Topics of the channels seen so far.
    topics: HashMap<u16, String>,
    given: Given,
    end: End,
}

impl Messages {
    /// Notes a channel, or gives a message to `take`; false where the record is neither whole nor
    /// of a known channel (its channel stood in a damaged chunk).
    fn give(&mut self, opcode: u8, body: &[u8], take: &mut impl FnMut(Message)) -> bool {
        // Of others nothing is read.
        if ![op::CHANNEL, op::MESSAGE].contains(&opcode) {
            return true;
        }
        match parse_record(opcode, body) {
            Ok(Record::Channel(channel)) => {
                self.topics.insert(channel.id, channel.topic);
            }
            Ok(Record::Message { header, data }) => {
                let Some(topic) = self.topics.get(&header.channel_id) else {
                    return false;
                };
                match decode(topic, header.log_time, &data) {
                    Err(why) => self.end.refused.add(topic, why),
                    Ok(message) if self.given.is_new(&message, (topic, header.log_time, &data)) => {
                        take(message)
                    }
                    Ok(_) => self.end.repeated += 1,
                }
            }
            _ => return false,
        }
        true
    }
}

/// What was given so far: files are merged with copies of themselves, and each message counts once.
#[derive(Default)]
struct Given {
    /// Runs of scans whose numbers follow each other: host time (ns) and number of the first, and
    /// of the last. A scan an entry would be most of the file.
    runs: BTreeMap<(u64, u64), (u64, u64)>,
    /// First of the run that grew last.
    newest: (u64, u64),
    /// Hashes of all other messages.
    others: HashSet<u64>,
}

impl Given {
    /// Whether a message (also as topic, time and bytes) was not given before; it now was.
    fn is_new(&mut self, message: &Message, bytes: (&str, u64, &[u8])) -> bool {
        let Message::Scan(scan) = message else {
            let mut hasher = DefaultHasher::new();
            bytes.hash(&mut hasher);
            return self.others.insert(hasher.finish());
        };
        // A unit that was started again counts anew, but later by the host's clock.
        let own = (nanoseconds(scan.host_s), scan.serial);
        let before = self.runs.range(..=own).next_back();
        if before.is_some_and(|(_, last)| own.0 <= last.0 && own.1 <= last.1) {
            return false;
        }
        match self.runs.get_mut(&self.newest) {
            Some(last) if last.0 <= own.0 && last.1.checked_add(1) == Some(own.1) => *last = own,
            _ => {
                self.newest = own;
                self.runs.insert(own, own);
            }
        }
        true
    }
}

/// Whether as much of the magic bytes is there as the file's length allows.
fn begins_like_mcap(path: &Path) -> Result<bool, AcquisitionError> {
    let mut start = Vec::new();
    let file = open(path)?;
    let size = mcap::MAGIC.len();
    file.take(size as u64)
        .read_to_end(&mut start)
        .map_err(FileError::of("reading", path))?;
    Ok(mcap::MAGIC.starts_with(&start))
}

/// Why a message is none: its bytes, or a number in it.
#[derive(Debug, thiserror::Error)]
enum BadMessage {
    #[error("expected a message of its schema, found {0}")]
    Bytes(#[from] prost::DecodeError),
    #[error(transparent)]
    Number(#[from] OutOfRange),
}

/// A message whose numbers are in their ranges.
fn checked<M: RecordedMessage>(bytes: &[u8]) -> Result<M, BadMessage> {
    let message = M::decode(bytes)?;
    message.check()?;
    Ok(message)
}

fn decode(topic: &str, log_time: u64, bytes: &[u8]) -> Result<Message, BadMessage> {
    let host_s = log_time as f64 * 1e-9;
    Ok(match topic {
        topic::SCAN => Message::Scan(checked(bytes)?),
        topic::STAGE => Message::Stage(checked(bytes)?),
        topic::EVENT => Message::Event(checked(bytes)?),
        topic::FRAME => Message::Frame(checked(bytes)?),
        other => match (
            other.strip_prefix(topic::POSE_PICTURE),
            other.strip_prefix(topic::CAMERA),
        ) {
            (Some(name), _) => Message::PosePicture(
                name.to_owned(),
                log_time,
                CompressedImage::decode(bytes)?.data,
            ),
            (_, Some(name)) => {
                let at_s = picture_time_s(PictureTime::decode(bytes)?.timestamp)?;
                Message::Picture(name.to_owned(), host_s, at_s)
            }
            _ => Message::Other(other.to_owned(), host_s),
        },
    })
}

/// The time stamp of a `foxglove.CompressedImage`, or of the `foxglove.RawImage` of older
/// recordings; pixels are passed over.
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
