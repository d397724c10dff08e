//! What must hold however a sweep ends: limits, a stage that stands, each pose once, tables of what
//! was measured.

use crate::common::{Disk, NoMount, PLAN, bench, go, order, rows};
use std::collections::BTreeSet;
use std::io::Write;
use std::net::TcpStream;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::Duration;
use wcal_acquisition::record::{RecordRequest, RecordResult, record};
use wcal_acquisition::replay::{Message, read};
use wcal_acquisition::sweep::{Ending, Progress, StageEnd};
use wcal_core::clock::HostClock;
use wcal_core::deadline::{Interrupt, Signal};
use wcal_core::device::{Camera, DeviceError, DeviceErrorKind as Kind, Interrogator, Mount, Stage};
use wcal_core::rig_devices::{CameraRig, DeviceOpener, InterrogatorRig, MountRig, StageRig};
use wcal_drivers::Drivers;
use wcal_drivers::bench::VirtualBench;
use wcal_drivers::bench::faults::Fault;

fn with_progress(order: &RecordRequest, progress: &mut dyn FnMut(&Progress)) -> RecordResult {
    let mut devices = Drivers::default();
    record(
        order,
        &mut devices,
        &mut NoMount,
        &Interrupt::default(),
        &mut std::thread::sleep,
        progress,
    )
    .unwrap()
}

/// Trajectory and depth of every row, tenths of a millimetre.
fn poses(folder: &Path) -> Vec<(Option<u32>, i64)> {
    let rows = rows(folder).rows;
    rows.iter()
        .map(|r| (r.trajectory, (r.stage_mm.unwrap() * 10.0).round() as i64))
        .collect()
}

/// The short plan: two trajectories of a rest and two depths.
fn each_pose_once(folder: &Path) {
    let all = poses(folder);
    let different: BTreeSet<_> = all.iter().copied().collect();
    assert_eq!((all.len(), different.len()), (6, 6), "{all:?}");
}

#[test]
fn a_panic_of_the_view_stops_the_stage_and_ends_the_recording() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let request = order(&bench, PLAN, dir.path());
    let died = catch_unwind(AssertUnwindSafe(|| {
        with_progress(&request, &mut |p| {
            assert!(
                !(p.step >= 4 && bench.true_stage().1 != 0.0),
                "on purpose: a view that fails while the stage moves"
            );
        })
    }));
    assert!(died.is_err(), "the panic is nobody's to hide");
    assert_eq!(bench.true_stage().1, 0.0);
    // Its lock is free, its rows are there, and the rest is measured.
    let again = go(&RecordRequest {
        resume: true,
        ..request.clone()
    })
    .unwrap();
    assert_eq!(again.sweep.ending, Ending::Finished);
    each_pose_once(&request.folder);
}

/// Opens devices, and hears Ctrl-C each time the stage is opened again.
struct Impatient {
    drivers: Drivers,
    interrupt: Interrupt,
    opened: usize,
}

impl DeviceOpener for Impatient {
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        self.opened += 1;
        if self.opened > 1 {
            self.interrupt.set(Signal::CtrlC);
        }
        self.drivers.stage(rig, clock)
    }

    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        self.drivers.mount(rig, clock)
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        self.drivers.interrogator(rig, clock)
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        self.drivers.camera(rig, clock)
    }

    fn repeats(&self) -> u64 {
        self.drivers.repeats()
    }
}

#[test]
fn a_second_ctrl_c_does_not_keep_a_lost_stage_from_being_reached_again() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let request = order(&bench, PLAN, dir.path());
    let interrupt = Interrupt::default();
    let mut devices = Impatient {
        drivers: Drivers::new(&interrupt),
        interrupt: interrupt.clone(),
        opened: 0,
    };
    let mut unplugged = false;
    let recorded = std::thread::scope(|scope| {
        let mut view = |p: &Progress| {
            if p.step >= 4
                && bench.true_stage().1 != 0.0
                && !std::mem::replace(&mut unplugged, true)
            {
                bench.inject(Fault::UnplugStage);
                scope.spawn(|| {
                    std::thread::sleep(Duration::from_millis(120));
                    bench.inject(Fault::PlugStage);
                });
            }
        };
        record(
            &request,
            &mut devices,
            &mut NoMount,
            &interrupt,
            &mut std::thread::sleep,
            &mut view,
        )
        .unwrap()
    });
    assert!(
        devices.opened > 1,
        "the stage was opened again: {recorded:?}"
    );
    let Ending::Stopped { stage, .. } = recorded.sweep.ending else {
        panic!("{recorded:?}")
    };
    assert!(stage.stands());
    assert_eq!(bench.true_stage().1, 0.0);
}

/// Bytes of a recording up to which its last event is the window of a step whose `done` is lost.
fn cut_after_a_window(recording: &Path) -> Vec<u8> {
    let whole = std::fs::read(recording).unwrap();
    let cut = tempfile::NamedTempFile::new().unwrap();
    for length in (0..whole.len()).rev().step_by(512) {
        std::fs::write(cut.path(), &whole[..length]).unwrap();
        let mut last = String::new();
        read(cut.path(), |message| {
            if let Message::Event(event) = message {
                last = event.kind;
            }
        })
        .unwrap();
        if last == "window" {
            return whole[..length].to_vec();
        }
    }
    panic!("no such moment");
}

