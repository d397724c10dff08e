//! Contact points and events of `wcal track`, with the raw streams in a recording and on a live view.

use crate::error::AcquisitionError;
use crate::message::McapMessage;
use crate::recorder::{Recorder, at, log_raw, raw, timestamp};
use foxglove::messages::{Pose, PoseInFrame, Quaternion, Vector3};
use foxglove::{Channel, ChannelBuilder, RawChannel};
use prost_types::field_descriptor_proto::Type;
use std::collections::HashMap;
use std::sync::Arc;

/// Topics of a track.
pub mod topic {
    /// Every row of the track (`wcal.ContactPoint`).
    pub const CONTACT: &str = "/track/contact";
    /// Onsets, releases, slips, snaps and jumps (`wcal.ContactEvent`).
    pub const EVENT: &str = "/track/event";
    /// Place of the contact for 3D views (`foxglove.PoseInFrame`): followed by the whisker's name.
    pub const POSE: &str = "/track/pose/";
}

/// One row of a track, as in `track.csv`. Lists are empty where the row has none.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ContactPoint {
    /// Whisker.
    #[prost(string, tag = "1")]
    pub whisker: String,
    /// Time of validity since the first scan, s.
    #[prost(double, tag = "2")]
    pub t_s: f64,
    /// `ok` or flags.
    #[prost(string, tag = "3")]
    pub status: String,
    /// Two moments, N mm.
    #[prost(double, repeated, tag = "4")]
    pub moment_nmm: Vec<f64>,
    /// Their standard deviations, N mm.
    #[prost(double, repeated, tag = "5")]
    pub moment_sd_nmm: Vec<f64>,
    /// Outside the calibration's valid region.
    #[prost(bool, tag = "6")]
    pub outside_valid_region: bool,
    /// Reasons not to trust the calibration or the model; empty without any.
    #[prost(string, tag = "7")]
    pub doubts: String,
    /// Probability of contact.
    #[prost(double, repeated, tag = "8")]
    pub contact_probability: Vec<f64>,
    /// Contact, base frame, mm.
    #[prost(double, repeated, tag = "9")]
    pub contact_mm: Vec<f64>,
    /// Covariance xx, yy, zz, xy, xz, yz, base frame, mm^2.
    #[prost(double, repeated, tag = "10")]
    pub covariance_mm2: Vec<f64>,
    /// Contact, world frame, mm.
    #[prost(double, repeated, tag = "11")]
    pub world_mm: Vec<f64>,
    /// Covariance as above, world frame, mm^2.
    #[prost(double, repeated, tag = "12")]
    pub world_covariance_mm2: Vec<f64>,
    /// Speed of the base along its +z, mm/s, where it is known.
    #[prost(double, repeated, tag = "13")]
    pub base_mm_s: Vec<f64>,
}

impl McapMessage for ContactPoint {
    const NAME: &'static str = "wcal.ContactPoint";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("whisker", 1, Type::String, false),
        ("t_s", 2, Type::Double, false),
        ("status", 3, Type::String, false),
        ("moment_nmm", 4, Type::Double, true),
        ("moment_sd_nmm", 5, Type::Double, true),
        ("outside_valid_region", 6, Type::Bool, false),
        ("doubts", 7, Type::String, false),
        ("contact_probability", 8, Type::Double, true),
        ("contact_mm", 9, Type::Double, true),
        ("covariance_mm2", 10, Type::Double, true),
        ("world_mm", 11, Type::Double, true),
        ("world_covariance_mm2", 12, Type::Double, true),
        ("base_mm_s", 13, Type::Double, true),
    ];
}

/// An event at a whisker.
#[derive(Clone, PartialEq, prost::Message)]
pub struct ContactEventMessage {
    /// Whisker.
    #[prost(string, tag = "1")]
    pub whisker: String,
    /// `onset`, `release`, `slip`, `snap` or `jump`.
    #[prost(string, tag = "2")]
    pub kind: String,
    /// Time since the first scan, s, and its standard deviation.
    #[prost(double, tag = "3")]
    pub t_s: f64,
    /// See `t_s`.
    #[prost(double, tag = "4")]
    pub sd_s: f64,
    /// Moments before and after, N mm.
    #[prost(double, repeated, tag = "5")]
    pub before_nmm: Vec<f64>,
    /// See `before_nmm`.
    #[prost(double, repeated, tag = "6")]
    pub after_nmm: Vec<f64>,
    /// Test statistic and its limit.
    #[prost(double, tag = "7")]
    pub statistic: f64,
    /// See `statistic`.
    #[prost(double, tag = "8")]
    pub limit: f64,
    /// Frequency (Hz), quality factor and amplitude (N mm) of the ring; empty without one.
    #[prost(double, repeated, tag = "9")]
    pub ring: Vec<f64>,
}

