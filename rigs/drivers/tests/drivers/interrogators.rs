//! sm130 and Hyperion clients, and the cameras, against the virtual bench.

use crate::common::start;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use wcal_acquisition::assign::ChannelMap;
use wcal_acquisition::camera_pair::CameraPair;
use wcal_acquisition::monitor::Monitor;
use wcal_acquisition::recorder::Recorder;
use wcal_acquisition::replay::{End, Message, read};
use wcal_acquisition::rig::Rig;
use wcal_acquisition::sweep::acquire;
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::{Camera, DeviceErrorKind, FbgReading, Interrogator};
use wcal_drivers::bench::plant::Plant;
use wcal_drivers::bench::scene::{Scene, SceneState};
use wcal_drivers::bench::{VirtualBench, faults::Fault, scenario::Scenario};
use wcal_drivers::cameras::NetCamera;
use wcal_drivers::hyperion::Hyperion;
use wcal_drivers::sm130::Sm130;

/// How long a slow machine may take.
const PATIENCE: Duration = Duration::from_secs(600);

fn bench(extra: &str) -> VirtualBench {
    let text = format!("format = \"wcal-scenario/1\"\n{extra}");
    start(&text)
}

fn sm130(bench: &VirtualBench) -> Sm130 {
    Sm130::connect(
        &bench.addresses().sm130.to_string(),
        2000.0,
        HostClock::start(1.0),
        &Interrupt::default(),
    )
    .unwrap()
}

fn collect(unit: &mut dyn Interrogator, seconds: f64) -> Vec<FbgReading> {
    let start = Instant::now();
    let mut all = Vec::new();
    while start.elapsed().as_secs_f64() < seconds {
        all.extend(unit.read(Duration::from_millis(50)).unwrap());
    }
    all
}

/// At least `count` readings, however long a slow machine takes for them.
fn collect_count(unit: &mut dyn Interrogator, count: usize) -> Vec<FbgReading> {
    let (start, mut all) = (Instant::now(), Vec::new());
    while all.len() < count && start.elapsed() < PATIENCE {
        all.extend(unit.read(Duration::from_millis(50)).unwrap());
    }
    assert!(all.len() >= count, "{} of {count} scans", all.len());
    all
}

fn gaps(readings: &[FbgReading]) -> u64 {
    readings
        .windows(2)
        .map(|w| w[1].serial - w[0].serial - 1)
        .sum()
}

#[test]
fn two_thousand_scans_a_second_come_without_a_gap_in_every_framing() {
    for framing in [
        "token = \"inside\"",
        "token = \"outside\"",
        "split_bytes = 7",
        "token = \"outside\"\nsplit_bytes = 61",
    ] {
        let bench = bench(&format!("[interrogator]\n{framing}"));
        let mut unit = sm130(&bench);
        assert!(unit.identity().unwrap().model.contains("sm130"));
        unit.start().unwrap();
        let readings = collect_count(&mut unit, 600);
        unit.stop().unwrap();
        assert_eq!((gaps(&readings), unit.skipped_bytes()), (0, 0), "{framing}");
        let spacing =
            readings[100].clocks.device_s.unwrap() - readings[99].clocks.device_s.unwrap();
        assert!((spacing - 5e-4).abs() < 2e-6);
        // After streaming the unit answers commands again.
        assert_eq!(unit.command("#GET_SN").unwrap().trim(), "VIR130");
    }
}

#[test]
fn lost_scans_garbage_and_a_pulled_cable_are_seen() {
    let bench = bench("");
    let mut unit = sm130(&bench);
    unit.start().unwrap();
    let (start, mut readings) = (Instant::now(), collect(&mut unit, 0.2));
    bench.inject(Fault::LostSamples { count: 11 });
    bench.inject(Fault::StreamGarbage);
    while gaps(&readings) == 0 && start.elapsed() < PATIENCE {
        readings.extend(collect(&mut unit, 0.2));
    }
    assert_eq!(gaps(&readings), 11);
    assert!(unit.skipped_bytes() > 0);
    bench.inject(Fault::UnplugInterrogator);
    let error = loop {
        if let Err(e) = unit.read(Duration::from_millis(50)) {
            break e;
        }
    };
    assert_eq!(error.kind, DeviceErrorKind::Disconnected);
}