#[test]
fn a_pose_whose_done_was_lost_with_the_power_is_there_once() {
    let (first, dir) = (bench(""), tempfile::tempdir().unwrap());
    let request = order(&first, PLAN, dir.path());
    assert_eq!(go(&request).unwrap().sweep.ending, Ending::Finished);
    let recording = request.folder.join("recording.mcap");
    let cut = cut_after_a_window(&recording);
    std::fs::write(&recording, cut).unwrap();
    let cut_off = wcal_acquisition::reduce::reduce(&request.folder).unwrap();
    assert!(
        cut_off.cut_off == 1 && cut_off.rows < 7,
        "control: it is cut off: {cut_off:?}"
    );
    let second = bench("");
    let again = go(&RecordRequest {
        resume: true,
        ..order(&second, PLAN, dir.path())
    })
    .unwrap();
    assert_eq!(again.sweep.ending, Ending::Finished);
    each_pose_once(&request.folder);
}

/// Another program on the stage's line, while a reading is averaged.
fn foreign_move(bench: &VirtualBench) {
    let mut line = TcpStream::connect(bench.addresses().stage_tcp).unwrap();
    line.write_all(b"/1 1 move rel 4000\n").unwrap();
}

#[test]
fn a_stage_that_another_program_moves_stops_the_sweep_by_name() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let request = order(&bench, PLAN, dir.path());
    let mut moved = false;
    // Rest and first depth of the first trajectory are done; the stage stands at the next depth.
    let recorded = with_progress(&request, &mut |p| {
        let stands = bench.true_stage().1 == 0.0 && (p.stage_mm - 3.0).abs() < 1e-3;
        if stands && !std::mem::replace(&mut moved, true) {
            foreign_move(&bench);
        }
    });
    let Ending::Stopped { cause, stage } = &recorded.sweep.ending else {
        panic!("{recorded:?}")
    };
    assert_eq!(
        (cause.kind, *stage),
        (Kind::Displaced, StageEnd::Stands),
        "{cause}"
    );
    assert!(cause.to_string().contains("another program"), "{cause}");
    assert!(
        !poses(&request.folder).iter().any(|(_, mm)| *mm == 30),
        "no row of the place that it left"
    );
    let again = go(&RecordRequest {
        resume: true,
        ..request.clone()
    })
    .unwrap();
    assert_eq!(again.sweep.ending, Ending::Finished);
    each_pose_once(&request.folder);
}

/// What `reduce` marks, the reader of the session leaves out and counts.
#[test]
fn a_row_during_which_the_stage_moved_is_left_out_and_said() {
    let (bench, dir) = (bench(""), tempfile::tempdir().unwrap());
    let request = order(&bench, PLAN, dir.path());
    go(&request).unwrap();
    let left_out = || {
        let loaded = wcal_session::load(&request.folder).unwrap();
        let moved = |w: &wcal_session::SessionWarning| {
            matches!(&w.kind, wcal_session::WarningKind::StageMoved)
        };
        (
            rows(&request.folder).rows.len(),
            loaded.warnings.iter().any(moved),
        )
    };
    assert_eq!(left_out(), (6, false), "control");
    let table = request.folder.join("points.csv");
    let text = std::fs::read_to_string(&table).unwrap();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let changed = ["ok", "late"].iter().fold(lines[2].clone(), |l, word| {
        l.replace(&format!(",{word}"), ",moved")
    });
    assert_ne!(std::mem::replace(&mut lines[2], changed.clone()), changed);
    std::fs::write(&table, lines.join("\n") + "\n").unwrap();
    assert_eq!(left_out(), (5, true));
}

#[test]
fn a_full_disk_is_named_the_wire_is_free_and_what_was_measured_is_in_the_tables() {
    let (bench, disk) = (bench(""), Disk::of("20m"));
    let request = order(&bench, PLAN, disk.path());
    let rest = disk.path().join("rest");
    // Full from the first reading on, whatever time that took.
    let recorded = with_progress(&request, &mut |p| {
        if p.step >= 4 && !rest.exists() {
            assert!(std::fs::write(&rest, vec![0; 32 << 20]).is_err());
        }
    });
    let Ending::Stopped { cause, stage } = &recorded.sweep.ending else {
        panic!("{recorded:?}")
    };
    let said = cause.to_string();
    assert!(
        said.contains("recording.mcap") && said.to_lowercase().contains("no space left"),
        "{said}"
    );
    assert_eq!(*stage, StageEnd::Retracted);
    assert!(
        (bench.true_stage().0 - 18.0).abs() < 0.01,
        "{:?}",
        bench.true_stage()
    );
    let tables = recorded.reduction.unwrap();
    assert!(
        tables.rows > 0 && rows(&request.folder).rows.len() == tables.rows,
        "{tables:?}"
    );
    // With room on the disk it goes on.
    std::fs::remove_file(&rest).unwrap();
    let again = go(&RecordRequest {
        resume: true,
        ..request.clone()
    })
    .unwrap();
    assert_eq!(again.sweep.ending, Ending::Finished);
    each_pose_once(&request.folder);
}
