//! The whiskers of a stream: readings in, rows and events out.

use super::TrackArgs;
use super::motion;
use super::output::{TrackFiles, TrackRow, event_message};
use super::surface::write_surface;
use super::trust::WhiskerModel;
use anyhow::{Context, Result, bail};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use wcal_acquisition::clocks::ClockPair;
use wcal_acquisition::message::{StagePosition, SweepEvent};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::tracks::TrackChannels;
use wcal_acquisition::whisker_reader::WhiskerReader;
use wcal_core::device::FbgReading;
use wcal_track::known_groove::{KnownGroove, KnownPlace};
use wcal_track::row_tracker::{RowInput, RowTracker};
use wcal_track::stream::{BaseMotion, Row, SignalChain, SignalChainSettings, first_mode_hz};

/// One whisker of a stream.
struct Whisker<'a> {
    loaded: &'a WhiskerModel<'a>,
    doubts: String,
    reader: WhiskerReader,
    chain: SignalChain,
    tracker: RowTracker<'a>,
    rows: u64,
    flagged: u64,
    outside: u64,
    unusable: u64,
    events: BTreeMap<&'static str, u64>,
}

/// All whiskers with what they share.
pub struct Whiskers<'a> {
    all: Vec<Whisker<'a>>,
    base: Option<BaseMotion>,
    base_mm_s: Option<f64>,
    /// Groove that the stage carries, base frame, since a trajectory was mounted, and the trajectories by number.
    groove: Option<BaseMotion>,
    trajectories: BTreeMap<u32, Vector3<f64>>,
    tare_s: f64,
    object_class: Option<String>,
    zero_mm: f64,
    clocks: ClockPair,
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
    /// Whiskers of a rig.
    ///
    /// # Errors
    /// Where gratings, calibration, filter or base do not fit.
    pub fn new(args: &TrackArgs, place: &str, rig: &Rig, loaded: &'a [WhiskerModel<'a>]) -> Result<Self> {
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
            let settings = SignalChainSettings { first_mode_hz: first_mode_hz(&l.card.whisker), ..settings };
            Ok(Whisker {
                loaded: l,
                doubts: l.doubts.codes(),
                reader: WhiskerReader::new(place, &rig.interrogator, &l.name, fbg)?,
                chain: SignalChain::new(&settings, map)?,
                tracker: l.row_tracker(&l.name, args.sweep, args.tare_s),
                rows: 0,
                flagged: 0,
                outside: 0,
                unusable: 0,
                events: BTreeMap::new(),
            })
        };
        Ok(Self {
            all: loaded.iter().map(one).collect::<Result<_>>()?,
            base: base_motion(place, rig)?,
            base_mm_s: args.base_mm_s,
            groove: None,
            trajectories: rig.trajectory.iter().map(|t| (t.id, Vector3::from(t.direction))).collect(),
            tare_s: args.tare_s,
            object_class: args.object_class.clone(),
            zero_mm: rig.stage.zero_mm,
            clocks: ClockPair::default(),
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

    /// Time since the first scan by the device's clock, s.
    pub fn elapsed_s(&self, reading: &FbgReading) -> f64 {
        let now = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        self.origin_s.map_or(0.0, |origin| now - origin)
    }

    /// Takes a position of the stage that carries the base.
    pub fn stage(&mut self, position: &StagePosition) {
        if let Some(origin_s) = self.origin_s
            && let Some(device_s) = self.clocks.device_s(position.host_s)
        {
            for carried in self.base.iter_mut().chain(&mut self.groove) {
                carried.push(device_s - origin_s, position.measured_mm - self.zero_mm);
            }
        }
    }

    /// Takes what a sweep did: from a mount on, the stage carries the groove along that trajectory, unless the rig says that it carries the
    /// base.
    pub fn sweep_event(&mut self, event: &SweepEvent) {
        let direction =
            self.trajectories.get(&event.trajectory).filter(|_| event.kind == "mount" && self.base.is_none());
        if let Some(direction) = direction {
            self.groove = Some(BaseMotion::new(Isometry3::identity(), Some(*direction)));
        }
    }

    /// Compares answers with the groove of the session's readings; `whisker` is whose session it is, none where the rig has one alone.
    pub fn know_groove(&mut self, places: &[KnownPlace], whisker: Option<&str>) {
        let one = self.all.len() == 1;
        for w in self.all.iter_mut().filter(|w| one || whisker.is_some_and(|id| id == w.loaded.name)) {
            w.tracker.groove = KnownGroove::new(places.to_vec(), &w.loaded.card.whisker);
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
                let carried = [self.base.as_ref(), self.groove.as_ref()];
                let message = w.row(&row, carried, self.base_mm_s, files)?;
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
            motion::say(&w.tracker.motion, &whose, w.rows);
            motion::say_several(&whose, w.tracker.several_rows);
            if let Some(said) = w.tracker.groove.as_ref().and_then(KnownGroove::message) {
                eprintln!("{whose}{said}");
            }
        }
    }

    /// Whether rows are in doubt for their motion, and whether stated regions do not hold the known groove.
    pub fn doubtful(&self) -> [bool; 2] {
        let misstated = |w: &Whisker<'_>| w.tracker.groove.as_ref().is_some_and(KnownGroove::misstated);
        [self.all.iter().any(|w| w.tracker.motion.any()), self.all.iter().any(misstated)]
    }

    /// Writes cloud and surface beside the table.
    ///
    /// # Errors
    /// Where the disk does not take it.
    pub fn surface(&self, out: &Path) -> Result<Value> {
        write_surface(out, &self.all.iter().map(|w| &w.tracker.history).collect::<Vec<_>>())
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
        [base, groove]: [Option<&BaseMotion>; 2],
        base_mm_s: Option<f64>,
        files: &mut TrackFiles,
    ) -> Result<wcal_acquisition::tracks::ContactPoint> {
        let [base, groove] = [base, groove].map(|b| b.and_then(|b| b.at(row.t_s)));
        // The groove goes on as the base would go back.
        let past_groove = groove.and_then(|g| g.velocity_mm_s).map(|v| -v);
        let velocity = base.and_then(|b| b.velocity_mm_s).or(past_groove);
        let velocity = velocity.or(base_mm_s.map(|v| Vector3::z() * v));
        let base_mm_s = base.and_then(|b| b.along_z_mm_s()).or(base_mm_s);
        if row.moments.is_none() {
            // What happened in between is not known: the tracker starts anew.
            self.tracker.restart();
        }
        let input = RowInput { t_s: row.t_s, moments: row.moments, base, base_mm_s, velocity_mm_s: velocity };
        let tracked = self.tracker.push(&input);
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
        json!({
            "whisker": l.name, "rows": self.rows, "flagged_rows": self.flagged, "outside_valid_region": self.outside,
            "unusable_scans": self.unusable, "events": self.events, "segments": self.tracker.history.segments(), "noise": noise, "doubts": l.doubts.messages(),
            "untrained_motion": motion::summary(&self.tracker.motion), "known_groove": self.tracker.groove.as_ref().and_then(KnownGroove::summary),
            "several_contacts": motion::several_summary(self.tracker.several_rows),
            "first_mode_hz": first_mode_hz(&l.card.whisker), "calibration_sha256": l.file.content_sha256,
            "model_sha256": l.card.weights_sha256, "trained_on_simulation": l.card.trained_on_simulation,
        })
    }
}

/// Motion of the base where the rig says where it is.
fn base_motion(place: &str, rig: &Rig) -> Result<Option<BaseMotion>> {
    let Some(base) = &rig.base else { return Ok(None) };
    let m = base.world_from_base;
    let turn = Matrix3::from_fn(|i, j| m[i][j]);
    let sound = (turn * turn.transpose() - Matrix3::identity()).norm() < 1e-3 && turn.determinant() > 0.0;
    if !sound || m[3] != [0.0, 0.0, 0.0, 1.0] {
        bail!("{place}: base.world_from_base: expected a rotation and a shift in mm, found {m:?}");
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&turn));
    let at_zero = Isometry3::from_parts(Translation3::new(m[0][3], m[1][3], m[2][3]), turn);
    let flat = |a: [f64; 3]| a.iter().any(|x| !x.is_finite()) || Vector3::from(a).norm() <= 1e-6;
    if base.carried_along.is_some_and(flat) {
        bail!("{place}: base.carried_along: expected a direction, found {:?}", base.carried_along);
    }
    Ok(Some(BaseMotion::new(at_zero, base.carried_along.map(Vector3::from))))
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