impl McapMessage for ContactEventMessage {
    const NAME: &'static str = "wcal.ContactEvent";
    const FIELDS: &'static [(&'static str, i32, Type, bool)] = &[
        ("whisker", 1, Type::String, false),
        ("kind", 2, Type::String, false),
        ("t_s", 3, Type::Double, false),
        ("sd_s", 4, Type::Double, false),
        ("before_nmm", 5, Type::Double, true),
        ("after_nmm", 6, Type::Double, true),
        ("statistic", 7, Type::Double, false),
        ("limit", 8, Type::Double, false),
        ("ring", 9, Type::Double, true),
    ];
}

/// Channels of a track in a recording.
pub struct TrackChannels {
    contacts: Arc<RawChannel>,
    events: Arc<RawChannel>,
    poses: HashMap<String, Channel<PoseInFrame>>,
}

impl TrackChannels {
    /// Channels for these whiskers.
    ///
    /// # Errors
    /// When the recorder does not take them.
    pub fn new(recorder: &Recorder, whiskers: &[String]) -> Result<Self, AcquisitionError> {
        let context = recorder.context();
        let pose = |name: &String| {
            let topic = format!("{}{}", topic::POSE, if name.is_empty() { "whisker" } else { name });
            (name.clone(), ChannelBuilder::new(topic).context(context).build())
        };
        Ok(Self {
            contacts: raw::<ContactPoint>(context, topic::CONTACT)?,
            events: raw::<ContactEventMessage>(context, topic::EVENT)?,
            poses: whiskers.iter().map(pose).collect(),
        })
    }

    /// Logs a row, at the host time of the scan that completed it.
    pub fn contact(&self, host_s: f64, point: &ContactPoint) {
        log_raw(&self.contacts, point, host_s);
        let (place, frame) = match (&point.world_mm[..], &point.contact_mm[..]) {
            ([x, y, z], _) => ([x, y, z], "world"),
            (_, [x, y, z]) => ([x, y, z], "base"),
            _ => return,
        };
        if let Some(channel) = self.poses.get(&point.whisker) {
            // Foxglove wants metres.
            let [x, y, z] = place.map(|mm| mm / 1000.0);
            let pose = Pose {
                position: Some(Vector3 { x, y, z }),
                orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
            };
            let frame_id = frame.to_owned();
            let message = PoseInFrame { timestamp: timestamp(host_s), frame_id, pose: Some(pose) };
            channel.log_with_meta(&message, at(host_s));
        }
    }

    /// Logs an event.
    pub fn event(&self, host_s: f64, event: &ContactEventMessage) {
        log_raw(&self.events, event, host_s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::Message as _;
    use prost_types::FileDescriptorSet;

    fn described<M: McapMessage>() -> usize {
        let set = FileDescriptorSet::decode(&*M::schema().data).unwrap();
        set.file[0].message_type[0].field.len()
    }

    /// Number of the first field of encoded bytes.
    fn first_field(bytes: &[u8]) -> u8 {
        bytes[0] >> 3
    }

    #[test]
    fn the_schemas_describe_what_is_encoded() {
        assert_eq!((described::<ContactPoint>(), described::<ContactEventMessage>()), (13, 9));
        let point = ContactPoint { base_mm_s: vec![4.0], ..ContactPoint::default() };
        let (name, number, ..) = ContactPoint::FIELDS[12];
        assert_eq!((name, number), ("base_mm_s", i32::from(first_field(&point.encode_to_vec()))));
        let event = ContactEventMessage { limit: 3.0, ..ContactEventMessage::default() };
        let (name, number, ..) = ContactEventMessage::FIELDS[7];
        assert_eq!((name, number), ("limit", i32::from(first_field(&event.encode_to_vec()))));
        assert_eq!(ContactPoint::decode(&*point.encode_to_vec()).unwrap(), point);
        assert!(ContactPoint::decode(&b"\xff\xff\xff"[..]).is_err());
    }
}
