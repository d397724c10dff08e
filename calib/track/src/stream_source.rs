//! Readings of a stream: scans in, readings out, whisker by whisker.

use crate::TrackError;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::Estimator;
use crate::known_groove::{KnownGroove, KnownPlace};
use crate::reading::{Moments, MotionAccuracy, Reading};
use crate::regimes::{ANY_OBJECT, GROOVE};
use crate::sliding::FrictionPrior;
use crate::stream_motion::{KERNEL, StreamMotion};
use crate::track::Input;
use crate::track_document::{
    FilterDocument, StreamDocument, StreamedWhisker, TimeDocument, WhiskerDocument,
};
use crate::tracker::ContactTracker;
use crate::trust::WhiskerModel;
use crate::whisker_track::{Outcome, WhiskerTrack};
use nalgebra::Vector3;
use std::time::{Duration, Instant};
use wcal_acquisition::clock_watch::{ClockFault, ClockWatch};
use wcal_acquisition::clocks::ClockPair;
use wcal_acquisition::message::{StagePosition, SweepEvent};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::whisker_reader::WhiskerReader;
use wcal_core::WhiskerSpec;
use wcal_core::device::FbgReading;
use wcal_core::stream::MomentSpread;
use wcal_network::stream::{Row, SignalChain, SignalChainSettings};
use wcal_session::MotionLog;

/// The moments' table is filled so far from the wire while the stream begins, mm.
const REACH_MM: f64 = 8.0;

/// What the user decides of a stream.
#[derive(Debug, Clone)]
pub struct StreamSettings {
    /// Rows a second.
    pub rate_hz: f64,
    /// Lag of the filter, s.
    pub lag_s: f64,
    /// Beginning without contact, s.
    pub prefix_s: f64,
    /// Time whose mean moments are the zero, s.
    pub tare_s: f64,
    /// Speed of the base along +z, where it is constant and known, mm/s.
    pub base_mm_s: Option<f64>,
    /// The user vouches for a motion as in training where it is not known.
    pub vouched: bool,
    /// Relative standard deviation of the diameter of a wire that is not the calibration's own.
    pub diameter_sd: Option<f64>,
    /// What is known of the friction on an object.
    pub friction: FrictionPrior,
    /// What is assumed of the motion.
    pub accuracy: MotionAccuracy,
}

/// One whisker of a stream.
struct Whisker<'a> {
    loaded: &'a WhiskerModel<'a>,
    whisker: WhiskerSpec,
    reader: WhiskerReader,
    chain: SignalChain,
    /// Middle of the free wire, base frame, and what the calibration adds to the declared place of
    /// the groove, mm.
    middle_mm: Vector3<f64>,
    offset_mm: Vector3<f64>,
    kernel: Vec<(f64, f64)>,
    /// Rows are in the beginning without contact until then, s; a network asks for none.
    prefix_s: f64,
    unusable: u64,
}

/// The readings of all whiskers with what they share.
pub struct StreamSource<'a> {
    all: Vec<Whisker<'a>>,
    motion: StreamMotion,
    stream: StreamSettings,
    clocks: ClockPair,
    clock_watch: ClockWatch,
    clock_scale: f64,
    clock_faults: Vec<ClockFault>,
    /// Sum of the clock's steps, s.
    stepped_s: f64,
    origin_s: Option<f64>,
    scans: u64,
    lost: u64,
    gaps: u64,
    next_serial: Option<u64>,
    settings: SignalChainSettings,
    /// Time in filters and maps.
    spent: Duration,
    /// When the first scan was taken, and how long the stream is, s.
    begun: Option<Instant>,
    stream_s: f64,
}

