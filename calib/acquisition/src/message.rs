//! Messages of a recording, as protobuf with an explicit schema: readable by Foxglove, Rerun and any MCAP reader.
//!
//! Field numbers are part of the format: never change or reuse one.

use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp};
use wcal_core::device::{Clocks, FbgReading, InterrogatorHealth, StageReading};
use wcal_core::ranges::{OutOfRange, Range};

/// Topics of a recording.
pub mod topic {
    /// Every scan of the interrogator.
    pub const SCAN: &str = "/fbg/scan";
    /// Every reading of the stage.
    pub const STAGE: &str = "/stage/position";
    /// What the sweep did, and when.
    pub const EVENT: &str = "/sweep/event";
    /// Text for people (`foxglove.Log`).
    pub const LOG: &str = "/log";
    /// Every frame of every camera, without its pixels.
    pub const FRAME: &str = "/camera-frame";
    /// Small pictures now and then (`foxglove.CompressedImage`): followed by the camera's name.
    pub const CAMERA: &str = "/camera/";
    /// Pictures of the settled poses without loss (`foxglove.CompressedImage`, PNG): followed by the camera's name.
    pub const POSE_PICTURE: &str = "/pose-picture/";
}

/// Time as a recording has it.
pub(crate) fn nanoseconds(seconds: f64) -> u64 {
    (seconds.max(0.0) * 1e9) as u64
}

/// Numbers that the fields of a message may have. A time in seconds still tells microseconds apart, and whole numbers are exact as floats.
mod range {
    use wcal_core::ranges::Range;

    pub(super) const HOST_S: Range = Range::real("host_s", -1e10, 1e10);
    pub(super) const DEVICE_S: Range = Range::real("device_s", -1e10, 1e10);
    pub(super) const SERIAL: Range = Range::whole("serial", 0.0, 9e15);
    pub(super) const CHANNELS: Range = Range::whole("channels", 0.0, 1024.0);
    pub(super) const PEAKS: Range = Range::whole("peaks_per_channel", 0.0, 65_536.0);
    pub(super) const PEAKS_NM: Range = Range::real("peaks_nm", -1e6, 1e6);
    pub(super) const HEALTH: Range = Range::whole("health", 0.0, 63.0);
    pub(super) const ERROR_CODE: Range = Range::whole("error_code", 0.0, 255.0);
    pub(super) const BUFFER_PERCENT: Range = Range::whole("buffer_percent", 0.0, 255.0);
    pub(super) const COMMANDED_MM: Range = Range::real("commanded_mm", -1e6, 1e6);
    pub(super) const MEASURED_MM: Range = Range::real("measured_mm", -1e6, 1e6);
    pub(super) const STEP: Range = Range::whole("step", 0.0, 1e8);
    pub(super) const TRAJECTORY: Range = Range::whole("trajectory", 0.0, 4e9);
    pub(super) const REPLICATE: Range = Range::whole("replicate", 0.0, 1e8);
    pub(super) const TARGET_MM: Range = Range::real("target_mm", -1e6, 1e6);
    pub(super) const DIRECTION: Range = Range::whole("direction", -1.0, 1.0);
    pub(super) const SPEED_MM_S: Range = Range::real("speed_mm_s", 0.0, 1e6);
    pub(super) const BEGIN_S: Range = Range::real("begin_s", -1e10, 1e10);
    pub(super) const END_S: Range = Range::real("end_s", -1e10, 1e10);
    pub(super) const ARRIVED_S: Range = Range::real("arrived_s", -1e10, 1e10);
    pub(super) const ROWS_HZ: Range = Range::real("rows_hz", 0.0, 1e5);
    pub(super) const TRIGGER: Range = Range::whole("trigger", 0.0, 9e15);
    pub(super) const EXPOSURE_S: Range = Range::real("exposure_s", 0.0, 1e4);
    pub(super) const TIMESTAMP_S: Range = Range::real("timestamp", -1e10, 1e10);
}

/// Judges numbers by the ranges of their fields.
fn judge<const N: usize>(numbers: [(Range, f64); N]) -> Result<(), OutOfRange> {
    numbers.iter().try_for_each(|(range, value)| range.judge_own(*value))
}

/// Judges the time stamp of a picture, s.
///
/// # Errors
/// Where no clock can have it.
pub(crate) fn judge_timestamp(at_s: f64) -> Result<(), OutOfRange> {
    range::TIMESTAMP_S.judge_own(at_s)
}

