//! What a reduction made, and what it warns of.

use crate::clocks::ClockFit;
use crate::message::Refused;

/// What a reduction made.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Reduction {
    /// Rows of points.csv by role: rest, calibration, verification.
    pub rows: usize,
    /// Rows of holdout.csv.
    pub holdout: usize,
    /// Scans read.
    pub scans: u64,
    /// Events of the sweep read.
    pub events: usize,
    /// Scans missing by their running number.
    pub lost: u64,
    /// Jumps of the running number.
    pub gaps: u64,
    /// Scans that came so late that the bench or the recording computer had fallen behind.
    pub late: u64,
    /// What the interrogator's clock did that no clock does, one entry a fault.
    pub clock_faults: Vec<String>,
    /// Scans after such a fault: when they were made is not known.
    pub unclocked: u64,
    /// Largest delay of a scan, s of the bench's time.
    pub longest_delay_s: f64,
    /// Rows by faults in their windows: scans missing, scans late, the stage not where it was sent.
    pub marked: [usize; 3],
    /// Windows without the two usable scans that a row needs.
    pub empty_windows: usize,
    /// Marked samples.
    pub outliers: usize,
    /// Recordings that were cut off.
    pub cut_off: usize,
    /// Chunks of the recordings that could not be read.
    pub damaged_chunks: u64,
    /// Messages of the recordings that were left out.
    pub refused: Refused,
    /// Messages that the recordings hold once more; each counts once.
    pub repeated: u64,
    /// Camera pairs recorded, and refused.
    pub pairs: [u64; 2],
    /// Why the first of those was refused.
    pub refused_why: Option<String>,
    /// Pictures of settled poses written, and poses whose pair did not come.
    pub pictures: [usize; 2],
    /// Delay of the interrogator behind the stage at each sync move, s.
    pub lag_s: Vec<f64>,
    /// Fits of the interrogator's clock, one a recording.
    pub clocks: Vec<ClockFit>,
    /// Fits of the cameras' clocks by name, one a camera and recording.
    pub camera_clocks: Vec<(String, ClockFit)>,
}

impl Reduction {
    /// Losses and faults; each is a reason for exit code 3.
    pub fn warnings(&self) -> Vec<String> {
        let mut all = self.stream_warnings();
        if self.cut_off > 0 {
            all.insert(0, format!("{} recordings cut off", self.cut_off));
        }
        all
    }

    /// The warnings less recordings that were cut off: a sweep that was resumed has measured again
    /// what they lack.
    pub(crate) fn stream_warnings(&self) -> Vec<String> {
        let Self {
            lost,
            gaps,
            late,
            longest_delay_s,
            marked,
            empty_windows,
            damaged_chunks,
            ..
        } = self;
        let refused = self.pairs[1];
        let all = [
            (
                *damaged_chunks > 0,
                format!("{damaged_chunks} damaged chunks of the recording left out"),
            ),
            (*lost > 0, format!("{lost} scans lost in {gaps} gaps")),
            (
                *late > 0,
                format!(
                    "{late} scans late, by up to {longest_delay_s:.1} s of the bench's time: the bench or this computer fell behind"
                ),
            ),
            (
                marked[..2] != [0; 2],
                format!(
                    "{} rows with scans missing and {} with late scans or clocks that cannot be aligned, marked in the column `stream`",
                    marked[0], marked[1]
                ),
            ),
            (
                marked[2] > 0,
                format!(
                    "{} rows in whose averaging window the stage moved or stood where it had not been sent (another program, or a hand at its \
                     knob): marked `moved` in the column `stream`, and not used",
                    marked[2]
                ),
            ),
            (
                *empty_windows > 0,
                format!(
                    "{empty_windows} windows without usable scans or answers of the stage: no rows"
                ),
            ),
            (
                refused > 0,
                match &self.refused_why {
                    Some(why) => format!("{refused} camera pairs refused; the first: {why}"),
                    None => format!("{refused} camera pairs refused"),
                },
            ),
            (
                self.pictures[1] > 0,
                format!("{} poses without pictures", self.pictures[1]),
            ),
        ];
        let all = all.into_iter().filter(|(on, _)| *on).map(|(_, text)| text);
        self.fault_warnings()
            .chain(self.refused.text())
            .chain(all)
            .chain(self.clock_warnings())
            .collect()
    }

    /// Faults of the interrogator's clock.
    fn fault_warnings(&self) -> impl Iterator<Item = String> {
        let after = (self.unclocked > 0).then(|| {
            format!(
                "{} scans after a fault of the interrogator's clock",
                self.unclocked
            )
        });
        self.clock_faults
            .iter()
            .map(|what| format!("interrogator: {what}"))
            .chain(after)
    }

    /// Clocks that no crystal explains.
    fn clock_warnings(&self) -> Vec<String> {
        let cameras = self
            .camera_clocks
            .iter()
            .map(|(name, fit)| (format!("camera {name}"), fit));
        let all = self
            .clocks
            .iter()
            .map(|fit| ("interrogator".to_owned(), fit))
            .chain(cameras);
        all.filter(|(_, fit)| fit.broken())
            .map(|(name, fit)| {
                format!(
                    "{name}: the device clock drifts by {:.0} ppm",
                    fit.drift * 1e6
                )
            })
            .collect()
    }
}
