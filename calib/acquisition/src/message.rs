//! Messages of a recording, as protobuf with their schemas (`proto/`): readable by Foxglove, Rerun
//! and any MCAP reader.

use prost::{Message, Name};
use prost_types::Timestamp;
use std::fmt::Display;
use wcal_core::device::{Clocks, FbgReading, InterrogatorHealth, StageReading};
use wcal_core::ranges::{OutOfRange, Range};
use wcal_core::text::brief;

/// Messages of this program.
#[allow(unreachable_pub, reason = "generated")]
mod wcal {
    include!(concat!(env!("OUT_DIR"), "/wcal.rs"));
}

/// Messages of Foxglove.
#[allow(unreachable_pub, reason = "generated")]
mod foxglove {
    include!(concat!(env!("OUT_DIR"), "/foxglove.rs"));
}

pub(crate) use foxglove::CompressedImage;
pub use foxglove::Log;
pub(crate) use wcal::FrameInfo;
pub use wcal::{Scan, StagePosition, SweepEvent};

/// An encoded `FileDescriptorSet` of each package.
const SCHEMAS: [(&str, &[u8]); 2] = [
    (
        "wcal",
        include_bytes!(concat!(env!("OUT_DIR"), "/wcal.bin")),
    ),
    (
        "foxglove",
        include_bytes!(concat!(env!("OUT_DIR"), "/foxglove.bin")),
    ),
];

/// Topics of a recording.
pub mod topic {
    /// Every scan of the interrogator.
    pub(crate) const SCAN: &str = "/fbg/scan";
    /// Every reading of the stage.
    pub const STAGE: &str = "/stage/position";
    /// What the sweep did, and when.
    pub(crate) const EVENT: &str = "/sweep/event";
    /// Text for people (`foxglove.Log`).
    pub const LOG: &str = "/log";
    /// Every frame of every camera, without its pixels.
    pub(crate) const FRAME: &str = "/camera-frame";
    /// Small pictures now and then (`foxglove.CompressedImage`): followed by the camera's name.
    pub(crate) const CAMERA: &str = "/camera/";
    /// Pictures of the settled poses without loss (`foxglove.CompressedImage`, PNG): followed by
    /// the camera's name.
    pub(crate) const POSE_PICTURE: &str = "/pose-picture/";
}

/// Time as a recording has it.
pub(crate) fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9) as u64
}

/// A time; in seconds it still distinguishes microseconds.
fn time(field: &'static str, value_s: f64) -> Result<(), OutOfRange> {
    Range::real(field, -1e10, 1e10).judge_own(value_s)
}

/// A place, mm, or a wavelength, nm.
fn place(field: &'static str, value: f64) -> Result<(), OutOfRange> {
    Range::real(field, -1e6, 1e6).judge_own(value)
}

fn amount(field: &'static str, value: f64, most: f64) -> Result<(), OutOfRange> {
    Range::real(field, 0.0, most).judge_own(value)
}

/// A whole number, which is exact as a float.
fn count(field: &'static str, value: f64, most: f64) -> Result<(), OutOfRange> {
    Range::whole(field, 0.0, most).judge_own(value)
}

/// Time of a picture, s.
///
/// # Errors
/// Where no clock can have it.
pub(crate) fn picture_time_s(timestamp: Option<Timestamp>) -> Result<f64, OutOfRange> {
    let at = timestamp.unwrap_or_default();
    let at_s = at.seconds as f64 + f64::from(at.nanos) * 1e-9;
    time("timestamp", at_s).map(|()| at_s)
}

/// Messages that were left out, each alone: their bytes or a number in them are none that a device
/// can have meant.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Refused {
    count: u64,
    first: Option<String>,
}

impl Refused {
    /// Counts a message of a topic.
    pub(crate) fn add(&mut self, topic: &str, why: impl Display) {
        self.count += 1;
        self.first
            .get_or_insert_with(|| format!("{}: {why}", brief(topic)));
    }

    /// Counts those of another recording.
    pub(crate) fn join(&mut self, other: Self) {
        self.count += other.count;
        self.first = self.first.take().or(other.first);
    }

