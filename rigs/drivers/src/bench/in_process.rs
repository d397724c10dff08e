//! The virtual bench in the caller's own process: no sockets, and no waiting. Its time passes only
//! while the sweep pauses or a device answers, so a recording depends on scenario and seed alone,
//! however busy the computer is.
//!
//! ```text
//! answer of the stage   asked at t, position of t + 1.0..1.5 ms, stamped 1.5..3.0 ms later      some 13 and 25 characters at 115,200 baud
//! stream                handed over in blocks of 50 ms; time goes on when the reader has taken a block in
//! ```

use super::axis::Axis;
use super::clock::BenchClock;
use super::lock::guard;
use super::plant::Plant;
use super::scenario::Scenario;
use super::world::{BenchState, Scan};
use crate::zaber::flags::{is_latched, remedy};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::device::{
    Camera, Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, FbgReading, Interrogator, Mount,
    Permission, Stage, StageReading,
};
use wcal_core::rig_devices::{CameraRig, DeviceOpener, InterrogatorRig, MountRig, StageRig};

/// Time until the stage has heard a question, and until its answer is there, s.
const HEARD_S: [f64; 2] = [1.0e-3, 1.5e-3];
const ANSWERED_S: [f64; 2] = [1.5e-3, 3.0e-3];
/// Time between two blocks of the stream, s.
const BLOCK_S: f64 = 0.05;
/// From a scan to its arrival, s.
const ARRIVAL_S: f64 = 1e-3;
/// A reader that takes nothing for this long has gone (wall time).
const GONE: Duration = Duration::from_secs(20);

/// How far the stream was handed over, in numbers of scans.
#[derive(Debug, Default)]
struct Stream {
    /// It has been read, perhaps by a reader that has ended since.
    begun: bool,
    reading: bool,
    made: u64,
    taken: u64,
    handed_s: f64,
}

/// The bench; clones are the same bench.
#[derive(Clone)]
pub struct InProcess {
    shared: Arc<BenchState>,
    stream: Arc<(Mutex<Stream>, Condvar)>,
    answers: Arc<Mutex<ChaCha8Rng>>,
}

impl InProcess {
    /// A bench whose time stands.
    pub fn new(scenario: Scenario, plant: Box<dyn Plant>) -> Self {
        // Dice of their own: the plant's noise does not depend on how often the stage is asked.
        let answers = ChaCha8Rng::seed_from_u64(scenario.seed ^ 0xa5);
        let shared = BenchState::new(scenario, plant, BenchClock::standing());
        shared.scan();
        Self {
            shared: Arc::new(shared),
            stream: Arc::default(),
            answers: Arc::new(Mutex::new(answers)),
        }
    }

    /// A pause of the sweep: its time passes. The first one waits for the thread that reads the
    /// stream, or chance would say how many there are.
    pub fn pause(&self, time: Duration) {
        let (stream, changed) = &*self.stream;
        drop(changed.wait_timeout_while(guard(stream), GONE, |s| !s.begun));
        self.pass(time.as_secs_f64());
    }

    /// What moves and what time it is; for links that carry the units' own bytes.
    pub fn state(&self) -> &BenchState {
        &self.shared
    }

    /// Lets time pass, s, and hands the stream over.
    pub fn pass(&self, seconds: f64) {
        self.shared.clock.pass(seconds);
        let now_s = self.shared.clock.now_s();
        let (stream, changed) = &*self.stream;
        let mut s = guard(stream);
        if now_s - s.handed_s < BLOCK_S {
            return;
        }
        self.shared.scan();
        s.handed_s = now_s;
        s.made = self.shared.next_serial();
        changed.notify_all();
        let open = |s: &mut Stream| s.reading && s.taken < s.made;
        let waited = changed.wait_timeout_while(s, GONE, open);
        // A reader that has gone is no reason to stand still, and is not waited for again.
        if let Ok((mut s, over)) = waited {
            s.reading &= !over.timed_out();
        }
    }

    /// Lets a time of a range pass, s, by the dice.
    fn pass_some(&self, [low, high]: [f64; 2]) {
        let seconds = guard(&self.answers).random_range(low..high);
        self.pass(seconds);
    }