impl<'a> StreamSource<'a> {
    /// Whiskers of a rig with their tracks; a log takes the place of the stage's motion.
    ///
    /// # Errors
    /// Where gratings, calibration, filter or base do not fit.
    pub fn new(
        stream: StreamSettings,
        (place, rig): (&str, &Rig),
        loaded: &'a [WhiskerModel<'a>],
        log: Option<MotionLog>,
    ) -> Result<(Self, Vec<WhiskerTrack<'a>>), TrackError> {
        let settings = SignalChainSettings {
            rate_hz: rig.interrogator.rate_hz,
            out_hz: stream.rate_hz,
            lag_s: stream.lag_s,
            prefix_s: stream.prefix_s,
        };
        // Without a base that moves, the stage carries the groove.
        let of_groove = log.is_none() && rig.base.is_none();
        let one =
            |l: &'a WhiskerModel<'a>| Whisker::new(&stream, &settings, (place, rig), l, of_groove);
        let both = loaded
            .iter()
            .map(one)
            .collect::<Result<Vec<_>, TrackError>>()?;
        let (all, tracks) = both.into_iter().unzip();
        let own = Self {
            all,
            motion: StreamMotion::new(rig, stream.base_mm_s, log),
            stream,
            clocks: ClockPair::default(),
            clock_watch: ClockWatch::new(rig.clock_scale),
            clock_scale: rig.clock_scale,
            clock_faults: Vec::new(),
            stepped_s: 0.0,
            origin_s: None,
            scans: 0,
            lost: 0,
            gaps: 0,
            next_serial: None,
            settings,
            spent: Duration::ZERO,
            begun: None,
            stream_s: 0.0,
        };
        Ok((own, tracks))
    }

    /// Time since the first scan by the device's clock without its steps, s.
    pub fn elapsed_s(&self, reading: &FbgReading) -> f64 {
        let now = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        self.origin_s
            // A step of the device's clock is no time that has passed.
            .map_or(0.0, |origin| now - origin - self.stepped_s)
    }

    /// Hears what time a scan states, before it is tracked; what the clock has done, where it steps
    /// or stands still.
    pub fn hear(&mut self, reading: &FbgReading) -> Option<ClockFault> {
        let now = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        let fault = self
            .clock_watch
            .take(reading.serial, reading.clocks.host_s, now)?;
        if let ClockFault::Step { step_s, .. } = fault {
            self.stepped_s += step_s;
        }
        self.clock_faults.push(fault);
        Some(fault)
    }

    /// Whether the clock may have stepped just now.
    pub fn doubts_clock(&self) -> bool {
        self.clock_watch.is_unsure()
    }

    /// Another recording follows: between two of them a clock may be set.
    pub fn begin_recording(&mut self) {
        self.clock_watch = ClockWatch::new(self.clock_scale);
    }

    /// What the clock did so far that no clock does.
    pub fn clock_faults(&self) -> &[ClockFault] {
        &self.clock_faults
    }

    /// Takes a position of the stage that carries the base.
    pub fn stage(&mut self, position: &StagePosition) {
        if let Some(origin_s) = self.origin_s
            && let Some(device_s) = self.clocks.device_s(position.host_s)
        {
            self.motion.stage(device_s - origin_s, position.measured_mm);
        }
    }

    /// Takes what a sweep did.
    pub fn sweep_event(&mut self, event: &SweepEvent) {
        self.motion.sweep_event(event);
    }

    /// Compares answers with the groove of the session's readings; `whisker` is whose session it
    /// is, none where the rig has one alone.
    pub fn know_groove(
        &self,
        tracks: &mut [WhiskerTrack<'_>],
        places: &[KnownPlace],
        whisker: Option<&str>,
    ) {
        let one = self.all.len() == 1;
        let named = |w: &Whisker<'_>| one || whisker.is_some_and(|id| id == w.loaded.name);
        for (w, track) in self.all.iter().zip(tracks).filter(|(w, _)| named(w)) {
            let moved = |p: &KnownPlace| KnownPlace {
                groove_mm: p.groove_mm + w.offset_mm,
                ..*p
            };
            track.groove = KnownGroove::new(places.iter().map(moved).collect(), &w.whisker);
        }
    }

    /// Takes a scan; the readings that the filters settle by it. `dropped`: scans before it were
    /// dropped on this side.
    ///
    /// # Errors
    /// Where the stream is not the one that the rig describes.
    pub fn scan(&mut self, reading: &FbgReading, dropped: bool) -> Result<Vec<Input>, TrackError> {
        let device_s = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        self.origin_s.get_or_insert(device_s);
        self.clocks.add(reading.clocks.host_s, device_s);
        self.begun.get_or_insert_with(Instant::now);
        self.stream_s = self.elapsed_s(reading);
        self.scans += 1;
        if let Some(next) = self.next_serial.filter(|next| reading.serial != *next) {
            self.gaps += 1;
            self.lost += reading.serial.saturating_sub(next);
        }
        self.next_serial = Some(reading.serial + 1);
        let (start, mut inputs) = (Instant::now(), Vec::new());
        for (k, w) in self.all.iter_mut().enumerate() {
            let sensed = w.reader.take(reading, dropped)?;
            w.unusable += u64::from(sensed.shift_pm.is_none());
            if let Some(row) = w.chain.push(&sensed) {
                inputs.push(Input::Reading(k, Box::new(w.reading(&row, &self.motion))));
            }
        }
        self.spent += start.elapsed();
        Ok(inputs)
    }

    /// Scans that are missing, and that a whisker could not use.
    pub fn lost(&self) -> [u64; 2] {
        [self.lost, self.all.iter().map(|w| w.unusable).sum()]
    }

    /// Whiskers that never had a quiet prefix: the noise of their rows is not known.
    pub fn unheard(&self) -> Vec<&str> {
        let all = self.all.iter();
        let silent = all.filter(|w| w.chain.prefix().block_nmm2().is_none());
        silent.map(|w| w.loaded.name.as_str()).collect()
    }

    /// What was found: for track.json, for people, and for the exit code. `dropped`: scans that the
    /// tracker dropped; `tracked`: time in the tracks.
    pub fn findings(
        &self,
        tracks: &[WhiskerTrack<'_>],
        (cut_off, dropped): (Option<Vec<String>>, u64),
        tracked: Duration,
    ) -> StreamFindings {
        let filter = self.all.first().map(|w| w.chain.filter());
        let seconds = |d: Duration| d.as_secs_f64();
        let wall_s = self.begun.map(|b| seconds(b.elapsed()));
        let (mut messages, mut outcome) = (Vec::new(), Outcome::default());
        let mut whiskers = Vec::with_capacity(self.all.len());
        for (w, track) in self.all.iter().zip(tracks) {
            let found = track.findings();
            let whose = match track.name() {
                "" => String::new(),
                name => format!("whisker {name}: "),
            };
            let said = found.messages.iter();
            messages.extend(said.map(|m| match m.strip_prefix("warning: ") {
                Some(m) => format!("warning: {whose}{m}"),
                None => format!("{whose}{m}"),
            }));
            outcome = outcome.and(found.outcome);
            whiskers.push(w.document(found.document));
        }
        let document = StreamDocument {
            rate_hz: self.stream.rate_hz,
            prefix_s: self.stream.prefix_s,
            cut_off,
            dropped_scans: dropped,
            scans: self.scans,
            gaps: self.gaps,
            lost_scans: self.lost,
            scan_rate_hz: self.settings.rate_hz,
            lag_s: filter.map(|f| f.lag_s()),
            tare_s: self.stream.tare_s,
            filter: filter.map(|f| FilterDocument {
                kind: "linear-phase, Hann-windowed sinc",
                gain_1_hz: f.gain(1.0),
                gain_5_hz: f.gain(5.0),
                gain_10_hz: f.gain(10.0),
                gain_34_hz: f.gain(34.0),
                noise_gain: f.noise_gain(),
            }),
            origin_device_s: self.origin_s,
            time: TimeDocument {
                stream_s: self.stream_s,
                wall_s,
                times_real_time: wall_s.map(|wall| self.stream_s / wall),
                chain_us_per_scan: seconds(self.spent) * 1e6 / (self.scans.max(1) as f64),
                network_s: seconds(tracked),
            },
            whiskers,
            // Networks locate contacts whatever the motion is.
            stream_motion: (!self.all.iter().any(|w| w.loaded.by_network()))
                .then(|| self.motion.document()),
        };
        StreamFindings {
            document,
            messages,
            outcome,
        }
    }
}

/// What the tracks of a stream found.
#[derive(Debug, Clone)]
pub struct StreamFindings {
    /// For track.json.
    pub document: StreamDocument,
    /// For people, one sentence a line.
    pub messages: Vec<String>,
    /// For the exit code.
    pub outcome: Outcome,
}

impl<'a> Whisker<'a> {
    fn new(
        stream: &StreamSettings,
        settings: &SignalChainSettings,
        (place, rig): (&str, &Rig),
        l: &'a WhiskerModel<'a>,
        of_groove: bool,
    ) -> Result<(Self, WhiskerTrack<'a>), TrackError> {
        let calibration = l.calibration()?;
        let map = calibration
            .stream()
            .map_err(TrackError::in_file(&l.place))?;
        let (frame, whisker) = (l.frame()?, l.whisker()?);
        let chain = SignalChain::new(settings, map)?;
        let kernel = chain.filter().kernel(KERNEL);
        // Weights of a low-pass: their second moment is its fall from 1 at small frequencies.
        let window_s2: f64 = kernel
            .iter()
            .map(|(offset_s, w)| w * offset_s * offset_s)
            .sum();
        let accuracy = MotionAccuracy {
            window_sd_s: window_s2.max(0.0).sqrt(),
            ..stream.accuracy
        };
        let (estimator, middle_mm, offset_mm): (Box<dyn Estimator + 'a>, _, _) =
            match l.estimator(stream.vouched)? {
                Some(network) => (Box::new(network), Vector3::zeros(), Vector3::zeros()),
                None => {
                    let wire = calibration.wire(&whisker);
                    let (accepted, changed) = wire.map_err(TrackError::in_file(&l.place))?;
                    let wire = CalibratedWire::new(&accepted, &changed, whisker.diameter_mm)
                        .with_tolerance(stream.diameter_sd)
                        .with_friction(stream.friction);
                    let middle_mm = frame.rotation().inverse() * wire.middle_mm();
                    // The prefix is long enough; a reading that comes sooner solves what it needs
                    // itself.
                    let filled = wire.clone();
                    std::thread::spawn(move || filled.field.fill(REACH_MM));
                    let touched = if of_groove { GROOVE } else { ANY_OBJECT };
                    let own = ContactTracker::of_stream(wire, accuracy, touched);
                    (Box::new(own), middle_mm, accepted.offset_mm)
                }
            };
        let own = Self {
            loaded: l,
            whisker,
            reader: WhiskerReader::new(place, &rig.interrogator, &l.name, calibration.fbg())?,
            kernel,
            chain,
            middle_mm,
            offset_mm,
            prefix_s: stream.prefix_s,
            unusable: 0,
        };
        Ok((
            own,
            WhiskerTrack::new(l.into(), (frame, estimator), stream.tare_s, true),
        ))
    }

    /// A row of the filter as a reading.
    fn reading(&self, row: &Row, motion: &StreamMotion) -> Reading {
        let MomentSpread {
            noise_nmm2,
            shared_nmm,
        } = self.chain.spread();
        let moments = row.moments.map(|m| Moments {
            moment_nmm: m.moment_nmm,
            sd_nmm: m.sd_nmm,
            valid: m.valid,
            pose_nmm2: noise_nmm2,
            own_nmm2: self.chain.row_noise_nmm2(),
            shared_nmm,
            ..Moments::default()
        });
        let point = i64::try_from(row.serial).unwrap_or(i64::MAX);
        Reading {
            flags: row.flags,
            // What happened in between is not known.
            gap: moments.is_none(),
            in_prefix: self.chain.prefix().block_nmm2().is_none() && row.t_s < self.prefix_s,
            moments,
            ..motion.reading((point, row.t_s), &self.kernel, &self.middle_mm)
        }
    }

    fn document(&self, rows: WhiskerDocument) -> StreamedWhisker {
        let block_nmm2 = self.chain.prefix().block_nmm2();
        StreamedWhisker {
            whisker: self.loaded.name.clone(),
            unusable_scans: self.unusable,
            noise_sd_nmm: block_nmm2.map(|c| [c[(0, 0)].sqrt(), c[(1, 1)].sqrt()]),
            rows,
        }
    }
}

/// What was lost, for people; none when nothing was.
pub fn lost_text([lost, unusable]: [u64; 2], dropped: u64) -> Option<String> {
    let all = [
        (lost, "scans lost"),
        (dropped, "scans dropped here, the tracker being behind"),
        (unusable, "readings not usable"),
    ];
    let messages: Vec<String> = all
        .iter()
        .filter(|(n, _)| *n > 0)
        .map(|(n, what)| format!("{n} {what}"))
        .collect();
    (!messages.is_empty()).then(|| format!("{}; flagged in status", messages.join(", ")))
}