/// Scans lost in a pause of 0.6 s (1200 scans) by a unit that holds `buffer` of them.
fn lost_in_a_pause(buffer: usize) -> u64 {
    let bench = bench(&format!("[interrogator]\nbuffer = {buffer}"));
    let mut unit = sm130(&bench);
    unit.start().unwrap();
    let mut readings = collect_count(&mut unit, 100);
    bench.inject(Fault::StreamGap { seconds: 0.6 });
    // However late a slow machine sends: all that the pause can have cost has then been seen.
    let until = readings.last().unwrap().serial + 3000;
    let start = Instant::now();
    while readings.last().unwrap().serial < until && start.elapsed() < PATIENCE {
        readings.extend(unit.read(Duration::from_millis(50)).unwrap());
    }
    assert!(
        readings.last().unwrap().serial >= until,
        "{} of {until} scans",
        readings.len()
    );
    gaps(&readings)
}

#[test]
fn a_slow_reader_loses_only_what_the_buffer_cannot_hold() {
    let lost = lost_in_a_pause(400);
    assert!(
        lost >= 100,
        "{lost} lost of some 1200 made in the pause, 400 of them held"
    );
    assert_eq!(
        lost_in_a_pause(40_000),
        0,
        "a buffer that holds the pause loses nothing"
    );
}

#[test]
fn silence_is_a_timeout_and_nobody_there_is_a_disconnection() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let mute = std::thread::spawn(move || {
        let (mut link, _) = listener.accept().unwrap();
        let mut bytes = [0; 64];
        while link.read(&mut bytes).is_ok_and(|n| n > 0) {}
        let _ = link.write_all(b"late");
    });
    let mut unit = Sm130::connect(
        &address,
        1000.0,
        HostClock::start(1.0),
        &Interrupt::default(),
    )
    .unwrap();
    assert_eq!(unit.identity().unwrap_err().kind, DeviceErrorKind::Timeout);
    drop(unit);
    mute.join().unwrap();
    let nobody = Sm130::connect(
        &address,
        1000.0,
        HostClock::start(1.0),
        &Interrupt::default(),
    )
    .unwrap_err();
    assert_eq!(nobody.kind, DeviceErrorKind::Disconnected);
}

#[test]
fn a_hyperion_streams_the_same_scans_without_a_gap() {
    let bench = bench("");
    let h = &bench.addresses().hyperion;
    let clock = HostClock::start(1.0);
    let mut unit = Hyperion::connect(
        &h.commands.to_string(),
        &h.peaks.to_string(),
        2000.0,
        clock,
        &Interrupt::default(),
    )
    .unwrap();
    assert_eq!(unit.identity().unwrap().serial, "VIR155");
    unit.start().unwrap();
    let readings = collect_count(&mut unit, 600);
    assert_eq!(gaps(&readings), 0);
    unit.stop().unwrap();
    assert!(unit.read(Duration::from_millis(10)).is_err());
}

fn pair(bench: &VirtualBench) -> CameraPair {
    let open = |k: usize| -> Box<dyn Camera + Send> {
        let address = bench.addresses().cameras[k].to_string();
        Box::new(
            NetCamera::connect(&address, HostClock::start(1.0), &Interrupt::default()).unwrap(),
        )
    };
    CameraPair::new([open(0), open(1)], 2.0)
}

const WAIT: Duration = Duration::from_secs(3);

#[test]
fn pairs_are_of_one_trigger_and_their_skew_is_measured() {
    let bench = bench("[cameras]\nrate_hz = 20\nskew_ms = 0.7");
    let mut pair = pair(&bench);
    for _ in 0..5 {
        let p = pair.grab(WAIT).unwrap();
        assert_eq!(p.frames[0].trigger, p.frames[1].trigger);
        // Device times are seconds since 1970 as f64: some 0.2 us.
        assert!((p.skew_ms - 0.7).abs() < 1e-3, "{}", p.skew_ms);
        assert_eq!(p.frames[0].grey.len(), 640 * 480);
    }
    assert_eq!(pair.refused(), 0);
}

/// A scene that writes down what it is asked: first pixels trajectory, depth in 0.1 mm, board's
/// attitude, camera; later ones their column.
struct Told;

impl Plant for Told {
    fn moment_nmm(&mut self, _: u32, _: f64) -> [f64; 2] {
        [0.0; 2]
    }

    fn scene(&self) -> Option<Arc<dyn Scene>> {
        Some(Arc::new(Self))
    }
}

