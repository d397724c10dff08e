//! V4L2 cameras against kernel.c: the kernel's side of the interface, preloaded into this program
//! (SIMULATED pictures, no unit).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use wcal_acquisition::camera_pair::CameraPair;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind};
use wcal_drivers::cameras::{V4l2Camera, V4l2Settings};

const WAIT: Duration = Duration::from_secs(20);
const INSIDE: &str = "WCAL_V4L2_INSIDE";

/// kernel.c as a library that can be preloaded.
fn kernel() -> &'static PathBuf {
    static BUILT: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, path) = BUILT.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("kernel.so");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/v4l2/kernel.c");
        let flags = ["-O1", "-Wall", "-shared", "-fPIC", "-o"];
        let built = Command::new("cc")
            .args(flags)
            .arg(&path)
            .args([source, "-ldl", "-lpthread"])
            .status();
        assert!(built.unwrap().success());
        (dir, path)
    });
    path
}

/// Runs `body` in a program of its own in which `nodes` exist (their keys stand in kernel.c).
fn with_nodes(test: &str, nodes: &str, body: impl FnOnce()) {
    if std::env::var_os(INSIDE).is_some() {
        return body();
    }
    let again = Command::new(std::env::current_exe().unwrap())
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env("LD_PRELOAD", kernel())
        .env("WCAL_V4L2", nodes)
        .env(INSIDE, "1")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&again.stdout) + String::from_utf8_lossy(&again.stderr);
    assert!(
        again.status.success() && said.contains("1 passed"),
        "{said}"
    );
}

fn open(path: &str, wanted: &V4l2Settings) -> Result<V4l2Camera, DeviceError> {
    V4l2Camera::open(path, wanted, HostClock::start(1.0), &Interrupt::default())
}

/// Frame `k` of a node holds (x + 2 y + k) mod 256.
fn is_frame(grey: &[u8], width: usize, frame: u64) -> bool {
    grey.iter()
        .enumerate()
        .all(|(i, g)| u64::from(*g) == ((i % width + 2 * (i / width)) as u64 + frame) % 256)
}

#[test]
fn frames_come_whole_numbered_and_stamped_in_both_formats() {
    let nodes =
        "/dev/video70 rate=100;/dev/video71 fourcc=YUYV width=100 height=40 pad=24 rate=100";
    with_nodes(
        "frames_come_whole_numbered_and_stamped_in_both_formats",
        nodes,
        || {
            for (path, size) in [("/dev/video70", [64, 48]), ("/dev/video71", [100, 40])] {
                let wanted = V4l2Settings {
                    size_px: Some(size),
                    rate_hz: Some(100.0),
                    ..V4l2Settings::default()
                };
                let mut camera = open(path, &wanted).unwrap();
                assert_eq!(camera.identity().unwrap().model, "Virtual camera");
                let frames: Vec<_> = (0..60).map(|_| camera.grab(WAIT).unwrap()).collect();
                for frame in &frames {
                    assert_eq!([frame.width_px, frame.height_px], size);
                    assert!(
                        is_frame(&frame.grey, size[0] as usize, frame.trigger),
                        "{path} {}",
                        frame.trigger
                    );
                }
                // A slow machine loses frames; numbers and stamps tell which.
                let (first, last) = (&frames[0], &frames[59]);
                let s = last.clocks.device_s.unwrap() - first.clocks.device_s.unwrap();
                assert!(
                    (s - (last.trigger - first.trigger) as f64 * 0.01).abs() < 1e-5,
                    "{s} s"
                );
                assert!(frames.windows(2).all(|w| w[1].trigger > w[0].trigger));
            }
        },
    );
}

