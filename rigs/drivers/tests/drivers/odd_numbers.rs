//! One odd number of a device costs one message, not the session.

use crate::cantilever::Cantilever;
use crate::common::{NoMount, rows};
use crate::tapped::{order, rig};
use std::time::Duration;
use wcal_acquisition::record::{RecordResult, record};
use wcal_acquisition::sweep::Ending;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Interrupt;
use wcal_core::device::{
    Camera, DeviceError, DeviceIdentity, FbgReading, Interrogator, Mount, Stage,
};
use wcal_core::rig_devices::{CameraRig, DeviceOpener, InterrogatorRig, MountRig, StageRig};
use wcal_drivers::bench::in_process::InProcess;
use wcal_drivers::bench::scenario::Scenario;

/// The bench, with `value` in place of a peak of one scan.
struct OddBench {
    bench: InProcess,
    value: Option<f64>,
}

impl DeviceOpener for OddBench {
    fn stage(&mut self, rig: &StageRig, clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        self.bench.stage(rig, clock)
    }

    fn mount(
        &mut self,
        rig: &MountRig,
        clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        self.bench.mount(rig, clock)
    }

    fn interrogator(
        &mut self,
        rig: &InterrogatorRig,
        clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        Ok(Box::new(OddInterrogator {
            own: self.bench.interrogator(rig, clock)?,
            value: self.value,
        }))
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        self.bench.camera(rig, clock)
    }

    fn repeats(&self) -> u64 {
        0
    }
}

struct OddInterrogator {
    own: Box<dyn Interrogator + Send>,
    value: Option<f64>,
}

impl Interrogator for OddInterrogator {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        self.own.identity()
    }

    fn rate_hz(&self) -> f64 {
        self.own.rate_hz()
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        self.own.start()
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let mut readings = self.own.read(timeout)?;
        if let (Some(value), Some(odd)) =
            (self.value, readings.iter_mut().find(|r| r.serial == 1000))
        {
            odd.peaks_nm[0][0] = value;
        }
        Ok(readings)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.own.stop()
    }
}

fn sweep(value: Option<f64>) -> (RecordResult, usize) {
    let text = "format = \"wcal-scenario/1\"\nseed = 4\n[interrogator]\nrate_hz = 500\n[cameras]\ncount = 0\n";
    let scenario = Scenario::parse(text).unwrap();
    let plant = Cantilever::of(&scenario);
    let bench = InProcess::new(scenario, plant);
    let (pauses, folder) = (bench.clone(), tempfile::tempdir().unwrap());
    let order = order(&rig(), folder.path());
    let mut pause = |time: Duration| pauses.pause(time);
    let (mut devices, never) = (OddBench { bench, value }, Interrupt::default());
    let recorded = record(
        &order,
        &mut devices,
        &mut NoMount,
        &never,
        &mut pause,
        &mut |_| {},
    )
    .unwrap();
    let count = rows(&order.folder).rows.len();
    (recorded, count)
}

#[test]
fn a_sweep_with_one_impossible_peak_is_reduced() {
    for value in [f64::INFINITY, 1e30, -1e30] {
        let (recorded, rows) = sweep(Some(value));
        assert_eq!(recorded.sweep.ending, Ending::Finished);
        assert_eq!((rows, recorded.exit_code()), (6, 3), "{value}");
        let said = recorded.warnings().join("\n");
        assert!(
            said.contains("1 messages") && said.contains("/fbg/scan: peaks_nm: expected"),
            "{said}"
        );
        assert!(said.contains("1 scans lost in 1 gaps"), "{said}");
    }
    // Negative control.
    let (recorded, rows) = sweep(None);
    assert_eq!(
        (rows, recorded.exit_code()),
        (6, 0),
        "{:?}",
        recorded.warnings()
    );
}