/// A message with its schema.
pub trait McapMessage: prost::Message + Default {
    /// Schema name.
    const NAME: &'static str;
    /// Field name, number, type and whether it repeats.
    const FIELDS: &'static [(&'static str, i32, Type, bool)];

    /// Self-contained schema: an encoded `FileDescriptorSet`.
    fn schema() -> Vec<u8> {
        let (package, short) = Self::NAME.rsplit_once('.').unwrap_or_default();
        let fields: Vec<FieldDescriptorProto> = Self::FIELDS.iter().map(field).collect();
        let mut file = file(package, short, fields);
        let mut files = Vec::new();
        if Self::FIELDS.iter().any(|f| f.2 == Type::Message) {
            let time = file_of_timestamp();
            file.dependency = vec![time.name().to_owned()];
            files.push(time);
        }
        files.push(file);
        FileDescriptorSet { file: files }.encode_to_vec()
    }
}

/// The one message inside messages, as Foxglove states times.
const TIMESTAMP: &str = ".google.protobuf.Timestamp";

fn field(&(name, number, kind, repeated): &(&str, i32, Type, bool)) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        r#type: Some(kind as i32),
        type_name: (kind == Type::Message).then(|| TIMESTAMP.to_owned()),
        label: Some(if repeated { Label::Repeated } else { Label::Optional } as i32),
        ..Default::default()
    }
}

fn file(package: &str, message: &str, field: Vec<FieldDescriptorProto>) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(format!("{package}/{message}.proto")),
        package: Some(package.to_owned()),
        syntax: Some("proto3".to_owned()),
        message_type: vec![DescriptorProto { name: Some(message.to_owned()), field, ..Default::default() }],
        ..Default::default()
    }
}

fn file_of_timestamp() -> FileDescriptorProto {
    let fields = [("seconds", 1, Type::Int64, false), ("nanos", 2, Type::Int32, false)];
    FileDescriptorProto {
        name: Some("google/protobuf/timestamp.proto".to_owned()),
        ..file("google.protobuf", "Timestamp", fields.iter().map(field).collect())
    }
}

/// A time as Foxglove's messages state it.
pub(crate) fn stamp(seconds: f64) -> Timestamp {
    let nanos = nanoseconds(seconds);
    Timestamp { seconds: (nanos / 1_000_000_000) as i64, nanos: (nanos % 1_000_000_000) as i32 }
}

/// A picture, with the field numbers of `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub struct CompressedImage {
    /// Start of exposure by the camera's clock, or arrival.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Content of a picture file.
    #[prost(bytes = "vec", tag = "2")]
    pub data: Vec<u8>,
    /// `png` or `jpeg`.
    #[prost(string, tag = "3")]
    pub format: String,
    /// Name of the camera.
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

impl McapMessage for CompressedImage {
    const NAME: &'static str = "foxglove.CompressedImage";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("timestamp", 1, Type::Message, false),
        ("data", 2, Type::Bytes, false),
        ("format", 3, Type::String, false),
        ("frame_id", 4, Type::String, false),
    ];
}

/// A line of text, with the field numbers of `foxglove.Log`.
#[derive(Clone, PartialEq, prost::Message)]
pub struct LogLine {
    /// Host time.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// 3 warning, 4 error.
    #[prost(int32, tag = "2")]
    pub level: i32,
    /// Text.
    #[prost(string, tag = "3")]
    pub message: String,
    /// Who says it.
    #[prost(string, tag = "4")]
    pub name: String,
}

impl McapMessage for LogLine {
    const NAME: &'static str = "foxglove.Log";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("timestamp", 1, Type::Message, false),
        ("level", 2, Type::Int32, false),
        ("message", 3, Type::String, false),
        ("name", 4, Type::String, false),
    ];
}

/// A message that is read back: its numbers are judged before anything is made of them.
pub trait RecordedMessage: McapMessage {
    /// Holds every number against what its field may have.
    ///
    /// # Errors
    /// The first number out of its range.
    fn check(&self) -> Result<(), OutOfRange>;
}

