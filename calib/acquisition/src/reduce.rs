//! From `recording*.mcap` to `points.csv`, `holdout.csv` and `session.toml`.

use crate::assign::{Assigned, ChannelMap};
use crate::clock_watch::ClockWatch;
use crate::clocks::{BROKEN_CLOCK, ClockFit, ClockPair};
use crate::error::AcquisitionError;
use crate::lag;
use crate::message::{Scan, StagePosition, SweepEvent, topic};
use crate::pictures::{PartClocks, PicturedRow, write_pictures};
use crate::replay::{Message, read};
use crate::rig::Rig;
use crate::run_file::RunFile;
use crate::stage_track::Track;
use crate::tables::{self, Row, Stream};
use crate::windows::{Window, missing_share, windows_of};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use wcal_core::files::{FileError, read_text, remove_abandoned, write_atomic};

pub use crate::reduction::Reduction;

/// A row whose window misses more than this share of its scans is marked.
const MAX_MISSING: f64 = 0.1;
/// A clock that is off by more than this from one recording to the next was set, s.
const CLOCK_SET_S: f64 = 1.0;
/// Windows and moves that are looked at for a scan, on average over a recording: it lies in one, in
/// two where a clock was set back, and a sweep has two moves that compare the clocks. More are
/// events that no sweep made, and would take memory and time without end.
const MAX_WINDOWS_PER_SCAN: u64 = 16;

/// Recordings of a session in order: `recording.mcap`, `recording-2.mcap`, ...
pub fn recordings(folder: &Path) -> Vec<PathBuf> {
    let first = std::iter::once(folder.join("recording.mcap"));
    let later = (2..1000).map(|k| folder.join(format!("recording-{k}.mcap")));
    first.chain(later).take_while(|p| p.exists()).collect()
}

/// Refuses a recording without a byte: an interrupted copy, or a full disk. Tables made without it
/// would lack its rows in silence.
///
/// # Errors
/// Which one, and the way out.
pub(crate) fn refuse_empty(parts: &[PathBuf]) -> Result<(), AcquisitionError> {
    for part in parts {
        let about = std::fs::metadata(part).map_err(FileError::of("opening", part))?;
        if about.len() == 0 {
            return Err(AcquisitionError::input(
                part.display().to_string(),
                "a recording (copy it again, or remove the file if it never had content)",
                "0 bytes",
            ));
        }
    }
    Ok(())
}

/// Refuses recordings of which no row comes: empty tables would replace those of better recordings.
fn nothing_reduced(first: &Path, rows: usize, result: &Reduction) -> Result<(), AcquisitionError> {
    if rows > 0 {
        return Ok(());
    }
    let place = first.display().to_string();
    let (events, empty) = (result.events, result.empty_windows);
    if events > 0 {
        let expected = "a reading (a sweep that stopped before its first has nothing to reduce)";
        let found = format!("none among {events} events, {empty} windows without usable scans");
        return Err(AcquisitionError::input(place, expected, found));
    }
    let expected = format!("events of a sweep ({})", topic::EVENT);
    let why = match result.refused.text() {
        Some(refused) => format!(", {refused}"),
        None => ": what the sweep did is not known".to_owned(),
    };
    let found = format!("none among {} scans{why}", result.scans);
    Err(AcquisitionError::input(place, expected, found))
}

