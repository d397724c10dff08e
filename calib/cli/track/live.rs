//! Tracks of a stream: live from the interrogator, or replayed from recordings.

use super::arguments::{ACCURACY, LAG_S, PREFIX_S, RATE_HZ, TrackArgs};
use super::feed::{FeedInput, FeedItem};
use super::live_track::LiveTrack;
use super::output;
use super::recorded_motion::{recorded_motion, session_folder};
use crate::interrupt;
use crate::progress::Progress;
use crate::simulated::is_simulated;
use anyhow::{Result, anyhow, bail};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use wcal_acquisition::clock_watch::ClockFault;
use wcal_acquisition::message::StagePosition;
use wcal_acquisition::record::open_interrogator;
use wcal_acquisition::recorder::Recorder;
use wcal_acquisition::replay::{Message, read};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::sweep::Watched;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Deadline, Interrupt};
use wcal_core::device::{DeviceError, DeviceErrorKind, FbgReading};
use wcal_core::lock::FileLock;
use wcal_core::rig_devices::DeviceOpener;
use wcal_core::standstill::blame;
use wcal_drivers::Drivers;
use wcal_track::known_groove::known_places;
use wcal_track::reading::MotionAccuracy;
use wcal_track::stream_source::{StreamFindings, StreamSettings, StreamSource, lost_text};
use wcal_track::track::{Input, track as track_all};
use wcal_track::track_document::{TRACK_FORMAT, TrackDocument, TrackSource};
use wcal_track::track_table::TrackFiles;
use wcal_track::trust::WhiskerModel;
use wcal_track::whisker_track::{Outcome, WhiskerTrack};

/// A stream that is silent this long has failed.
const SILENCE: Duration = Duration::from_secs(2);
/// Scans between two reports of progress.
const SCANS_SHOWN: u64 = 1000;
/// Scans that may wait for the tracker; further ones are dropped, counted and flagged.
const QUEUE: usize = 20_000;
/// Messages of a recording that wait for the tracker.
const RECORDED: usize = 256;
/// Time between questions to a stage that carries the base.
const STAGE_POLL: Duration = Duration::from_millis(20);