/// One scan.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Scan {
    /// Running number of the unit.
    #[prost(uint64, tag = "1")]
    pub serial: u64,
    /// Host time of arrival, s.
    #[prost(double, tag = "2")]
    pub host_s: f64,
    /// Time of the unit, s.
    #[prost(double, tag = "3")]
    pub device_s: f64,
    /// Peaks, nm, channel after channel.
    #[prost(double, repeated, tag = "4")]
    pub peaks_nm: Vec<f64>,
    /// Peaks of each channel.
    #[prost(uint32, repeated, tag = "5")]
    pub peaks_per_channel: Vec<u32>,
    /// Bits: 1 calibration, 2 fan, 4 source temperature, 8 source current, 16 cooler over, 32 cooler under.
    #[prost(uint32, tag = "6")]
    pub health: u32,
    /// Error code of the unit.
    #[prost(uint32, tag = "7")]
    pub error_code: u32,
    /// Buffer, percent.
    #[prost(uint32, tag = "8")]
    pub buffer_percent: u32,
}

impl RecordedMessage for Scan {
    fn check(&self) -> Result<(), OutOfRange> {
        judge([
            (range::SERIAL, self.serial as f64),
            (range::HOST_S, self.host_s),
            (range::DEVICE_S, self.device_s),
            (range::CHANNELS, self.peaks_per_channel.len() as f64),
            (range::HEALTH, f64::from(self.health)),
            (range::ERROR_CODE, f64::from(self.error_code)),
            (range::BUFFER_PERCENT, f64::from(self.buffer_percent)),
        ])?;
        self.peaks_per_channel.iter().try_for_each(|n| range::PEAKS.judge_own(f64::from(*n)))?;
        // NaN is what a unit sends in place of a peak that it does not have.
        let peaks = self.peaks_nm.iter().filter(|nm| !nm.is_nan());
        peaks.copied().try_for_each(|nm| range::PEAKS_NM.judge_own(nm))
    }
}

impl McapMessage for Scan {
    const NAME: &'static str = "wcal.Scan";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("serial", 1, Type::Uint64, false),
        ("host_s", 2, Type::Double, false),
        ("device_s", 3, Type::Double, false),
        ("peaks_nm", 4, Type::Double, true),
        ("peaks_per_channel", 5, Type::Uint32, true),
        ("health", 6, Type::Uint32, false),
        ("error_code", 7, Type::Uint32, false),
        ("buffer_percent", 8, Type::Uint32, false),
    ];
}

impl From<&FbgReading> for Scan {
    fn from(reading: &FbgReading) -> Self {
        let h = &reading.health;
        let bits = [h.calibration_fault, h.fan_fault, h.soa_thermal, h.soa_current, h.tec_over, h.tec_under];
        Self {
            serial: reading.serial,
            host_s: reading.clocks.host_s,
            device_s: reading.clocks.device_s.unwrap_or(reading.clocks.host_s),
            peaks_nm: reading.peaks_nm.iter().flatten().copied().collect(),
            peaks_per_channel: reading.peaks_nm.iter().map(|c| c.len() as u32).collect(),
            health: bits.iter().enumerate().map(|(k, on)| u32::from(*on) << k).sum(),
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
            clocks: Clocks { host_s: self.host_s, device_s: Some(self.device_s) },
        }
    }
}

/// One reading of the stage.
#[derive(Clone, PartialEq, prost::Message)]
pub struct StagePosition {
    /// Host time, s.
    #[prost(double, tag = "1")]
    pub host_s: f64,
    /// Target, mm; absent before the first move.
    #[prost(double, optional, tag = "2")]
    pub commanded_mm: Option<f64>,
    /// Position, mm.
    #[prost(double, tag = "3")]
    pub measured_mm: f64,
    /// Moving.
    #[prost(bool, tag = "4")]
    pub moving: bool,
    /// Flags.
    #[prost(string, repeated, tag = "5")]
    pub flags: Vec<String>,
}

impl RecordedMessage for StagePosition {
    fn check(&self) -> Result<(), OutOfRange> {
        judge([
            (range::HOST_S, self.host_s),
            (range::COMMANDED_MM, self.commanded_mm.unwrap_or(0.0)),
            (range::MEASURED_MM, self.measured_mm),
        ])
    }
}

impl McapMessage for StagePosition {
    const NAME: &'static str = "wcal.StagePosition";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("host_s", 1, Type::Double, false),
        ("commanded_mm", 2, Type::Double, false),
        ("measured_mm", 3, Type::Double, false),
        ("moving", 4, Type::Bool, false),
        ("flags", 5, Type::String, true),
    ];
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