/// Rebuilds the tables of a recorded session.
///
/// # Errors
/// When rig, run file or recording cannot be read, or nothing was recorded; the tables are then as
/// they were.
pub fn reduce(folder: &Path) -> Result<Reduction, AcquisitionError> {
    // The session's own copy: the rig file that it was made from may have changed since.
    let rig = Rig::parse("rig.toml", &read_text(folder.join("rig.toml"))?)?;
    let run = RunFile::read(&folder.join("run.json"))?;
    let parts = recordings(folder);
    if parts.is_empty() {
        let place = folder.display().to_string();
        return Err(AcquisitionError::input(place, "recording.mcap", "none"));
    }
    refuse_empty(&parts)?;
    let mut result = Reduction::default();
    let mut rows = Vec::new();
    let mut origin_s = None;
    let mut clocks = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        let (own_clocks, mut own) = reduce_part(part, &rig, &mut origin_s, &mut result)?;
        clocks.push(own_clocks);
        own.iter_mut().for_each(|row| row.part = number);
        add_part(&mut rows, own);
    }
    nothing_reduced(&parts[0], rows.len(), &result)?;
    result.holdout = rows.iter().filter(|r| r.sealed).count();
    result.rows = rows.len() - result.holdout;
    result.outliers = rows.iter().map(|r| r.serials.len()).sum();
    result.marked = [Stream::Lost, Stream::Late, Stream::Moved]
        .map(|s| rows.iter().filter(|r| r.stream == s).count());
    let cameras: Vec<&str> = rig.camera.iter().map(|c| c.name.as_str()).collect();
    remove_abandoned(folder);
    // All text is made before the first file is written: an error leaves the old tables as they
    // were.
    let files = tables::write_tables(&rig, &rows, run.is_simulated())?;
    for (name, bytes) in &files {
        write_atomic(&folder.join(name), bytes)?;
    }
    let name = |part: &PathBuf| Some(part.file_name()?.to_string_lossy().into_owned());
    let names: Vec<String> = parts.iter().filter_map(name).collect();
    let added = added_later(folder);
    let session = |result: &Reduction| -> Result<(), AcquisitionError> {
        let text = tables::session_toml(&rig, &run, &names, result, &added)?;
        Ok(write_atomic(&folder.join("session.toml"), text.as_bytes())?)
    };
    // Pictures are large: where the disk has no room for them the tables are there.
    session(&result)?;
    let pictured = pictured_rows(&rows);
    result.pictures[0] = write_pictures(folder, &run.id, &cameras, &parts, &clocks, &pictured)?;
    if result.pictures[0] > 0 {
        session(&result)?;
    }
    Ok(result)
}

/// Adds the rows of a recording. A reading whose `done` was lost with the end of its recording is
/// made again: each step counts once, as it was made last.
fn add_part(rows: &mut Vec<Row>, own: Vec<Row>) {
    let again: BTreeSet<u32> = own.iter().map(|row| row.step).collect();
    rows.retain(|row| !again.contains(&row.step));
    rows.extend(own);
}

/// Entries of an earlier session.toml that name results from the pictures: the files are still
/// there.
fn added_later(folder: &Path) -> Vec<[String; 3]> {
    let text = read_text(folder.join("session.toml")).unwrap_or_default();
    let Ok(old) = text.parse::<toml::Table>() else {
        return Vec::new();
    };
    let entry = |[table, key]: [&str; 2]| {
        let value = old.get(table)?.get(key)?.as_str()?;
        let there = table != "files" || folder.join(value).is_file();
        there.then(|| [table.to_owned(), key.to_owned(), value.to_owned()])
    };
    tables::ADDED_LATER.into_iter().filter_map(entry).collect()
}

/// Settled rows with their numbers in points.csv or holdout.csv.
fn pictured_rows(rows: &[Row]) -> Vec<PicturedRow> {
    let mut next = [0; 2];
    let mut all = Vec::new();
    for row in rows {
        let next = &mut next[usize::from(row.sealed)];
        // Rows on the fly have no picture: no pose is held there.
        all.extend(row.average_s.map(|_| PicturedRow {
            part: row.part,
            step: row.step,
            point: *next,
            sealed: row.sealed,
        }));
        *next += 1;
    }
    all
}

/// What a recording holds beside the scans' wavelengths.
#[derive(Default)]
struct Contents {
    events: Vec<SweepEvent>,
    stage: Vec<StagePosition>,
    clock: ClockWatch,
    /// Events before the first fault of the clock.
    events_before_fault: usize,
    cameras: BTreeMap<String, ClockPair>,
    scans: u64,
}