    /// In words; none where there are none.
    pub fn text(&self) -> Option<String> {
        let (count, first) = (self.count, self.first.as_ref()?);
        Some(format!(
            "{count} messages that make no sense left out; the first: {first}"
        ))
    }
}

/// A time as Foxglove's messages state it.
pub(crate) fn stamp(seconds: f64) -> Timestamp {
    let nanos = nanoseconds(seconds);
    Timestamp {
        seconds: (nanos / 1_000_000_000) as i64,
        nanos: (nanos % 1_000_000_000) as i32,
    }
}

/// A message whose numbers are judged: before it is written, and before anything is made of what
/// was read.
pub trait RecordedMessage: Message + Name + Default {
    /// Self-contained schema of its package: an encoded `FileDescriptorSet`.
    fn schema() -> &'static [u8] {
        let mut all = SCHEMAS.iter();
        let own = all.find(|(package, _)| *package == Self::PACKAGE);
        own.map_or(&[], |(_, set)| set)
    }
    /// Holds every number against what its field may have.
    ///
    /// # Errors
    /// The first number out of its range.
    fn check(&self) -> Result<(), OutOfRange>;
}

impl RecordedMessage for Scan {
    fn check(&self) -> Result<(), OutOfRange> {
        count("serial", self.serial as f64, 9e15)?;
        time("host_s", self.host_s)?;
        time("device_s", self.device_s)?;
        count("channels", self.peaks_per_channel.len() as f64, 1024.0)?;
        // Six fault bits, in the order of `From<&FbgReading>`.
        count("health", self.health.into(), 63.0)?;
        count("error_code", self.error_code.into(), 255.0)?;
        count("buffer_percent", self.buffer_percent.into(), 255.0)?;
        for peaks in &self.peaks_per_channel {
            count("peaks_per_channel", (*peaks).into(), 65_536.0)?;
        }
        // NaN is what a unit sends in place of a peak that it does not have.
        let mut peaks = self.peaks_nm.iter().filter(|nm| !nm.is_nan());
        peaks.try_for_each(|nm| place("peaks_nm", *nm))
    }
}

impl From<&FbgReading> for Scan {
    fn from(reading: &FbgReading) -> Self {
        let h = &reading.health;
        let bits = [
            h.calibration_fault,
            h.fan_fault,
            h.soa_thermal,
            h.soa_current,
            h.tec_over,
            h.tec_under,
        ];
        Self {
            serial: reading.serial,
            host_s: reading.clocks.host_s,
            device_s: reading.clocks.device_s.unwrap_or(reading.clocks.host_s),
            peaks_nm: reading.peaks_nm.iter().flatten().copied().collect(),
            peaks_per_channel: reading.peaks_nm.iter().map(|c| c.len() as u32).collect(),
            health: bits
                .iter()
                .enumerate()
                .map(|(k, on)| u32::from(*on) << k)
                .sum(),
            error_code: u32::from(h.error_code),
            buffer_percent: u32::from(h.buffer_percent),
        }
    }
}

impl Scan {
    /// As a reading.
    pub fn reading(&self) -> FbgReading {
        let mut rest = &self.peaks_nm[..];
        let peaks_nm = self.peaks_per_channel.iter().map(|n| {
            let (own, others) = rest.split_at((*n as usize).min(rest.len()));
            rest = others;
            own.to_vec()
        });
        let on = |bit: u32| self.health >> bit & 1 == 1;
        FbgReading {
            serial: self.serial,
            peaks_nm: peaks_nm.collect(),
            health: InterrogatorHealth {
                calibration_fault: on(0),
                fan_fault: on(1),
                soa_thermal: on(2),
                soa_current: on(3),
                tec_over: on(4),
                tec_under: on(5),
                error_code: self.error_code as u8,
                buffer_percent: self.buffer_percent as u8,
            },
            clocks: Clocks {
                host_s: self.host_s,
                device_s: Some(self.device_s),
            },
        }
    }
}