#[test]
fn exposure_and_gain_reach_the_camera_and_refusals_are_named() {
    let nodes = "/dev/video70;/dev/video71 fourcc=MJPG;/dev/video72 meta=1";
    with_nodes(
        "exposure_and_gain_reach_the_camera_and_refusals_are_named",
        nodes,
        || {
            let gain = |value| V4l2Settings {
                controls: vec![("gain".to_owned(), value)],
                ..V4l2Settings::default()
            };
            let mut camera = open("/dev/video70", &gain(12)).unwrap();
            assert_eq!(
                camera.grab(WAIT).unwrap().measured_exposure_ms,
                Some(15.7),
                "what it had"
            );
            camera.configure(Some(4.2), None).unwrap();
            let frame = camera.grab(WAIT).unwrap();
            assert_eq!(
                (frame.commanded_exposure_ms, frame.measured_exposure_ms),
                (Some(4.2), Some(4.2))
            );
            assert!(
                camera
                    .identity()
                    .unwrap()
                    .settings
                    .contains(&("gain".to_owned(), "12".to_owned()))
            );
            // 500 ms is past the camera's range of 204.7.
            let long = camera.configure(Some(500.0), None).unwrap_err();
            assert!(
                long.kind == DeviceErrorKind::Configuration && long.expected.contains("500 ms"),
                "{long}"
            );
            assert_eq!(
                camera.configure(None, Some(3.0)).unwrap_err().kind,
                DeviceErrorKind::Unsupported
            );
            drop(camera);
            let refusals = [
                ("/dev/video70", gain(31), "0 to 30"),
                (
                    "/dev/video70",
                    V4l2Settings {
                        controls: vec![("iris".to_owned(), 1)],
                        ..gain(1)
                    },
                    "Gain",
                ),
                (
                    "/dev/video70",
                    V4l2Settings {
                        size_px: Some([640, 480]),
                        ..gain(1)
                    },
                    "640x480",
                ),
                (
                    "/dev/video70",
                    V4l2Settings {
                        rate_hz: Some(60.0),
                        ..gain(1)
                    },
                    "60 Hz",
                ),
                ("/dev/video71", V4l2Settings::default(), "MJPG"),
                ("/dev/video72", V4l2Settings::default(), "gives pictures"),
            ];
            for (path, wanted, says) in refusals {
                let refused = open(path, &wanted).err().unwrap();
                assert!(refused.kind == DeviceErrorKind::Configuration, "{refused}");
                assert!(
                    refused.to_string().contains(says) && refused.to_string().contains(path),
                    "{refused}"
                );
            }
            assert_eq!(
                open("/dev/video73", &gain(1)).err().unwrap().kind,
                DeviceErrorKind::Disconnected
            );
        },
    );
}

#[test]
fn a_pause_is_a_timeout_a_damaged_frame_is_left_out_and_a_pulled_plug_is_named() {
    let nodes = "/dev/video70 rate=50 stall_at=20 stall_ms=2000;/dev/video71 rate=50 error_at=3;/dev/video72 rate=50 unplug_at=10";
    with_nodes(
        "a_pause_is_a_timeout_a_damaged_frame_is_left_out_and_a_pulled_plug_is_named",
        nodes,
        || {
            let mut camera = open("/dev/video70", &V4l2Settings::default()).unwrap();
            let (mut timeouts, mut after, start) = (0, 0, Instant::now());
            while after < 20 && start.elapsed() < WAIT {
                match camera.grab(Duration::from_millis(50)) {
                    Ok(_) => after += usize::from(timeouts > 0),
                    Err(e) if e.kind == DeviceErrorKind::Timeout => timeouts += 1,
                    Err(e) => panic!("{e}"),
                }
            }
            assert_eq!(after, 20, "pictures after {timeouts} timeouts");
            let mut camera = open("/dev/video71", &V4l2Settings::default()).unwrap();
            let numbers: Vec<u64> = (0..10)
                .map(|_| camera.grab(WAIT).unwrap().trigger)
                .collect();
            assert!(
                !numbers.contains(&3) && numbers.windows(2).all(|w| w[0] < w[1]),
                "{numbers:?}"
            );
            let mut camera = open("/dev/video72", &V4l2Settings::default()).unwrap();
            let pulled = (0..20).find_map(|_| camera.grab(WAIT).err()).unwrap();
            assert_eq!(pulled.kind, DeviceErrorKind::Disconnected, "{pulled}");
        },
    );
}

#[test]
fn pairs_are_made_by_the_kernels_stamps_and_refused_past_the_limit() {
    let nodes = "/dev/video70 rate=20;/dev/video71 rate=20 phase_us=700;/dev/video72 rate=20 phase_us=20000;\
                 /dev/video73 rate=20 stamp=0";
    with_nodes(
        "pairs_are_made_by_the_kernels_stamps_and_refused_past_the_limit",
        nodes,
        || {
            let pair = |second: &str| {
                let open = |path: &str| open(path, &V4l2Settings::default()).unwrap();
                let mut first = open("/dev/video70");
                // Streams that begin at different times number the same trigger differently.
                while first.grab(WAIT).unwrap().trigger < 4 {}
                CameraPair::by_time([Box::new(first), Box::new(open(second))], 2.0)
            };
            let mut near = pair("/dev/video71");
            let pairs: Vec<_> = (0..8).map(|_| near.grab(WAIT).unwrap()).collect();
            let offset = pairs[0].frames[0].trigger - pairs[0].frames[1].trigger;
            assert!(offset >= 4, "{offset}");
            for p in &pairs {
                assert_eq!(p.frames[0].trigger - p.frames[1].trigger, offset);
                // Stamps are whole microseconds.
                assert!((p.skew_ms - 0.7).abs() < 2e-3, "{}", p.skew_ms);
            }
            drop(near);
            let far = pair("/dev/video72").grab(WAIT).unwrap_err();
            assert_eq!(far.kind, DeviceErrorKind::DataInvalid, "20 ms apart: {far}");
            let unknown = open("/dev/video73", &V4l2Settings::default())
                .unwrap()
                .grab(WAIT)
                .unwrap();
            assert_eq!(
                unknown.clocks.device_s, None,
                "a stamp of an unknown clock is none"
            );
        },
    );
}