    fn unit(&self, index: usize) -> Unit {
        Unit {
            bench: self.clone(),
            index,
            commanded_mm: None,
        }
    }
}

/// A unit of the stage's chain.
struct Unit {
    bench: InProcess,
    index: usize,
    commanded_mm: Option<f64>,
}

impl Unit {
    fn refused(&self, action: &str, found: &str) -> DeviceError {
        DeviceError::new(
            DeviceErrorKind::Rejected,
            format!("virtual unit {}", self.index + 1),
            action,
            "a command that the unit takes",
            found,
        )
    }

    /// Does something with the axis at the present time.
    fn axis<T>(&self, f: impl FnOnce(&mut Axis, f64) -> T) -> Result<T, DeviceError> {
        let t_s = self.bench.shared.clock.now_s();
        let mut world = self.bench.shared.world();
        let unit = world.units.get_mut(self.index);
        let unit = unit.ok_or_else(|| self.refused("answer", "no such unit"))?;
        unit.axis.update(t_s);
        Ok(f(&mut unit.axis, t_s))
    }
}

impl Stage for Unit {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let spec = &self.bench.shared.scenario.stage.unit;
        Ok(DeviceIdentity {
            driver: "in-process".to_owned(),
            model: format!("virtual {}", spec.device_id),
            serial: spec.serial.to_string(),
            firmware: spec.firmware.clone(),
            ..DeviceIdentity::default()
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        self.axis(|axis, _| [0.0, axis.spec.unit.to_mm(axis.spec.limit_steps as f64)])
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        self.commanded_mm = Some(0.0);
        self.axis(Axis::home)?
            .map_err(|e| self.refused("search the reference", e))
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let (commanded_mm, moved) = self.axis(|axis, t_s| {
            let unit = axis.spec.unit;
            let steps = unit.from_mm(target_mm);
            let moved = axis.move_to(t_s, steps, Some(speed_mm_s));
            (unit.to_mm(steps as f64), moved)
        })?;
        self.commanded_mm = Some(commanded_mm);
        moved.map_err(|e| self.refused("move", e))
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        self.bench.pass_some(HEARD_S);
        let (homed, measured_mm, moving, flags) = self.axis(|axis, t_s| {
            let mm = axis.spec.unit.to_mm(axis.steps(t_s) as f64);
            (axis.homed(), mm, axis.busy(t_s), axis.flags())
        })?;
        self.bench.pass_some(ANSWERED_S);
        if !homed && !moving {
            let found = flags.join(" ") + flags.first().map_or("", |f| remedy(f));
            return Err(DeviceError {
                kind: DeviceErrorKind::NotHomed,
                expected: "a homed axis".to_owned(),
                ..self.refused("read position", &found)
            });
        }
        let clock = &self.bench.shared.clock;
        Ok(StageReading {
            commanded_mm: self.commanded_mm,
            measured_mm,
            moving,
            flags: flags.into_iter().map(str::to_owned).collect(),
            clocks: Clocks {
                host_s: clock.epoch_s(clock.now_s()),
                device_s: None,
            },
        })
    }

    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        let shown = self.axis(|axis, _| {
            let shown = axis.flags();
            axis.clear_flags();
            shown
        })?;
        let latched = shown.into_iter().filter(|flag| is_latched(flag));
        Ok(latched.map(str::to_owned).collect())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.axis(Axis::stop)?;
        // Time passes by this wait alone: the stage brakes in it.
        while self.axis(|axis, t_s| axis.busy(t_s))? {
            self.bench.pass(BLOCK_S);
        }
        Ok(())
    }
}

/// The motorised mount.
struct OwnMount {
    unit: Unit,
    steps_per_trajectory: i64,
    speed_mm_s: f64,
}

impl Mount for OwnMount {
    fn check(&mut self, _trajectories: &[u32], allowed: Permission) -> Result<(), DeviceError> {
        match self.unit.read() {
            Err(e) if !allowed.covers(&e) => Err(e),
            _ => Ok(()),
        }
    }