impl RecordedMessage for StagePosition {
    fn check(&self) -> Result<(), OutOfRange> {
        time("host_s", self.host_s)?;
        place("commanded_mm", self.commanded_mm.unwrap_or(0.0))?;
        place("measured_mm", self.measured_mm)
    }
}

impl From<&StageReading> for StagePosition {
    fn from(r: &StageReading) -> Self {
        Self {
            host_s: r.clocks.host_s,
            commanded_mm: r.commanded_mm,
            measured_mm: r.measured_mm,
            moving: r.moving,
            flags: r.flags.clone(),
        }
    }
}

impl RecordedMessage for SweepEvent {
    fn check(&self) -> Result<(), OutOfRange> {
        count("step", self.step.into(), 1e8)?;
        count("trajectory", self.trajectory.into(), 4e9)?;
        count("replicate", self.replicate.into(), 1e8)?;
        place("target_mm", self.target_mm)?;
        Range::whole("direction", -1.0, 1.0).judge_own(self.direction.into())?;
        amount("speed_mm_s", self.speed_mm_s, 1e6)?;
        time("begin_s", self.begin_s)?;
        time("end_s", self.end_s)?;
        time("arrived_s", self.arrived_s)?;
        amount("rows_hz", self.rows_hz, 1e5)
    }
}

impl RecordedMessage for CompressedImage {
    fn check(&self) -> Result<(), OutOfRange> {
        picture_time_s(self.timestamp).map(drop)
    }
}

impl RecordedMessage for Log {
    fn check(&self) -> Result<(), OutOfRange> {
        Ok(())
    }
}