/// What happened in the sweep. Times are device times of the interrogator.
#[derive(Clone, PartialEq, prost::Message)]
pub struct SweepEvent {
    /// `start`, `mount`, `arrived`, `window`, `moving`, `sync`, `soak`, `pair-refused`, `picture-missed`, `done`, `stopped`, `finished`.
    #[prost(string, tag = "1")]
    pub kind: String,
    /// Index of the step.
    #[prost(uint32, tag = "2")]
    pub step: u32,
    /// Role of the rows.
    #[prost(string, tag = "3")]
    pub role: String,
    /// Trajectory.
    #[prost(uint32, tag = "4")]
    pub trajectory: u32,
    /// Repetition.
    #[prost(uint32, tag = "5")]
    pub replicate: u32,
    /// Depth asked for, mm.
    #[prost(double, tag = "6")]
    pub target_mm: f64,
    /// +1 or -1.
    #[prost(sint32, tag = "7")]
    pub direction: i32,
    /// Speed of the move, mm/s.
    #[prost(double, tag = "8")]
    pub speed_mm_s: f64,
    /// Begin of the window or motion, s.
    #[prost(double, tag = "9")]
    pub begin_s: f64,
    /// End, s.
    #[prost(double, tag = "10")]
    pub end_s: f64,
    /// Arrival, s.
    #[prost(double, tag = "11")]
    pub arrived_s: f64,
    /// Rows a second of a motion.
    #[prost(double, tag = "12")]
    pub rows_hz: f64,
    /// Whether the drift gate opened.
    #[prost(bool, tag = "13")]
    pub settled: bool,
    /// Further detail.
    #[prost(string, tag = "14")]
    pub detail: String,
    /// The rows belong to the holdout file.
    #[prost(bool, tag = "15")]
    pub sealed: bool,
}

impl RecordedMessage for SweepEvent {
    fn check(&self) -> Result<(), OutOfRange> {
        judge([
            (range::STEP, f64::from(self.step)),
            (range::TRAJECTORY, f64::from(self.trajectory)),
            (range::REPLICATE, f64::from(self.replicate)),
            (range::TARGET_MM, self.target_mm),
            (range::DIRECTION, f64::from(self.direction)),
            (range::SPEED_MM_S, self.speed_mm_s),
            (range::BEGIN_S, self.begin_s),
            (range::END_S, self.end_s),
            (range::ARRIVED_S, self.arrived_s),
            (range::ROWS_HZ, self.rows_hz),
        ])
    }
}

impl McapMessage for SweepEvent {
    const NAME: &'static str = "wcal.SweepEvent";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("kind", 1, Type::String, false),
        ("step", 2, Type::Uint32, false),
        ("role", 3, Type::String, false),
        ("trajectory", 4, Type::Uint32, false),
        ("replicate", 5, Type::Uint32, false),
        ("target_mm", 6, Type::Double, false),
        ("direction", 7, Type::Sint32, false),
        ("speed_mm_s", 8, Type::Double, false),
        ("begin_s", 9, Type::Double, false),
        ("end_s", 10, Type::Double, false),
        ("arrived_s", 11, Type::Double, false),
        ("rows_hz", 12, Type::Double, false),
        ("settled", 13, Type::Bool, false),
        ("detail", 14, Type::String, false),
        ("sealed", 15, Type::Bool, false),
    ];
}

/// A frame of a camera, without its pixels.
#[derive(Clone, PartialEq, prost::Message)]
pub struct FrameInfo {
    /// Name of the camera.
    #[prost(string, tag = "1")]
    pub camera: String,
    /// Number of the trigger.
    #[prost(uint64, tag = "2")]
    pub trigger: u64,
    /// Host time of arrival, s.
    #[prost(double, tag = "3")]
    pub host_s: f64,
    /// Start of exposure by the camera's clock, s; absent where it has none.
    #[prost(double, optional, tag = "4")]
    pub device_s: Option<f64>,
    /// Exposure, s; absent where it is not known.
    #[prost(double, optional, tag = "5")]
    pub exposure_s: Option<f64>,
    /// Step of the plan whose settled pose it shows; absent for all others.
    #[prost(uint32, optional, tag = "6")]
    pub step: Option<u32>,
}

impl RecordedMessage for FrameInfo {
    fn check(&self) -> Result<(), OutOfRange> {
        judge([
            (range::TRIGGER, self.trigger as f64),
            (range::HOST_S, self.host_s),
            (range::DEVICE_S, self.device_s.unwrap_or(0.0)),
            (range::EXPOSURE_S, self.exposure_s.unwrap_or(0.0)),
            (range::STEP, f64::from(self.step.unwrap_or(0))),
        ])
    }
}

