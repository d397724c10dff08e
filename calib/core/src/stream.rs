//! A whisker's readings as they arrive, and the maps that take them one by one.

use nalgebra::Matrix2;

/// What was wrong with a reading or since the one before, as bits; 0: nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Flags(pub u16);

impl Flags {
    /// Scans are missing before this one.
    pub const GAP: Self = Self(1);
    /// A sensing grating has no peak.
    pub const PEAK_LOST: Self = Self(2);
    /// Gratings that cannot be distinguished.
    pub const CROSSING: Self = Self(4);
    /// The strain-isolated grating has no peak.
    pub const REFERENCE_LOST: Self = Self(8);
    /// The unit says that its data or its state is bad.
    pub const UNIT: Self = Self(16);
    /// The device's clock did not go forward.
    pub const CLOCK: Self = Self(32);
    /// Scans were dropped here because the tracker was behind.
    pub const DROPPED: Self = Self(64);
    /// The filter is not full yet: since the start or since what another flag says.
    pub const FILLING: Self = Self(128);
    /// Contact of a wire that the network was not trained on; its place assumes that it was.
    pub const WIRE_ASSUMED: Self = Self(256);
    /// Moments and known motion do not belong together.
    pub const MOTION_DISAGREES: Self = Self(512);
    /// The motion at this time is not known.
    pub const MOTION_LOST: Self = Self(1024);
    /// Contact in a motion that is not known to be one that the network was trained on; its place
    /// assumes that it is.
    pub const MOTION_ASSUMED: Self = Self(2048);
    /// No fixed point of the object explains the moments along the known motion; one that slides
    /// does, and was assumed.
    pub const SLIDING_ASSUMED: Self = Self(4096);

    /// A way in which the contact may move on what it touches could not be looked at.
    pub const UNDECIDED: Self = Self(8192);
    /// The stated regions do not hold the known groove.
    pub const GROOVE_MISSED: Self = Self(16384);

    /// In the order of the bits.
    const NAMES: [&'static str; 15] = [
        "gap",
        "peak-lost",
        "crossing",
        "reference-lost",
        "unit",
        "clock",
        "dropped",
        "filling",
        "wire-assumed",
        "motion-disagrees",
        "motion-lost",
        "motion-assumed",
        "sliding-assumed",
        "undecided",
        "groove-missed",
    ];

    /// Both.
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether all bits of the other are set.
    pub fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Whether nothing is wrong.
    pub fn none(self) -> bool {
        self.0 == 0
    }

    /// `ok`, or the names with `|` between them.
    pub fn text(self) -> String {
        if self.none() {
            return "ok".to_owned();
        }
        let set = |k: &usize| self.0 >> k & 1 == 1;
        let names = (0..Self::NAMES.len()).filter(set).map(|k| Self::NAMES[k]);
        names.collect::<Vec<_>>().join("|")
    }
}

/// One reading of one whisker.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WhiskerReading {
    /// Running number of the scan.
    pub serial: u64,
    /// Time since the first scan, s, by the device's clock.
    pub t_s: f64,
    /// Temperature-compensated shifts, pm, and the temperature over nominal, K; `None` where the
    /// reading cannot be used.
    pub shift_pm: Option<[f64; 2]>,
    /// See `shift_pm`; 0 without a reference grating.
    pub rise_degc: f64,
    /// What was wrong.
    pub flags: Flags,
}

/// Moments from one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamMoments {
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviations, N mm.
    pub sd_nmm: [f64; 2],
    /// Whether the calibration vouches for them.
    pub valid: bool,
}

/// What the spread of a reading's moments is made of.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MomentSpread {
    /// Covariance of the noise from pose to pose, (N mm)^2.
    pub noise_nmm2: Matrix2<f64>,
    /// By how much one standard deviation of each unknown that all readings share makes the moments
    /// too large, N mm.
    pub shared_nmm: Vec<[f64; 2]>,
}

/// A calibration that takes readings one by one, in order of time.
pub trait MomentStream: Send {
    /// Moments alone, N mm, without memory: for every scan.
    fn quick_nmm(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2];
    /// Moments with their spread and validity, memory effects carried on from the reading before.
    fn moments(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> StreamMoments;
    /// What the spread of the moments is made of that [`Self::moments`] gave last; as many shared
    /// unknowns at every reading.
    fn spread(&self) -> MomentSpread;
}

#[cfg(test)]
mod tests {
    use super::Flags;

    #[test]
    fn flags_are_named() {
        assert_eq!(Flags::default().text(), "ok");
        let both = Flags::FILLING.with(Flags::GAP);
        assert_eq!(both.text(), "gap|filling");
        assert!(both.has(Flags::GAP) && !both.has(Flags::CLOCK));
    }
}