impl RecordedMessage for FrameInfo {
    fn check(&self) -> Result<(), OutOfRange> {
        count("trigger", self.trigger as f64, 9e15)?;
        time("host_s", self.host_s)?;
        time("device_s", self.device_s.unwrap_or(0.0))?;
        amount("exposure_s", self.exposure_s.unwrap_or(0.0), 1e4)?;
        count("step", self.step.unwrap_or(0).into(), 1e8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost_types::field_descriptor_proto::Type;
    use prost_types::{FieldDescriptorProto, FileDescriptorSet};

    /// Fields of a message as its schema states them.
    fn fields<M: RecordedMessage>() -> Vec<FieldDescriptorProto> {
        let set = FileDescriptorSet::decode(M::schema()).unwrap();
        let messages = set.file.into_iter().flat_map(|f| f.message_type);
        messages
            .into_iter()
            .find(|m| m.name() == M::NAME)
            .unwrap()
            .field
    }

    #[test]
    fn a_scan_comes_back_with_its_channels_and_faults() {
        let reading = FbgReading {
            serial: 9,
            peaks_nm: vec![vec![1535.0, 1541.0], vec![], vec![1537.5]],
            health: InterrogatorHealth {
                tec_under: true,
                error_code: 9,
                ..Default::default()
            },
            clocks: Clocks {
                host_s: 3.0,
                device_s: Some(2.5),
            },
        };
        let scan = Scan::from(&reading);
        let again = Scan::decode(&*scan.encode_to_vec()).unwrap().reading();
        assert_eq!(again, reading);
        assert!(Scan::decode(&b"\xff\xff\xff"[..]).is_err());
    }

    /// Bytes of a message with this one field, as protobuf encodes it.
    fn alone(number: i32, kind: Type, value: f64) -> Vec<u8> {
        use prost::encoding::{double, sint32, uint32, uint64};
        let (tag, mut bytes) = (number as u32, Vec::new());
        match kind {
            Type::Double => double::encode(tag, &value, &mut bytes),
            Type::Uint32 => uint32::encode(tag, &(value as u32), &mut bytes),
            Type::Uint64 => uint64::encode(tag, &(value as u64), &mut bytes),
            Type::Sint32 => sint32::encode(tag, &(value as i32), &mut bytes),
            other => panic!("{other:?} is no number"),
        }
        bytes
    }

    /// Fields that hold a number, each alone in a message with `value`: those that are taken.
    fn taken<M: RecordedMessage>(value: f64) -> Vec<String> {
        let numbers = fields::<M>()
            .into_iter()
            .filter(|f| !matches!(f.r#type(), Type::String | Type::Bool));
        let taken = numbers.filter(|f| {
            M::decode(&*alone(f.number(), f.r#type(), value))
                .unwrap()
                .check()
                .is_ok()
        });
        taken.map(|field| field.name().to_owned()).collect()
    }

    #[test]
    fn every_number_of_every_message_has_a_range() {
        for value in [1e300, f64::INFINITY] {
            let all = [
                taken::<Scan>(value),
                taken::<StagePosition>(value),
                taken::<SweepEvent>(value),
            ];
            let none: [&str; 0] = [];
            assert_eq!(all.concat(), none, "{value}");
            assert_eq!(taken::<FrameInfo>(value), none, "{value}");
        }
        for value in [-1e300, f64::NEG_INFINITY, f64::NAN] {
            // What has no sign and no NaN holds 0 then; NaN in place of a peak is the unit's.
            let doubles = |fields: Vec<String>| -> Vec<String> {
                fields
                    .into_iter()
                    .filter(|f| f.ends_with("_s") || f.ends_with("mm") || f.ends_with("hz"))
                    .collect()
            };
            let all = [
                taken::<Scan>(value),
                taken::<StagePosition>(value),
                taken::<SweepEvent>(value),
            ];
            let none: [&str; 0] = [];
            assert_eq!(doubles(all.concat()), none, "{value}");
            assert_eq!(doubles(taken::<FrameInfo>(value)), none, "{value}");
        }
        assert_eq!(
            taken::<SweepEvent>(1.0).len(),
            10,
            "negative control: numbers of a bench are taken"
        );
        assert_eq!(taken::<Scan>(1.0).len(), 8, "negative control");
    }

    #[test]
    fn the_schema_describes_what_is_encoded() {
        let set = FileDescriptorSet::decode(Scan::schema()).unwrap();
        let message = &set.file[0].message_type[0];
        assert_eq!((set.file[0].package(), message.name()), ("wcal", "Scan"));
        assert_eq!(
            (Scan::full_name().as_str(), fields::<Scan>()[6].name()),
            ("wcal.Scan", "error_code")
        );
        // A field set to a value appears under the number that the schema states.
        let bytes = Scan {
            error_code: 5,
            ..Scan::default()
        }
        .encode_to_vec();
        assert_eq!(bytes, [7 << 3, 5]);
    }

    /// Foxglove's own definition (schemas/proto/foxglove/CompressedImage.proto): time stamp 1, data
    /// 2, format 3, frame 4.
    #[test]
    fn a_picture_is_laid_out_as_foxglove_reads_it() {
        let set = FileDescriptorSet::decode(CompressedImage::schema()).unwrap();
        let [time, picture] = &set.file[..] else {
            panic!("{set:?}")
        };
        assert_eq!(picture.dependency, ["google/protobuf/timestamp.proto"]);
        assert_eq!(
            (time.name(), picture.package()),
            ("google/protobuf/timestamp.proto", "foxglove")
        );
        assert_eq!(
            picture.message_type[0].field[0].type_name(),
            ".google.protobuf.Timestamp"
        );
        let image = CompressedImage {
            timestamp: Some(stamp(2.5)),
            data: vec![7],
            format: "png".into(),
            frame_id: "l".into(),
        };
        let bytes = image.encode_to_vec();
        let expected = [
            &[10, 7, 8, 2, 16, 128, 202, 181, 238, 1][..],
            &[18, 1, 7, 26, 3],
            b"png",
            &[34, 1],
            b"l",
        ];
        let expected = expected.concat();
        assert_eq!(CompressedImage::decode(&*bytes).unwrap(), image);
        assert_eq!(&bytes[10..], &expected[10..], "{bytes:?}");
        // A message without times needs no other file.
        assert_eq!(
            FileDescriptorSet::decode(Scan::schema())
                .unwrap()
                .file
                .len(),
            1
        );
    }
}