impl McapMessage for FrameInfo {
    const NAME: &'static str = "wcal.FrameInfo";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("camera", 1, Type::String, false),
        ("trigger", 2, Type::Uint64, false),
        ("host_s", 3, Type::Double, false),
        ("device_s", 4, Type::Double, false),
        ("exposure_s", 5, Type::Double, false),
        ("step", 6, Type::Uint32, false),
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_comes_back_with_its_channels_and_faults() {
        let reading = FbgReading {
            serial: 9,
            peaks_nm: vec![vec![1535.0, 1541.0], vec![], vec![1537.5]],
            health: InterrogatorHealth { tec_under: true, error_code: 9, ..Default::default() },
            clocks: Clocks { host_s: 3.0, device_s: Some(2.5) },
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
    fn taken<M: RecordedMessage>(value: f64) -> Vec<&'static str> {
        let numbers = M::FIELDS.iter().filter(|(_, _, kind, _)| !matches!(kind, Type::String | Type::Bool));
        let taken = numbers.filter(|(_, number, kind, _)| {
            M::decode(&*alone(*number, *kind, value)).unwrap().check().is_ok()
        });
        taken.map(|field| field.0).collect()
    }

    #[test]
    fn every_number_of_every_message_has_a_range() {
        for value in [1e300, f64::INFINITY] {
            let all = [taken::<Scan>(value), taken::<StagePosition>(value), taken::<SweepEvent>(value)];
            let none: [&str; 0] = [];
            assert_eq!(all.concat(), none, "{value}");
            assert_eq!(taken::<FrameInfo>(value), none, "{value}");
        }
        for value in [-1e300, f64::NEG_INFINITY, f64::NAN] {
            // What has no sign and no NaN holds 0 then; NaN in place of a peak is the unit's.
            let doubles = |fields: Vec<&'static str>| -> Vec<&str> {
                fields
                    .into_iter()
                    .filter(|f| f.ends_with("_s") || f.ends_with("mm") || f.ends_with("hz"))
                    .collect()
            };
            let all = [taken::<Scan>(value), taken::<StagePosition>(value), taken::<SweepEvent>(value)];
            let none: [&str; 0] = [];
            assert_eq!(doubles(all.concat()), none, "{value}");
            assert_eq!(doubles(taken::<FrameInfo>(value)), none, "{value}");
        }
        assert_eq!(taken::<SweepEvent>(1.0).len(), 10, "negative control: numbers of a bench are taken");
        assert_eq!(taken::<Scan>(1.0).len(), 8, "negative control");
    }

    #[test]
    fn the_schema_describes_what_is_encoded() {
        let set = FileDescriptorSet::decode(&*Scan::schema()).unwrap();
        let message = &set.file[0].message_type[0];
        assert_eq!((set.file[0].package(), message.name()), ("wcal", "Scan"));
        assert_eq!(message.field.len(), Scan::FIELDS.len());
        // A field set to a value appears under the number that the schema states.
        let bytes = Scan { error_code: 5, ..Scan::default() }.encode_to_vec();
        assert_eq!(bytes, [7 << 3, 5]);
    }

    /// Foxglove's own definition (schemas/proto/foxglove/CompressedImage.proto): time stamp 1, data 2, format 3, frame 4.
    #[test]
    fn a_picture_is_laid_out_as_foxglove_reads_it() {
        let set = FileDescriptorSet::decode(&*CompressedImage::schema()).unwrap();
        let [time, picture] = &set.file[..] else { panic!("{set:?}") };
        assert_eq!(picture.dependency, ["google/protobuf/timestamp.proto"]);
        assert_eq!((time.name(), picture.package()), ("google/protobuf/timestamp.proto", "foxglove"));
        assert_eq!(picture.message_type[0].field[0].type_name(), ".google.protobuf.Timestamp");
        let image = CompressedImage {
            timestamp: Some(stamp(2.5)),
            data: vec![7],
            format: "png".into(),
            frame_id: "l".into(),
        };
        let bytes = image.encode_to_vec();
        let expected =
            [&[10, 7, 8, 2, 16, 128, 202, 181, 238, 1][..], &[18, 1, 7, 26, 3], b"png", &[34, 1], b"l"];
        let expected = expected.concat();
        assert_eq!(CompressedImage::decode(&*bytes).unwrap(), image);
        assert_eq!(&bytes[10..], &expected[10..], "{bytes:?}");
        // A message without times needs no other file.
        assert_eq!(FileDescriptorSet::decode(&*Scan::schema()).unwrap().file.len(), 1);
    }
}