/// First pass: events, stage positions, clocks.
fn read_contents(
    path: &Path,
    rig: &Rig,
    origin_s: &mut Option<f64>,
    result: &mut Reduction,
) -> Result<Contents, AcquisitionError> {
    let mut all = Contents {
        clock: ClockWatch::new(rig.clock_scale),
        ..Contents::default()
    };
    let (mut next_serial, mut pictures, mut frames) = (None::<u64>, 0, 0);
    // Two passes: a scan's delay is tested by the clocks of the whole recording.
    let end = read(path, |message| match message {
        Message::Scan(scan) => {
            let fault = all.clock.take(scan.serial, scan.host_s, scan.device_s);
            result.clock_faults.extend(fault.map(|f| f.to_string()));
            origin_s.get_or_insert(scan.device_s);
            all.scans += 1;
            // The unit numbers every scan, so that a jump is a loss (firmware-notes/sm130.md).
            let missing = next_serial.map_or(0, |n| scan.serial.saturating_sub(n));
            result.lost = result.lost.saturating_add(missing);
            result.gaps += u64::from(missing > 0);
            next_serial = Some(scan.serial.saturating_add(1));
        }
        Message::Stage(reading) => all.stage.push(reading),
        Message::Event(event) => {
            if event.kind == "pair-refused" {
                result.pairs[1] += 1;
                let why = || event.detail.clone();
                result.refused_why.get_or_insert_with(why);
            }
            result.pictures[1] += usize::from(event.kind == "picture-missed");
            all.events_before_fault += usize::from(all.clock.broken.is_none());
            all.events.push(event);
        }
        Message::Picture(camera, host_s, device_s) => {
            pictures += 1;
            // The list of frames has it, too, where there is one.
            let pair = all.cameras.entry(camera).or_default();
            pair.add(host_s, device_s);
        }
        Message::Frame(frame) => {
            frames += 1;
            let device_s = frame.device_s.unwrap_or(frame.host_s);
            let pair = all.cameras.entry(frame.camera).or_default();
            pair.add(frame.host_s, device_s);
        }
        Message::PosePicture(..) | Message::Other(..) => {}
    })?;
    // Older recordings contain every picture and no list of frames.
    result.pairs[0] += if frames > 0 { frames } else { pictures } / 2;
    all.clock.settle_held();
    result.scans += all.scans;
    result.events += all.events.len();
    result.cut_off += usize::from(end.cut_off.is_some());
    result.damaged_chunks += end.damaged_chunks;
    result.repeated += end.repeated;
    result.refused.join(end.refused);
    Ok(all)
}