/// Whether a calibration was made on simulated data.
fn by_simulation(loaded: &[WhiskerModel<'_>]) -> bool {
    loaded.iter().any(|l| l.file.provenance.simulated)
}

/// Tracks recordings, one after the other.
///
/// # Errors
/// Where one cannot be read or is not the rig's.
pub(crate) fn replay(
    args: &TrackArgs,
    parts: &[PathBuf],
    place: &str,
    rig: &Rig,
    loaded: &[WhiskerModel<'_>],
) -> Result<ExitCode> {
    let log = recorded_motion(args, parts)?;
    let (mut stream, mut tracks) =
        StreamSource::new(settings(args, rig), (place, rig), loaded, log)?;
    if let Some((table, whisker)) = session_folder(args).and_then(session_points) {
        stream.know_groove(&mut tracks, &known_places(&table)?, whisker.as_deref());
    }
    let live = LiveTrack::open(args, loaded)?;
    let mut files = output::create(&args.out)?;
    let simulated = parts.iter().any(|part| is_simulated(part)) || by_simulation(loaded);
    live.iter()
        .for_each(|live| live.watch(&mut files, simulated));
    let progress = Progress::new("track");
    let (sender, receiver) = sync_channel(RECORDED);
    let (tracked, cut_off) = std::thread::scope(|scope| {
        let reader = scope.spawn(move || recorded(parts, &sender));
        let scans = Scans {
            live: live.as_ref(),
            ..Scans::new(args, &receiver, &mut stream, Some(&progress))
        };
        let tracked = track_all(scans, &mut tracks, &mut files);
        // Whoever waits for room must not wait for ever.
        drop(receiver);
        (tracked, reader.join())
    });
    drop(progress);
    if let Some(live) = live {
        live.end(&tracked, &stream, 0);
    }
    let cut_off = cut_off.map_err(|_| anyhow!("reading the recordings failed"))?;
    let (tracked, cut_off) = (tracked?, cut_off?);
    let source = TrackSource::Recordings(parts.to_vec());
    conclude(
        args,
        (&stream, &tracks, tracked),
        files,
        (source, simulated),
        (0, Some(cut_off)),
    )
}

/// Reads recordings into a queue, as far as somebody takes from it; those that are cut off.
fn recorded(parts: &[PathBuf], queue: &SyncSender<FeedItem>) -> Result<Vec<String>> {
    let mut cut_off = Vec::new();
    for part in parts {
        let (mut scans, mut taken) = (0_u64, queue.send(FeedItem::Recording).is_ok());
        let end = read(part, |message| {
            let item = match message {
                Message::Scan(scan) => {
                    scans += 1;
                    FeedItem::Scans(vec![scan.reading()], 0)
                }
                Message::Stage(position) => FeedItem::Stage(position),
                Message::Event(event) => FeedItem::Event(event),
                _ => return,
            };
            taken = taken && queue.send(item).is_ok();
        })?;
        if scans == 0 && taken {
            bail!(
                "{}: expected scans of an interrogator, found none",
                part.display()
            );
        }
        if !end.is_whole() {
            eprintln!(
                "warning: {}: {end}; the readable part is tracked",
                part.display()
            );
            cut_off.push(part.display().to_string());
        }
    }
    Ok(cut_off)
}

/// Tracks the rig's interrogator until Ctrl-C, the end of the time or a fault.
///
/// # Errors
/// Where the devices cannot be used; a fault while tracking is one too, after what was tracked is
/// written.
pub(crate) fn track(
    args: &TrackArgs,
    place: &str,
    rig: &Rig,
    loaded: &[WhiskerModel<'_>],
) -> Result<ExitCode> {
    if let Some(log) = &args.motion {
        bail!(
            "--motion {}: expected a table or a recording to go with it, found a live stream",
            log.display()
        );
    }
    let (mut stream, mut tracks) =
        StreamSource::new(settings(args, rig), (place, rig), loaded, None)?;
    let live = LiveTrack::open(args, loaded)?;
    let clock = HostClock::start(rig.clock_scale);
    let interrupt = interrupt::watch()?;
    let mut interrogator =
        open_interrogator(&mut Drivers::new(&interrupt), &rig.interrogator, clock)?;
    let identity = interrogator.identity()?;
    let about = || BTreeMap::from([("rig".to_owned(), place.to_owned())]);
    let recorder = args
        .mcap
        .as_ref()
        .map(|path| Recorder::create(path, about()).map(Arc::new))
        .transpose()?;
    // An earlier track is replaced only when the device has answered.
    let mut files = output::create(&args.out)?;
    let simulated = identity.is_virtual() || by_simulation(loaded);
    live.iter()
        .for_each(|live| live.watch(&mut files, simulated));
    let done = AtomicBool::new(false);
    let (intake, receiver) = FeedInput::new(QUEUE, recorder.clone());
    let carried = rig.base.as_ref().is_some_and(|b| b.carried_along.is_some());
    let tracked = std::thread::scope(|scope| {
        let reader = scope.spawn(|| acquire(interrogator.as_mut(), &intake, &done));
        let watcher =
            carried.then(|| scope.spawn(|| watch_stage(rig, clock, &intake, &interrupt, &done)));
        let ends = || done.load(Ordering::SeqCst) || interrupt.signal().is_some();
        let scans = Scans {
            ends: Some(&ends),
            live: live.as_ref(),
            ..Scans::new(args, &receiver, &mut stream, None)
        };
        let result = track_all(scans, &mut tracks, &mut files);
        done.store(true, Ordering::SeqCst);
        // Whoever waits for room must not wait for ever.
        drop(receiver);
        // A thread that panicked has been a fault of the stream: what was tracked is kept.
        for thread in std::iter::once(reader).chain(watcher) {
            let _ = thread.join();
        }
        result
    });
    let dropped = intake.dropped();
    // The intake shares the recorder, which only its last owner can close.
    drop(intake);
    match recorder.map(Arc::try_unwrap) {
        Some(Ok(recorder)) => {
            recorder
                .refused()
                .text()
                .iter()
                .for_each(|text| eprintln!("warning: {text}"));
            recorder.finish()?;
        }
        Some(Err(_)) => bail!("recording: a thread still holds it"),
        None => {}
    }
    if let Some(live) = live {
        live.end(&tracked, &stream, dropped);
    }
    let source = format!("{} {} {}", identity.driver, identity.model, identity.serial);
    if let Some(signal) = interrupt.signal() {
        eprintln!(
            "Interrupted by {}; what was tracked until then is written to {}",
            signal.name(),
            args.out.display()
        );
    }
    let source = (TrackSource::Device(source), simulated);
    let spent = *tracked.as_ref().unwrap_or(&Duration::ZERO);
    let code = conclude(
        args,
        (&stream, &tracks, spent),
        files,
        source,
        (dropped, None),
    )?;
    tracked.map(|_| code)
}

/// The disk takes no more.
fn unrecorded(why: &impl std::fmt::Display) -> DeviceError {
    DeviceError::new(
        DeviceErrorKind::Configuration,
        "recording",
        "record",
        "space on disk",
        why.to_string(),
    )
}

/// Reads the interrogator into the intake.
fn acquire(
    interrogator: &mut dyn wcal_core::device::Interrogator,
    intake: &FeedInput,
    done: &AtomicBool,
) {
    let _watched = Watched(|e| intake.fail(e));
    // From scan to scan; time in which this program itself stood still is not the unit's.
    let mut heard = Deadline::uninterruptible(SILENCE);
    if let Err(e) = interrogator.start() {
        return intake.fail(e);
    }
    while !done.load(Ordering::SeqCst) {
        // Silence is what a look after its end finds, too.
        let over = heard.is_over();
        // A short wait, so that the end of the run is noticed in silence, too.
        let readings = match interrogator.read(Duration::from_millis(50)) {
            Ok(readings) => readings,
            // The user wants an end, which the tracker hears of by itself.
            Err(e) if e.kind == DeviceErrorKind::Interrupted => break,
            Err(e) => return intake.fail(blame(e)),
        };
        if readings.is_empty() {
            if over {
                let found = format!("silence for {} s", SILENCE.as_secs());
                let kind = DeviceErrorKind::Timeout;
                let error =
                    DeviceError::new(kind, "interrogator", "read the stream", "scans", found);
                return intake.fail(blame(error));
            }
            continue;
        }
        heard = Deadline::uninterruptible(SILENCE);
        match intake.scans(readings) {
            Ok(true) => {}
            Ok(false) => break,
            Err(e) => return intake.fail(unrecorded(&e)),
        }
    }
    // What was read is tracked; a unit that does not confirm the end changes nothing.
    let _ = interrogator.stop();
}

/// Asks the stage that carries the base where it is; it is never moved from here.
fn watch_stage(
    rig: &Rig,
    clock: HostClock,
    intake: &FeedInput,
    interrupt: &Interrupt,
    done: &AtomicBool,
) {
    let _watched = Watched(|e| intake.fail(e));
    // Two programs on one serial line take each other's replies.
    let serial = !rig.stage.port.starts_with("tcp://");
    let lock = serial
        .then(|| FileLock::of_port(&rig.stage.port, "track"))
        .transpose();
    let opened = lock
        .map_err(|held| {
            let expected = "a line that no other program uses";
            DeviceError::new(
                DeviceErrorKind::Configuration,
                "stage",
                "open",
                expected,
                held.to_string(),
            )
        })
        .and_then(|lock| Ok((lock, Drivers::new(interrupt).stage(&rig.stage, clock)?)));
    let (_lock, mut stage) = match opened {
        Ok(opened) => opened,
        Err(e) => return intake.fail(e),
    };
    while !done.load(Ordering::SeqCst) {
        match stage.read() {
            Ok(reading) => {
                if let Err(e) = intake.stage(StagePosition::from(&reading), &reading) {
                    return intake.fail(unrecorded(&e));
                }
            }
            Err(e) if e.kind == DeviceErrorKind::Interrupted => return,
            Err(e) => return intake.fail(e),
        }
        std::thread::sleep(STAGE_POLL);
    }
}

/// The scans of a queue as a source of readings, until the time that was asked for is over or
/// somebody ends it.
struct Scans<'q, 'a> {
    args: &'q TrackArgs,
    receiver: &'q Receiver<FeedItem>,
    stream: &'q mut StreamSource<'a>,
    /// Of a live stream: a clock that stands still is a fault.
    ends: Option<&'q dyn Fn() -> bool>,
    progress: Option<&'q Progress>,
    live: Option<&'q LiveTrack>,
    ready: VecDeque<Input>,
    scans: u64,
    over: bool,
}

impl<'q, 'a> Scans<'q, 'a> {
    fn new(
        args: &'q TrackArgs,
        receiver: &'q Receiver<FeedItem>,
        stream: &'q mut StreamSource<'a>,
        progress: Option<&'q Progress>,
    ) -> Self {
        Self {
            args,
            receiver,
            stream,
            ends: None,
            progress,
            live: None,
            ready: VecDeque::new(),
            scans: 0,
            over: false,
        }
    }

    fn scan(&mut self, reading: &FbgReading, dropped: bool) -> Result<()> {
        let fault = self.stream.hear(reading);
        if let Some(fault @ ClockFault::Stopped { .. }) = fault.filter(|_| self.ends.is_some()) {
            return Err(fault.error().into());
        }
        // A clock that may just have stepped must not end the run too early.
        let at_s = self.stream.elapsed_s(reading);
        self.over = self.args.seconds.is_some_and(|s| at_s >= s) && !self.stream.doubts_clock();
        if self.over {
            return Ok(());
        }
        self.ready.extend(self.stream.scan(reading, dropped)?);
        self.scans += 1;
        // Once a row.
        if let Some(live) = self.live.filter(|_| !self.ready.is_empty()) {
            live.stream(self.stream, self.scans, at_s);
        }
        if let Some(progress) = self
            .progress
            .filter(|_| self.scans.is_multiple_of(SCANS_SHOWN))
        {
            let stage = format!("{at_s:.0} s of the stream tracked");
            match self.args.seconds {
                Some(all_s) => progress.at(&stage, at_s / all_s),
                None => progress.stage(&stage),
            }
        }
        Ok(())
    }

    fn take(&mut self, item: FeedItem) -> Result<()> {
        match item {
            FeedItem::Scans(readings, mut dropped) => {
                for reading in &readings {
                    self.scan(reading, std::mem::take(&mut dropped) > 0)?;
                    if self.over {
                        break;
                    }
                }
            }
            FeedItem::Stage(position) => self.stream.stage(&position),
            FeedItem::Event(event) => self.stream.sweep_event(&event),
            FeedItem::Recording => self.stream.begin_recording(),
            FeedItem::Failed(error) => return Err(error.into()),
        }
        Ok(())
    }
}

impl Iterator for Scans<'_, '_> {
    type Item = Result<Input>;

    fn next(&mut self) -> Option<Self::Item> {
        if let Some(input) = self.ready.pop_front() {
            return Some(Ok(input));
        }
        if self.over || self.ends.is_some_and(|ends| ends()) {
            return None;
        }
        // Wakes up in silence, too, to hear of a signal or of the end.
        match self.receiver.recv_timeout(Duration::from_millis(100)) {
            Ok(item) => match self.take(item) {
                Ok(()) => Some(Ok(self.ready.pop_front().unwrap_or(Input::Idle))),
                Err(why) => Some(Err(why)),
            },
            Err(RecvTimeoutError::Timeout) => Some(Ok(Input::Idle)),
            Err(RecvTimeoutError::Disconnected) => None,
        }
    }
}

/// Summary, files, exit code.
fn conclude(
    args: &TrackArgs,
    (stream, tracks, tracked): (&StreamSource<'_>, &[WhiskerTrack<'_>], Duration),
    files: TrackFiles,
    (source, simulated): (TrackSource, bool),
    (dropped, cut_off): (u64, Option<Vec<String>>),
) -> Result<ExitCode> {
    let is_cut_off = cut_off.as_ref().is_some_and(|parts| !parts.is_empty());
    let StreamFindings {
        document,
        messages,
        outcome,
    } = stream.findings(tracks, (cut_off, dropped), tracked);
    let mut said = vec![format!(
        "track: lag {} s: t_s is the time of validity",
        document.lag_s.unwrap_or_default()
    )];
    said.extend(stream.unheard().into_iter().map(|name| {
        format!(
            "warning: {}no quiet prefix of {PREFIX_S} s: the noise of the rows is not known",
            super::whose(name)
        )
    }));
    let loss = lost_text(stream.lost(), dropped);
    said.extend(loss.iter().map(|loss| format!("warning: {loss}")));
    said.extend(
        stream
            .clock_faults()
            .iter()
            .map(|fault| format!("warning: interrogator: {fault}")),
    );
    said.extend(messages);
    let document = TrackDocument {
        format: TRACK_FORMAT,
        source,
        simulated,
        out: args.out.clone(),
        table: None,
        stream: Some(document),
    };
    let lost = loss.is_some() || is_cut_off || !stream.clock_faults().is_empty();
    super::arguments::conclude(
        args,
        files,
        &document,
        (
            said,
            outcome.and(Outcome {
                lost,
                ..Outcome::default()
            }),
        ),
    )
}

/// What the arguments say of a stream.
fn settings(args: &TrackArgs, rig: &Rig) -> StreamSettings {
    StreamSettings {
        rate_hz: RATE_HZ,
        lag_s: LAG_S,
        prefix_s: PREFIX_S,
        tare_s: args.tare_s.unwrap_or(0.0),
        base_mm_s: args.base_mm_s,
        vouched: args.sweep,
        diameter_sd: args.diameter_sd,
        friction: args.friction.unwrap_or_default(),
        // The delays of a host whose clock goes faster do so, too.
        accuracy: MotionAccuracy {
            clock_sd_s: ACCURACY.clock_sd_s * rig.clock_scale,
            ..ACCURACY
        },
    }
}

/// Table of a session's points, and whose whisker's session it is; none where the folder is no
/// reduced session.
fn session_points(folder: &Path) -> Option<(PathBuf, Option<String>)> {
    let session: toml::Table = wcal_core::files::read_text(folder.join("session.toml"))
        .ok()?
        .parse()
        .ok()?;
    let text = |v: Option<&toml::Value>| v.and_then(toml::Value::as_str).map(str::to_owned);
    let points = text(session.get("files").and_then(|f| f.get("points")))?;
    Some((folder.join(points), text(session.get("whisker_id"))))
}
