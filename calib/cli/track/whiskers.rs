//! The whiskers of a stream: readings in, rows and events out.

use super::TrackArgs;
use super::located::RowLocator;
use super::output::{TrackFiles, TrackRow, event_message};
use super::surface::write_surface;
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use wcal_acquisition::clock_watch::{ClockFault, ClockWatch};
use wcal_acquisition::clocks::ClockPair;
use wcal_acquisition::message::{StagePosition, SweepEvent};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::tracks::TrackChannels;
use wcal_acquisition::whisker_reader::WhiskerReader;
use wcal_contact::known_groove::{KnownGroove, KnownPlace};
use wcal_contact::known_motion::MotionLog;
use wcal_contact::stream_motion::{StreamMotion, kernel};
use wcal_contact::trust::WhiskerModel;
use wcal_core::device::FbgReading;
use wcal_track::stream::{Row, SignalChain, SignalChainSettings, first_mode_hz};

/// One whisker of a stream.
struct Whisker<'a> {
    loaded: &'a WhiskerModel<'a>,
    doubts: String,
    reader: WhiskerReader,
    chain: SignalChain,
    locator: RowLocator<'a>,
    kernel: Vec<(f64, f64)>,
    rows: u64,
    flagged: u64,
    outside: u64,
    unusable: u64,
    events: BTreeMap<&'static str, u64>,
}

/// All whiskers with what they share.
pub struct Whiskers<'a> {
    all: Vec<Whisker<'a>>,
    motion: StreamMotion,
    tare_s: f64,
    object_class: Option<String>,
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
    /// Time in filters, maps and detectors, and in the network.
    spent: [Duration; 2],
    /// When the first scan was taken, and how long the stream is, s.
    begun: Option<Instant>,
    stream_s: f64,
}

