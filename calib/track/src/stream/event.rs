//! Settings of the event detector, and its events.

/// Settings of the detector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventSettings {
    /// Rate of the moments, Hz.
    pub rate_hz: f64,
    /// Length of the no-contact prefix that the noise is taken from, s.
    pub prefix_s: f64,
    /// False alarms an hour that noise as in the prefix may cause at most.
    pub false_alarms_per_hour: f64,
    /// First mode of the free wire, Hz; a ring from 0.6 to 1.5 times it is attributed to this mode.
    pub first_mode_hz: f64,
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// First touch.
    Onset,
    /// The wire came free without ringing.
    Release,
    /// An abrupt change in contact that does not ring: the contact ran along object or wire.
    Slip,
    /// The wire came free and rang in its first mode.
    Snap,
    /// An abrupt change from contact to contact that rang: the wire was free in between.
    Jump,
}

impl EventKind {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Onset => "onset",
            Self::Release => "release",
            Self::Slip => "slip",
            Self::Snap => "snap",
            Self::Jump => "jump",
        }
    }
}

/// An event.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactEvent {
    /// What happened.
    pub kind: EventKind,
    /// Time of the event, s.
    pub t_s: f64,
    /// Standard deviation of the time, s.
    pub sd_s: f64,
    /// Time at which the detector knew it, s: that of the last block that it needed.
    pub known_s: f64,
    /// Moments before and after, N mm.
    pub moments_nmm: [[f64; 2]; 2],
    /// Test statistic and its limit.
    pub statistic: f64,
    /// See `statistic`.
    pub limit: f64,
    /// Frequency (Hz), quality factor and amplitude (N mm) of the ring, where there was one.
    pub ring: Option<[f64; 3]>,
}