fn reduce_part(
    path: &Path,
    rig: &Rig,
    origin_s: &mut Option<f64>,
    result: &mut Reduction,
) -> Result<(PartClocks, Vec<Row>), AcquisitionError> {
    let all = read_contents(path, rig, origin_s, result)?;
    let (events, clocks, scans) = (&all.events, &all.clock.pair, all.scans);
    let cameras = all.cameras.into_iter();
    let cameras: BTreeMap<String, ClockFit> = cameras
        .filter_map(|(name, pair)| Some((name, pair.fit()?)))
        .collect();
    result.camera_clocks.extend(cameras.clone());
    // Without a scan there is no device time, and so no row.
    let (Some(fit), Some(origin_s)) = (clocks.fit(), *origin_s) else {
        return Ok(Default::default());
    };
    // Session time goes on as if the clock had not been set between two recordings.
    let origin_s = origin_s + add_clock(result, fit, rig.clock_scale);
    let track = Track::new(&all.stage, &fit, rig.stage.zero_mm);
    let foreign = |found: String| {
        let place = format!("{}: {}", path.display(), topic::EVENT);
        let expected = "events of one sweep, whose windows hold a scan once";
        AcquisitionError::input(place, expected, found)
    };
    let mut windows = windows_of(events, scans).map_err(foreign)?;
    // A recording has millions of scans: each finds its windows by a search in time.
    windows.sort_by(|a, b| a.begin_s.total_cmp(&b.begin_s));
    // Second pass: samples into their windows.
    let map = ChannelMap::new(rig);
    let syncs: Vec<&SweepEvent> = events.iter().filter(|e| e.kind == "sync").collect();
    let mut sync_signals = vec![Vec::new(); syncs.len()];
    let (mut last, mut lost) = (None::<(u64, f64)>, Vec::new());
    let (mut count, mut visits) = (0, 0);
    let most_visits = MAX_WINDOWS_PER_SCAN.saturating_mul(scans);
    read(path, |message| {
        let Message::Scan(scan) = message else { return };
        if visits > most_visits {
            return;
        }
        visits += syncs.len() as u64;
        let t_s = scan.device_s;
        let unclocked = all.clock.broken.is_some_and(|first| count >= first);
        count += 1;
        if let Some((_, last_s)) = last.filter(|(serial, _)| scan.serial > serial.saturating_add(1))
        {
            lost.push([last_s, t_s]);
        }
        last = Some((scan.serial, t_s));
        let late = !unclocked && clocks.is_late(scan.host_s, t_s);
        result.late += u64::from(late);
        result.unclocked += u64::from(unclocked);
        if !unclocked {
            result.longest_delay_s = result.longest_delay_s.max(clocks.delay_s(scan.host_s, t_s));
        }
        let assigned = map.assign(&scan.reading());
        for (sync, signal) in syncs.iter().zip(&mut sync_signals) {
            if (sync.begin_s..=sync.end_s).contains(&t_s)
                && let Some([a, b]) = assigned.usable()
            {
                signal.push((t_s, a, b));
            }
        }
        // A window that was over before the clock's fault has no scans from after it, whatever time
        // they state.
        let from_event = if unclocked {
            all.events_before_fault
        } else {
            0
        };
        visits += take_sample(
            &mut windows,
            &scan,
            &assigned,
            late || unclocked,
            from_event,
        );
    })?;
    if visits > most_visits {
        return Err(foreign(format!(
            "more than {MAX_WINDOWS_PER_SCAN} for a scan"
        )));
    }
    for signal in &sync_signals {
        let depth_mm = |t_s| track.at(t_s).map(|place| place.0);
        result.lag_s.extend(lag::estimate_s(signal, depth_mm));
    }
    // The stage's position is known by host time: without aligned clocks no row can be assigned
    // one.
    if clocks.is_unaligned() {
        windows.iter_mut().for_each(|window| window.late = true);
    }
    // In the order of the work, which a clock that was set does not change.
    windows.sort_by_key(|w| w.event);
    let row = |w: &Window| row_of(rig, &events[w.event], w, &track, origin_s, &lost);
    let rows: Vec<Row> = windows.iter().filter_map(row).collect();
    result.empty_windows += windows.len() - rows.len();
    let clocks = PartClocks {
        interrogator: Some(fit),
        cameras,
        origin_s,
    };
    Ok((clocks, rows))
}

/// Adds a recording's clock; by how much it was set since the first one, s.
fn add_clock(result: &mut Reduction, fit: ClockFit, clock_scale: f64) -> f64 {
    let set_s = result
        .clocks
        .first()
        .map_or(0.0, |first| clock_set_s(first, &fit, clock_scale));
    if set_s != 0.0 {
        result.clock_faults.push(format!(
            "the clock was set by {set_s:.3} s between two recordings"
        ));
    }
    result.clocks.push(fit);
    set_s
}