impl<'a> Whiskers<'a> {
    /// Whiskers of a rig; a log takes the place of the stage's motion.
    ///
    /// # Errors
    /// Where gratings, calibration, filter or base do not fit.
    pub fn new(
        args: &TrackArgs,
        (place, rig): (&str, &Rig),
        loaded: &'a [WhiskerModel<'a>],
        log: Option<MotionLog>,
    ) -> Result<Self> {
        let settings = SignalChainSettings {
            rate_hz: rig.interrogator.rate_hz,
            out_hz: args.rate_hz,
            lag_s: args.lag_s,
            prefix_s: args.prefix_s,
            false_alarms_per_hour: args.false_alarms_per_hour,
            first_mode_hz: 0.0,
        };
        let one = |l: &'a WhiskerModel<'a>| -> Result<Whisker<'a>> {
            let calibration = l.calibration()?;
            let place_of = || l.place.display().to_string();
            let (map, fbg) = (calibration.stream().with_context(place_of)?, calibration.fbg());
            let settings = SignalChainSettings { first_mode_hz: first_mode_hz(l.whisker()?), ..settings };
            let chain = SignalChain::new(&settings, map)?;
            Ok(Whisker {
                loaded: l,
                doubts: l.doubts.codes(),
                reader: WhiskerReader::new(place, &rig.interrogator, &l.name, fbg)?,
                kernel: kernel(chain.filter()),
                chain,
                locator: RowLocator::new(args, l)?,
                rows: 0,
                flagged: 0,
                outside: 0,
                unusable: 0,
                events: BTreeMap::new(),
            })
        };
        Ok(Self {
            all: loaded.iter().map(one).collect::<Result<_>>()?,
            motion: StreamMotion::new(place, rig, args.base_mm_s, log)?,
            tare_s: args.tare_s,
            object_class: args.object_class.clone(),
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
            spent: [Duration::ZERO; 2],
            begun: None,
            stream_s: 0.0,
        })
    }

    /// Names.
    pub fn names(&self) -> Vec<String> {
        self.all.iter().map(|w| w.loaded.name.clone()).collect()
    }

    /// Time since the first scan by the device's clock without its steps, s.
    pub fn elapsed_s(&self, reading: &FbgReading) -> f64 {
        let now = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        self.origin_s.map_or(0.0, |origin| now - origin - self.stepped_s)
    }

    /// Hears what time a scan states, before it is tracked; what the clock has done, where it steps or stands still.
    pub fn hear(&mut self, reading: &FbgReading) -> Option<ClockFault> {
        let now = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        let fault = self.clock_watch.take(reading.serial, reading.clocks.host_s, now)?;
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

    /// Compares answers with the groove of the session's readings; `whisker` is whose session it is, none where the rig has one alone.
    pub fn know_groove(&mut self, places: &[KnownPlace], whisker: Option<&str>) {
        let one = self.all.len() == 1;
        for w in self.all.iter_mut().filter(|w| one || whisker.is_some_and(|id| id == w.loaded.name)) {
            w.locator.know_groove(places);
        }
    }

    /// Takes a scan. `dropped`: scans before it were dropped on this side.
    ///
    /// # Errors
    /// Where the stream is not the one that the rig describes, or the disk takes no more.
    pub fn scan(
        &mut self,
        reading: &FbgReading,
        dropped: bool,
        files: &mut TrackFiles,
        channels: Option<&TrackChannels>,
    ) -> Result<()> {
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
        for w in &mut self.all {
            let start = Instant::now();
            let sensed = w.reader.take(reading, dropped)?;
            w.unusable += u64::from(sensed.shift_pm.is_none());
            let (row, event) = w.chain.push(&sensed);
            self.spent[0] += start.elapsed();
            if let Some(event) = event {
                *w.events.entry(event.kind.name()).or_default() += 1;
                files.event(&w.loaded.name, &w.doubts, &event)?;
                if let Some(channels) = channels {
                    channels.event(reading.clocks.host_s, &event_message(&w.loaded.name, &event));
                }
            }
            if let Some(row) = row {
                let start = Instant::now();
                let message = w.row(&row, &self.motion, files)?;
                self.spent[1] += start.elapsed();
                if let Some(channels) = channels {
                    channels.contact(reading.clocks.host_s, &message);
                }
            }
        }
        Ok(())
    }

    /// Rows outside the valid region.
    pub fn outside(&self) -> u64 {
        self.all.iter().map(|w| w.outside).sum()
    }

    /// Scans that are missing, that a whisker could not use, and events that a gap cut off.
    pub fn lost(&self) -> [u64; 3] {
        let unusable = self.all.iter().map(|w| w.unusable).sum();
        [self.lost, unusable, self.all.iter().map(|w| w.chain.detector().cut_off()).sum()]
    }

    /// Whiskers that never had a quiet prefix: no events were detected.
    pub fn unheard(&self) -> Vec<&str> {
        let silent = self.all.iter().filter(|w| w.chain.detector().noise().is_none());
        silent.map(|w| w.loaded.name.as_str()).collect()
    }

    /// Says which rows are in doubt for their motion, and how far answers are from a known groove.
    pub fn say_doubts(&self) {
        for w in &self.all {
            let whose =
                if w.loaded.name.is_empty() { String::new() } else { format!("whisker {}: ", w.loaded.name) };
            w.locator.say(&whose, w.rows);
        }
    }

    /// Ends the contacts at hand: the stream is over.
    pub fn end(&mut self) {
        self.all.iter_mut().for_each(|w| w.locator.end());
    }

    /// Whether rows are in doubt for their motion, and whether stated regions do not hold the known groove.
    pub fn doubtful(&self) -> [bool; 2] {
        [
            self.all.iter().any(|w| w.locator.in_doubt()),
            self.all.iter().any(|w| w.locator.groove().is_some_and(KnownGroove::misstated)),
        ]
    }

    /// Writes cloud and surface beside the table.
    ///
    /// # Errors
    /// Where the disk does not take it.
    pub fn surface(&self, out: &Path) -> Result<Value> {
        write_surface(out, &self.all.iter().map(|w| w.locator.history()).collect::<Vec<_>>())
    }

    /// Where the motion comes from, for track.json; none where networks locate the contacts.
    pub fn motion_summary(&self) -> Option<Value> {
        let log = self.motion.log();
        self.all.iter().all(|w| w.loaded.network.is_none()).then(|| {
            json!({
                "source": self.motion.source(), "span_s": log.map(MotionLog::span_s),
                "jump_lines": log.map(|l| l.jumps().collect::<Vec<_>>()),
            })
        })
    }

    /// Facts for track.json.
    pub fn summary(&self) -> Value {
        let filter = self.all.first().map(|w| w.chain.filter());
        let seconds = |d: Duration| d.as_secs_f64();
        let wall_s = self.begun.map(|b| seconds(b.elapsed()));
        let per_scan_us = |d: Duration| seconds(d) * 1e6 / (self.scans.max(1) as f64);
        json!({
            "scans": self.scans, "gaps": self.gaps, "lost_scans": self.lost,
            "scan_rate_hz": self.settings.rate_hz,
            "lag_s": filter.map(|f| f.lag_s()), "tare_s": self.tare_s, "object_class": self.object_class,
            "filter": filter.map(|f| json!({
                "kind": "linear-phase, Hann-windowed sinc", "gain_1_hz": f.gain(1.0), "gain_5_hz": f.gain(5.0), "gain_10_hz": f.gain(10.0),
                "gain_34_hz": f.gain(34.0), "noise_gain": f.noise_gain(),
            })),
            "origin_device_s": self.origin_s,
            "time": {
                "stream_s": self.stream_s, "wall_s": wall_s, "times_real_time": wall_s.map(|wall| self.stream_s / wall),
                "chain_us_per_scan": per_scan_us(self.spent[0]), "network_s": seconds(self.spent[1]),
            },
            "whiskers": self.all.iter().map(Whisker::summary).collect::<Vec<_>>(),
        })
    }
}