impl Scene for Told {
    fn picture(&self, camera: usize, state: &SceneState, size_px: [u32; 2], _: u64) -> Vec<u8> {
        let mut grey: Vec<u8> = (0..size_px[0] * size_px[1])
            .map(|k| (k % size_px[0]) as u8)
            .collect();
        grey[0] = state.trajectory as u8;
        grey[1] = (10.0 * state.depth_mm + 200.5) as u8;
        grey[2] = state.board.map_or(255, |k| k as u8);
        grey[3] = camera as u8;
        grey
    }
}

#[test]
fn pictures_show_the_stage_where_it_is_and_the_board_on_command() {
    let text = "format = \"wcal-scenario/1\"\nspeed = 10\n[stage]\nzero_mm = 20.0\n[stage.unit]\nstart_mm = 12.0\n\
        [mount]\nsteps_per_trajectory = 10\n[cameras]\nrate_hz = 20\nsize_px = [64, 48]\n";
    let bench = VirtualBench::start(Scenario::parse(text).unwrap(), Box::new(Told)).unwrap();
    let mut pair = pair(&bench);
    let p = pair.grab(WAIT).unwrap();
    // 12 mm with first contact at 20: 8 mm short; the mount stands at trajectory 0.
    assert_eq!(p.frames[0].grey[..4], [0, 120, 255, 0]);
    assert_eq!(p.frames[1].grey[..4], [0, 120, 255, 1]);
    // Whole pixels at rest.
    assert_eq!(p.frames[0].grey[64..72], [0, 1, 2, 3, 4, 5, 6, 7]);
    let mut link = std::net::TcpStream::connect(bench.addresses().cameras[0]).unwrap();
    let board_of = |pair: &mut CameraPair| pair.grab(WAIT).unwrap().frames[1].grey[2];
    // Nonsense and an attitude that there is not change nothing.
    link.write_all(b"board 3\nboard x\nboard 12\nhello\n")
        .unwrap();
    assert!((0..100).any(|_| board_of(&mut pair) == 3));
    assert!((0..5).all(|_| board_of(&mut pair) == 3));
    bench.inject(Fault::Board { view: None });
    assert!((0..100).any(|_| board_of(&mut pair) == 255));
    // In motion four by four pixels are one.
    let mut stage = std::net::TcpStream::connect(bench.addresses().stage_tcp).unwrap();
    stage.write_all(b"/1 home\n").unwrap();
    let binned = (0..200).any(|_| {
        let grey = pair.grab(WAIT).unwrap().frames[0].grey.clone();
        grey[4 * 64 + 16..4 * 64 + 24] == [4, 4, 4, 4, 5, 5, 5, 5]
    });
    assert!(binned, "a picture in motion");
    bench.inject(Fault::LostFrames { count: 3 });
    assert!(
        (0..10).all(|_| pair.grab(WAIT).is_ok()),
        "lost frames are left out, the others pair"
    );
}

#[test]
fn pairs_past_the_limit_and_a_frozen_camera_are_refused() {
    let bench = bench("[cameras]\nrate_hz = 20");
    let mut pair = pair(&bench);
    pair.grab(WAIT).unwrap();
    bench.inject(Fault::CameraSkew { ms: 5.0 });
    let refused = (0..20).find_map(|_| pair.grab(WAIT).err()).unwrap();
    assert!(
        refused.kind == DeviceErrorKind::DataInvalid && refused.found.contains("5.0"),
        "{refused}"
    );
    bench.inject(Fault::CameraSkew { ms: 0.0 });
    bench.inject(Fault::FrozenCamera { on: true });
    let frozen = (0..40)
        .filter_map(|_| pair.grab(WAIT).err())
        .find(|e| e.expected.contains("new picture"));
    assert!(frozen.is_some());
}