/// A scan into the windows that it lies in, of the events from `from_event` on; windows on the fly
/// may touch each other, and none is longer than a settled one. Returns how many windows were
/// looked at.
fn take_sample(
    windows: &mut [Window],
    scan: &Scan,
    assigned: &Assigned,
    late: bool,
    from_event: usize,
) -> u64 {
    let mut visits = 0;
    let t_s = scan.device_s;
    let from = windows.partition_point(|w| w.end_s < t_s);
    for window in windows[from..].iter_mut().take_while(|w| w.begin_s <= t_s) {
        visits += 1;
        if t_s > window.end_s || window.event < from_event {
            continue;
        }
        window.late |= late;
        let samples = &mut window.samples;
        let Some(sensing) = assigned.usable() else {
            samples.unusable += 1;
            continue;
        };
        samples.serials.push(scan.serial);
        // NaN in place of a missing reference: the lists of a window keep one index a scan.
        samples.times_s.push(t_s - window.begin_s);
        let reference_nm = assigned.reference_nm.unwrap_or(f64::NAN);
        samples.reference_nm.push(reference_nm);
        let both = samples.sensing_nm.iter_mut().zip(sensing);
        both.for_each(|(all, nm)| all.push(nm));
    }
    visits
}

/// By how much a clock was set between two recordings, s; 0 within what a working clock may have
/// drifted. The computer's clock tells, but for that of an accelerated bench, which begins anew
/// with each run.
fn clock_set_s(first: &ClockFit, fit: &ClockFit, clock_scale: f64) -> f64 {
    let at_s = fit.origin_host_s;
    let set_s = fit.device_s(at_s) - first.device_s(at_s);
    // Hours may pass between two runs, in which a working clock drifts on.
    let drift_s = CLOCK_SET_S + BROKEN_CLOCK * (at_s - first.origin_host_s).abs();
    if clock_scale == 1.0 && set_s.abs() > drift_s {
        set_s
    } else {
        0.0
    }
}

fn row_of(
    rig: &Rig,
    event: &SweepEvent,
    window: &Window,
    track: &Track,
    origin_s: f64,
    lost: &[[f64; 2]],
) -> Option<Row> {
    let mean = window.samples.mean()?;
    let moving = event.kind == "moving";
    let (begin_s, end_s) = (window.begin_s, window.end_s);
    // A settled row is true at its window's end, a moving one at the mean time of its scans.
    let (t_s, stage_mm, speed_mm_s) = if moving {
        let t_s = begin_s + mean.time_s;
        let (mm, speed) = track.at(t_s)?;
        (t_s, mm, speed.abs())
    } else {
        (end_s, track.mean(begin_s, end_s)?, 0.0)
    };
    // Late first: where times are doubtful, so is what the stage did meanwhile.
    let stream = match window.late {
        true => Stream::Late,
        false if !moving && track.has_left(event.target_mm, begin_s, end_s) => Stream::Moved,
        false if missing_share(window, lost) > MAX_MISSING => Stream::Lost,
        false => Stream::Whole,
    };
    // In front of the wire the groove holds nothing, and the row states no groove.
    let loaded = event.role != "rest" && stage_mm >= 0.0;
    let trajectory = rig.trajectory(event.trajectory).filter(|_| loaded);
    let serials = mean.outliers.iter().map(|k| window.samples.serials[*k]);
    Some(Row {
        role: event.role.clone(),
        part: 0,
        step: event.step,
        sealed: event.sealed,
        trajectory: event.trajectory,
        replicate: event.replicate,
        t_s: t_s - origin_s,
        stage_mm,
        direction: event.direction,
        speed_mm_s,
        dwell_s: if moving { 0.0 } else { end_s - event.arrived_s },
        average_s: (!moving).then_some(end_s - begin_s),
        groove_mm: trajectory.map(|t| t.groove_mm(stage_mm)),
        settled: (event.settled || moving) && stream != Stream::Moved,
        stream,
        unusable: window.samples.unusable,
        serials: serials.collect(),
        mean,
    })
}