impl Whisker<'_> {
    fn row(
        &mut self,
        row: &Row,
        motion: &StreamMotion,
        files: &mut TrackFiles,
    ) -> Result<wcal_acquisition::tracks::ContactPoint> {
        let known = motion.at(row.t_s);
        let tracked = self.locator.push(row, &known, |middle| {
            let relative = motion.relative(row.t_s, &self.kernel, middle);
            (relative, self.chain.spread(), self.chain.row_noise_nmm2())
        })?;
        let (base, base_mm_s) = (known.base, known.base_mm_s);
        let flags = row.flags.with(tracked.flags);
        self.rows += 1;
        self.flagged += u64::from(!flags.none());
        self.outside += u64::from(row.moments.is_some_and(|m| !m.valid));
        let row = TrackRow {
            point: i64::try_from(row.serial).unwrap_or(i64::MAX),
            t_s: row.t_s,
            whisker: &self.loaded.name,
            flags,
            doubts: &self.doubts,
            moments: tracked.moments,
            answer: tracked.answer.as_ref(),
            base_mm_s,
            base,
            touching: row.touching,
            segment: tracked.segment,
            regions: &tracked.regions,
            several: tracked.several,
        };
        files.row(&row)?;
        Ok(row.message())
    }

    fn summary(&self) -> Value {
        let l = self.loaded;
        let noise = self.chain.detector().noise().map(|(noise, limits)| {
            json!({
                "block_sd_nmm": [noise.block[(0, 0)].sqrt(), noise.block[(1, 1)].sqrt()],
                "level_sd_nmm": [noise.level[(0, 0)].sqrt(), noise.level[(1, 1)].sqrt()],
                "drift_nmm_s": noise.drift_nmm_s, "level_limit": limits.level, "abrupt_limit": limits.abrupt,
            })
        });
        let mut summary = json!({
            "whisker": l.name, "rows": self.rows, "flagged_rows": self.flagged, "outside_valid_region": self.outside,
            "unusable_scans": self.unusable, "events": self.events, "segments": self.locator.history().segments(), "noise": noise,
            "doubts": l.doubts.messages(), "known_groove": self.locator.groove().and_then(KnownGroove::summary),
            "first_mode_hz": l.whisker().ok().map(first_mode_hz), "calibration_sha256": l.file.content_sha256,
        });
        if let Some(all) = summary.as_object_mut() {
            all.extend(self.locator.summary(l).as_object().cloned().unwrap_or_default());
        }
        summary
    }
}

/// What was lost, for people; none when nothing was.
pub fn lost_text([lost, unusable, cut_off]: [u64; 3], dropped: u64) -> Option<String> {
    let all = [
        (lost, "scans lost"),
        (dropped, "scans dropped here, the tracker being behind"),
        (unusable, "readings not usable"),
        (cut_off, "events cut off by a gap"),
    ];
    let messages: Vec<String> =
        all.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
    (!messages.is_empty()).then(|| format!("{}; flagged in status", messages.join(", ")))
}