/// Records `bench_s` seconds at 2 kHz, ten times as fast as real time or as fast as the machine
/// can, and counts what the file holds.
fn recorded_without_a_gap(bench_s: f64) -> u64 {
    let (bench, dir) = (self::bench("speed = 10"), tempfile::tempdir().unwrap());
    let path = dir.path().join("recording.mcap");
    let recorder = Recorder::create(&path, Default::default()).unwrap();
    let rig = Rig::parse("rig.toml", include_str!("../../../virtual/rig.toml")).unwrap();
    let monitor = Mutex::new(Monitor::new(
        ChannelMap::new(&rig),
        [1.0, 1.0],
        rig.clock_scale,
    ));
    let done = AtomicBool::new(false);
    let mut unit = sm130(&bench);
    std::thread::scope(|scope| {
        scope.spawn(|| acquire(&mut unit, &monitor, &recorder, &done));
        let (start, wanted) = (Instant::now(), (bench_s * 2000.0) as u64);
        let enough = || monitor.lock().unwrap().counts().scans >= wanted;
        while !enough() && start.elapsed() < PATIENCE.max(Duration::from_secs_f64(bench_s)) {
            std::thread::sleep(Duration::from_millis(20));
        }
        done.store(true, Ordering::SeqCst);
    });
    recorder.finish().unwrap();
    assert!(monitor.into_inner().unwrap().fault().is_none());
    let (mut next, mut count, mut lost) = (None::<u64>, 0, 0);
    let end = read(&path, |message| {
        if let Message::Scan(scan) = message {
            lost += next.map_or(0, |n| scan.serial - n);
            next = Some(scan.serial + 1);
            count += 1;
        }
    });
    let size = std::fs::metadata(&path).unwrap().len();
    println!(
        "{bench_s} s: {count} scans, {lost} lost, {} bytes skipped, file {size} bytes",
        unit.skipped_bytes()
    );
    assert_eq!(
        (end.unwrap(), lost, unit.skipped_bytes()),
        (End::default(), 0, 0)
    );
    count
}

#[test]
fn twenty_seconds_at_two_kilohertz_are_recorded_without_a_gap() {
    assert!(recorded_without_a_gap(20.0) >= 40_000);
}

/// Ten minutes of bench time; run with `--ignored`.
#[test]
#[ignore = "takes a minute"]
fn ten_minutes_at_two_kilohertz_are_recorded_without_a_gap() {
    assert!(recorded_without_a_gap(600.0) >= 1_200_000);
}

/// A unit on a port of its own: waits for `owed` bytes, sends `late`, and answers each further
/// message with one of `more`.
fn unit(owed: usize, late: Vec<u8>, more: Vec<Vec<u8>>) -> (String, std::thread::JoinHandle<()>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let thread = std::thread::spawn(move || {
        let mut link = listener.accept().unwrap().0;
        let (mut seen, mut bytes) = (0, [0_u8; 512]);
        while seen < owed {
            seen += link.read(&mut bytes).unwrap();
        }
        link.write_all(&late).unwrap();
        for reply in more {
            assert!(link.read(&mut bytes).unwrap() > 0);
            link.write_all(&reply).unwrap();
        }
    });
    (address, thread)
}

/// A command that was given up, here by an interrupt: its reply comes later, and answers no other
/// command.
#[test]
fn late_replies_of_interrogators_are_left_out() {
    let text = |t: &str| format!("{:010}{t}\n", t.len() + 1).into_bytes();
    let (clock, interrupt) = (HostClock::start(1.0), Interrupt::default());
    let (address, thread) = unit(
        6,
        [text("of the first"), text("of the second")].concat(),
        Vec::new(),
    );
    let mut sm130 = Sm130::connect(&address, 1000.0, clock, &interrupt).unwrap();
    interrupt.set(Signal::CtrlC);
    assert_eq!(
        sm130.command("#A").unwrap_err().kind,
        DeviceErrorKind::Interrupted
    );
    drop(interrupt.hold());
    assert_eq!(sm130.command("#B").unwrap().trim(), "of the second");
    thread.join().unwrap();

    let response = |t: &str| [&[0, 0, t.len() as u8, 0, 0, 0, 0, 0][..], t.as_bytes()].concat();
    let late = [response("late"), response("serial")].concat();
    let (address, thread) = unit(
        2 * (8 + "#GetSerialNumber".len()),
        late,
        vec![response("N"), response("F")],
    );
    let mut hyperion = Hyperion::connect(&address, &address, 1000.0, clock, &interrupt).unwrap();
    interrupt.set(Signal::CtrlC);
    assert_eq!(
        hyperion.identity().unwrap_err().kind,
        DeviceErrorKind::Interrupted
    );
    drop(interrupt.hold());
    let identity = hyperion.identity().unwrap();
    assert_eq!(
        [&identity.serial, &identity.model, &identity.firmware],
        ["serial", "N", "F"]
    );
    thread.join().unwrap();
}