    fn prepare(&mut self, allowed: Permission) -> Result<(), DeviceError> {
        match self.unit.read() {
            Err(e) if e.kind == DeviceErrorKind::NotHomed && allowed.home => {
                self.unit.start_home()?
            }
            reading => drop(reading?),
        }
        // Each reading lets time pass, in which the mount turns.
        while self.unit.read()?.moving {}
        Ok(())
    }

    fn select(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        let steps = i64::from(trajectory) * self.steps_per_trajectory;
        let turn = |axis: &mut Axis, t_s| axis.move_to(t_s, steps, Some(self.speed_mm_s));
        let moved = self.unit.axis(turn)?;
        moved.map_err(|e| self.unit.refused("turn", e))?;
        while self.unit.read()?.moving {}
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.unit.stop()
    }
}

/// The interrogator, read by its own thread.
struct OwnInterrogator {
    bench: InProcess,
    next: u64,
}

impl Interrogator for OwnInterrogator {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        Ok(DeviceIdentity {
            driver: "in-process".to_owned(),
            model: "virtual interrogator".to_owned(),
            ..DeviceIdentity::default()
        })
    }

    fn rate_hz(&self) -> f64 {
        self.bench.shared.scenario.interrogator.rate_hz
    }

    fn start(&mut self) -> Result<(), DeviceError> {
        let mut s = guard(&self.bench.stream.0);
        self.next = s.made;
        (s.begun, s.reading, s.taken) = (true, true, self.next);
        self.bench.stream.1.notify_all();
        Ok(())
    }

    fn read(&mut self, timeout: Duration) -> Result<Vec<FbgReading>, DeviceError> {
        let (stream, changed) = &*self.bench.stream;
        let mut s = guard(stream);
        // Who asks again has taken in what there was.
        s.taken = self.next;
        changed.notify_all();
        let next = self.next;
        drop(changed.wait_timeout_while(s, timeout, |s| s.made <= next));
        if guard(stream).made <= next {
            return Ok(Vec::new());
        }
        let shared = &self.bench.shared;
        let scans = shared.scans_from(next);
        self.next = scans.last().map_or(next, |s| s.serial + 1);
        let reading = |scan: &Scan| FbgReading {
            serial: scan.serial,
            // All gratings on the first optical channel.
            peaks_nm: vec![scan.ascending_nm()],
            health: scan.health,
            // Arrival is computed: delays of a busy computer are not in the recording.
            clocks: Clocks {
                host_s: shared.clock.epoch_s(scan.t_s + ARRIVAL_S),
                device_s: Some(shared.device_s(scan.t_s)),
            },
        };
        Ok(scans.iter().map(reading).collect())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        guard(&self.bench.stream.0).reading = false;
        self.bench.stream.1.notify_all();
        Ok(())
    }
}

impl DeviceOpener for InProcess {
    fn stage(&mut self, _rig: &StageRig, _clock: HostClock) -> Result<Box<dyn Stage>, DeviceError> {
        Ok(Box::new(self.unit(0)))
    }

    fn mount(
        &mut self,
        rig: &MountRig,
        _clock: HostClock,
    ) -> Result<Option<Box<dyn Mount>>, DeviceError> {
        let MountRig::Zaber {
            steps_per_trajectory,
            speed_mm_s,
            ..
        } = rig
        else {
            return Ok(None);
        };
        Ok(Some(Box::new(OwnMount {
            unit: self.unit(1),
            steps_per_trajectory: *steps_per_trajectory,
            speed_mm_s: *speed_mm_s,
        })))
    }

    fn interrogator(
        &mut self,
        _rig: &InterrogatorRig,
        _clock: HostClock,
    ) -> Result<Box<dyn Interrogator + Send>, DeviceError> {
        Ok(Box::new(OwnInterrogator {
            bench: self.clone(),
            next: 0,
        }))
    }

    fn camera(
        &mut self,
        rig: &CameraRig,
        _clock: HostClock,
    ) -> Result<Box<dyn Camera + Send>, DeviceError> {
        Err(DeviceError::new(
            DeviceErrorKind::Configuration,
            "camera",
            "open",
            "a rig without cameras, or `wcal virtual-bench`",
            format!("camera {}", rig.name),
        ))
    }

    fn repeats(&self) -> u64 {
        0
    }
}
