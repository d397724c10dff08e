//! Numbers in a recording that no bench sends: `reduce` takes them or names topic and field, and
//! one message more costs no memory.

use super::limits::{in_parallel, limited, sound};
use super::*;
use crate::support::fixture;
use crate::support::recordings::with_number;
use wcal_acquisition::message::SweepEvent;
use wcal_acquisition::recorder::Recorder;
use wcal_core::device::{Clocks, FbgReading, StageReading};

const RATE_HZ: f64 = 500.0;
/// Host time of the first scan, s.
const START_S: f64 = 1.7e9;

/// A session folder of four seconds: one settled reading, one move with ten rows a second, and
/// `more`.
fn record(folder: &Path, more: &[SweepEvent]) {
    for name in ["rig.toml", "run.json"] {
        fs::copy(fixture("pictured").join(name), folder.join(name)).unwrap();
    }
    let recorder = Recorder::create(&folder.join("recording.mcap"), Default::default()).unwrap();
    let rig: toml::Table = fs::read_to_string(folder.join("rig.toml"))
        .unwrap()
        .parse()
        .unwrap();
    let gratings = rig["interrogator"]["grating"].as_array().unwrap();
    let mut peaks: Vec<f64> = gratings
        .iter()
        .map(|g| g["nominal_nm"].as_float().unwrap())
        .collect();
    peaks.sort_by(f64::total_cmp);
    let zero_mm = rig["stage"]["zero_mm"].as_float().unwrap();
    for serial in 0..2000_u64 {
        let t_s = serial as f64 / RATE_HZ;
        let clocks = Clocks {
            host_s: START_S + t_s,
            device_s: Some(t_s),
        };
        let wave = 1e-4 * (serial * 37 % 101) as f64 / 101.0;
        let peaks_nm = vec![peaks.iter().map(|nm| nm + wave).collect()];
        recorder
            .scan(&FbgReading {
                serial,
                peaks_nm,
                clocks,
                ..FbgReading::default()
            })
            .unwrap();
        if serial % 10 == 0 {
            let measured_mm = zero_mm + if t_s < 2.0 { 1.0 } else { t_s - 1.0 };
            let reading = StageReading {
                measured_mm,
                commanded_mm: Some(measured_mm),
                clocks,
                ..StageReading::default()
            };
            recorder.stage(&reading).unwrap();
        }
    }
    for event in own().iter().chain(more) {
        recorder.event(START_S, event).unwrap();
    }
    recorder.finish().unwrap();
}

fn own() -> [SweepEvent; 2] {
    let event = |kind: &str, begin_s: f64, end_s: f64| SweepEvent {
        kind: kind.to_owned(),
        role: "calibration".to_owned(),
        trajectory: 1,
        replicate: 1,
        direction: 1,
        begin_s,
        end_s,
        ..SweepEvent::default()
    };
    [
        event("window", 0.5, 1.5),
        SweepEvent {
            rows_hz: 10.0,
            ..event("moving", 2.0, 3.5)
        },
    ]
}

/// A field by name, with a value in place of its own.
fn changed(event: &SweepEvent, field: &str, value: f64) -> SweepEvent {
    let mut event = event.clone();
    let slot = match field {
        "target_mm" => &mut event.target_mm,
        "speed_mm_s" => &mut event.speed_mm_s,
        "begin_s" => &mut event.begin_s,
        "end_s" => &mut event.end_s,
        "arrived_s" => &mut event.arrived_s,
        "rows_hz" => &mut event.rows_hz,
        other => panic!("{other}"),
    };
    *slot = value;
    event
}

#[test]
fn one_message_more_does_not_fill_the_memory() {
    let [window, moving] = own();
    let long = |step: u32| SweepEvent {
        step,
        begin_s: -1e9,
        end_s: 1e9,
        ..window.clone()
    };
    // Name, events, exit code, what is said.
    let cases: [(&str, Vec<SweepEvent>, i32, &[&str]); 5] = [
        ("negative control: as it is", vec![], 0, &["rows"]),
        (
            "negative control: another reading",
            vec![SweepEvent {
                begin_s: 1.5,
                end_s: 1.9,
                ..window.clone()
            }],
            0,
            &["rows"],
        ),
        (
            "rows a second that the scans cannot give",
            vec![SweepEvent {
                rows_hz: 9e4,
                ..moving.clone()
            }],
            1,
            &["/sweep/event", "rows on the fly"],
        ),
        (
            "a move of sixty years",
            vec![SweepEvent {
                begin_s: -1e9,
                end_s: 1e9,
                ..moving.clone()
            }],
            1,
            &["/sweep/event", "rows on the fly"],
        ),
        (
            "readings that hold every scan",
            (0..3000).map(long).collect(),
            1,
            &["/sweep/event", "for a scan"],
        ),
    ];
    for (name, more, code, says) in cases {
        let place = tempfile::tempdir().unwrap();
        record(place.path(), &more);
        let output = limited(place.path(), &["reduce", "."]);
        let text = sound(&output).unwrap_or_else(|why| panic!("{name}: {why}"));
        // Without noise of the instrument and with a stage of our own a warning may come with the
        // rows.
        let good = if code == 0 {
            output.status.code() != Some(1)
        } else {
            output.status.code() == Some(1)
        };
        assert!(
            good && says.iter().all(|word| text.contains(word)),
            "{name}: {text}"
        );
    }
}

/// A number that stands nowhere else.
const MARK: f64 = 0.123_456_789;

#[test]
fn every_number_of_an_event_is_taken_or_named() {
    let fields = [
        "target_mm",
        "speed_mm_s",
        "begin_s",
        "end_s",
        "arrived_s",
        "rows_hz",
    ];
    let values = [
        f64::NAN,
        f64::INFINITY,
        -1e308,
        1e308,
        1e18,
        1e9,
        -1e9,
        4294967296.0,
        0.0,
        -1.0,
    ];
    let events = own();
    let cases: Vec<(usize, &str, f64)> = (0..2)
        .flat_map(|k| {
            fields
                .iter()
                .flat_map(move |field| values.map(|value| (k, *field, value)))
        })
        .collect();
    let wrong = in_parallel(&cases, |(k, field, value)| {
        let place = tempfile::tempdir().unwrap();
        record(place.path(), &[changed(&events[*k], field, MARK)]);
        with_number(&place.path().join("recording.mcap"), MARK, *value);
        let output = limited(place.path(), &["reduce", "."]);
        let shown = format!("{} {field} = {value}", events[*k].kind);
        let text = sound(&output).map_err(|why| format!("{shown}: {why}"))?;
        let code = output.status.code();
        // The message alone is left out, and named.
        if value.abs() > 1e10 || value.is_nan() {
            let named = text.contains(&format!(
                "1 messages that make no sense left out; the first: /sweep/event: {field}"
            ));
            let all = fs::read_to_string(place.path().join("points.csv"))
                .is_ok_and(|t| t.lines().count() > 10);
            return if code == Some(3) && named && all {
                Ok(())
            } else {
                Err(format!("{shown}: {text}"))
            };
        }
        match code != Some(1) || text.contains("recording.mcap: /sweep/event") {
            true => Ok(()),
            false => Err(format!("{shown}: not named: {text}")),
        }
    });
    assert!(
        wrong.is_empty(),
        "{} faults\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}
