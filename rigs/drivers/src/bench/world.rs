//! State shared by all servers of the virtual bench, and the scanner that makes the scans.

use super::clock::BenchClock;
use super::faults::{Fault, ScheduledFault};
use super::link::{Cable, ReplyFault, UnsolicitedTraffic};
use super::lock::guard;
use super::plant::{Physics, Plant};
use super::scenario::{CameraScenario, Scenario};
use super::scene::Scene;
use super::unit::{Unit, UnitSpec};
use super::unit_clock::UnitClock;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use wcal_core::device::InterrogatorHealth;
use wcal_core::shared_time::lives;

/// One scan as the optics saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scan {
    /// Running number.
    pub serial: u64,
    /// Bench time, s.
    pub t_s: f64,
    /// Reference, first and second sensing grating, nm; `None` where a peak is lost.
    pub peaks_nm: [Option<f64>; 3],
    /// Health of the unit.
    pub health: InterrogatorHealth,
}

/// Everything that moves.
pub struct World {
    /// Units on the chain: stage, then mount.
    pub units: Vec<Unit>,
    physics: Physics,
    health: InterrogatorHealth,
    lost: [bool; 3],
    crossing: bool,
    /// A grating whose peak has no value, and in how many scans.
    valueless: (usize, u64),
    skip: u64,
    schedule: VecDeque<ScheduledFault>,
    scanned: u64,
}

/// Scans kept for clients that are behind.
#[derive(Debug, Default)]
pub struct Ring {
    scans: VecDeque<Scan>,
}

/// State of the picture stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraState {
    /// The second camera repeats its last picture.
    pub frozen: bool,
    /// Extra delay of the second camera, ms.
    pub skew_ms: f64,
    /// Attitude of the chessboard that is held up.
    pub board: Option<usize>,
    /// Exposure relative to the right one.
    pub exposure: f64,
    /// Shift (mm) and rotation vector (degrees) of the second camera since the board was shown.
    pub moved: ([f64; 3], [f64; 3]),
    /// Frames of the second camera still to be lost.
    pub lose: u64,
}

impl CameraState {
    fn new(cameras: &CameraScenario) -> Self {
        Self {
            frozen: false,
            skew_ms: cameras.skew_ms,
            board: None,
            exposure: cameras.exposure,
            moved: (cameras.errors.moved_mm, cameras.errors.moved_deg),
            lose: 0,
        }
    }
}

/// Shared by all threads of one bench.
pub struct BenchState {
    /// The truth.
    pub scenario: Scenario,
    /// Bench time.
    pub clock: BenchClock,
    /// Stage cable.
    pub stage_cable: Cable,
    /// Interrogator cable.
    pub interrogator_cable: Cable,
    /// Picture stream.
    pub cameras: Mutex<CameraState>,
    /// What the cameras see.
    pub scene: Option<Arc<dyn Scene>>,
    world: Mutex<World>,
    ring: Mutex<Ring>,
    fresh: Condvar,
    pause_until_s: Mutex<f64>,
    /// What is wrong with the interrogator's clock.
    unit_clock: Mutex<UnitClock>,
    never_accepts: AtomicBool,
    garbage: AtomicBool,
    stop: AtomicBool,
}

impl BenchState {
    /// A bench that starts now.
    pub fn new(scenario: Scenario, plant: Box<dyn Plant>) -> Arc<Self> {
        let clock = BenchClock::start(scenario.speed);
        Self::by_clock(scenario, plant, clock)
    }

    /// A bench by its own clock.
    pub fn by_clock(scenario: Scenario, plant: Box<dyn Plant>, clock: BenchClock) -> Arc<Self> {
        let mut units = vec![Unit::new(1, scenario.stage.unit.clone())];
        if scenario.mount.present {
            let mount = UnitSpec {
                device_id: 50_081,
                serial: scenario.stage.unit.serial + 1,
                limit_steps: scenario.mount.steps_per_trajectory * 1000,
                start_mm: 0.0,
                microstep_um: 0.1,
                ..UnitSpec::default()
            };
            units.push(Unit::new(2, mount));
        }
        let mut schedule = scenario.fault.clone();
        schedule.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
        let physics = Physics::new(&scenario, plant);
        let scene = physics.scene();
        let world = World {
            units,
            physics,
            health: InterrogatorHealth::default(),
            lost: [false; 3],
            crossing: false,
            valueless: (0, 0),
            skip: 0,
            schedule: schedule.into(),
            scanned: 0,
        };
        Arc::new(Self {
            clock,
            stage_cable: Cable::default(),
            interrogator_cable: Cable::default(),
            cameras: Mutex::new(CameraState::new(&scenario.cameras)),
            scene,
            scenario,
            world: Mutex::new(world),
            ring: Mutex::new(Ring::default()),
            fresh: Condvar::new(),
            pause_until_s: Mutex::new(0.0),
            unit_clock: Mutex::new(UnitClock::default()),
            never_accepts: AtomicBool::new(false),
            garbage: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        })
    }

    /// The moving parts.
    pub fn world(&self) -> MutexGuard<'_, World> {
        guard(&self.world)
    }

    /// Picture stream state.
    pub(crate) fn camera_state(&self) -> CameraState {
        *guard(&self.cameras)
    }

    /// Shows the board in attitude `view`, or takes it away; an attitude that there is not is
    /// refused.
    pub(crate) fn show_board(&self, view: Option<usize>) -> bool {
        let known = view.is_none_or(|k| k < self.scenario.cameras.board_views);
        if known {
            guard(&self.cameras).board = view;
        }
        known
    }

    /// True for each frame of the second camera that is to be lost.
    pub(crate) fn loses_frame(&self) -> bool {
        let mut state = guard(&self.cameras);
        let lost = state.lose > 0;
        state.lose = state.lose.saturating_sub(1);
        lost
    }

    /// Whether the bench is shutting down.
    pub fn stopping(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// Signals every thread to end.
    pub(crate) fn shut_down(&self) {
        self.stop.store(true, Ordering::SeqCst);
        self.fresh.notify_all();
    }

    /// True once after each request for garbage bytes.
    pub(crate) fn take_garbage(&self) -> bool {
        self.garbage.swap(false, Ordering::SeqCst)
    }

    /// Bench time until which the stream is held back.
    pub(crate) fn paused_until_s(&self) -> f64 {
        *guard(&self.pause_until_s)
    }

    /// Whether the bench goes on; asked in every round of a thread that its time waits for.
    pub fn goes_on(&self) -> bool {
        lives(Duration::ZERO);
        !self.stopping()
    }

    /// Wall time by which the scans that are made are behind.
    pub fn behind(&self) -> Duration {
        let made_s = self.world().scanned as f64 / self.scenario.interrogator.rate_hz;
        self.clock.wall(self.clock.now_s() - made_s)
    }

    /// Whether no new connection is answered.
    pub(crate) fn never_accepts(&self) -> bool {
        self.never_accepts.load(Ordering::SeqCst)
    }

    /// Time of the interrogator's clock at bench time `t_s`, s since 1970.
    pub fn device_s(&self, t_s: f64) -> f64 {
        let spec = &self.scenario.interrogator;
        let own_s = guard(&self.unit_clock).at(t_s) + t_s * spec.clock_drift_ppm * 1e-6;
        self.clock.epoch_s(own_s) + spec.clock_offset_s
    }

    /// The newest scan.
    pub fn newest(&self) -> Option<Scan> {
        guard(&self.ring).scans.back().copied()
    }

    /// Scans from number `from` on, waiting a moment for the first; scans that were dropped are
    /// missing.
    pub(crate) fn scans_from(&self, from: u64) -> Vec<Scan> {
        let ring = guard(&self.ring);
        let waiting =
            |r: &mut Ring| !self.stopping() && r.scans.back().is_none_or(|s| s.serial < from);
        let waited = self
            .fresh
            .wait_timeout_while(ring, Duration::from_millis(20), waiting);
        let (ring, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let start = ring.scans.partition_point(|s| s.serial < from);
        ring.scans.range(start..).take(4096).copied().collect()
    }

    /// Makes all scans that are due, and carries out scheduled faults. Called by one thread only.
    pub fn scan(&self) {
        let now_s = self.clock.now_s();
        let due: Vec<Fault> = {
            let mut world = self.world();
            let mut due = Vec::new();
            while world.schedule.front().is_some_and(|f| f.at_s <= now_s) {
                due.extend(world.schedule.pop_front().map(|f| f.fault));
            }
            due
        };
        for fault in due {
            self.inject(fault);
        }
        let period_s = 1.0 / self.scenario.interrogator.rate_hz;
        let mut fresh = Vec::new();
        {
            let mut world = self.world();
            while world.scanned as f64 * period_s <= now_s && fresh.len() < 20_000 {
                let serial = world.scanned;
                let scan = world.scan(serial, serial as f64 * period_s, &self.scenario);
                world.scanned += 1;
                if world.skip > 0 {
                    world.skip -= 1;
                } else {
                    fresh.push(scan);
                }
            }
        }
        let mut ring = guard(&self.ring);
        ring.scans.extend(fresh);
        let excess = ring
            .scans
            .len()
            .saturating_sub(self.scenario.interrogator.buffer);
        ring.scans.drain(..excess);
        drop(ring);
        self.fresh.notify_all();
    }

    /// Carries out a fault now.
    pub fn inject(&self, fault: Fault) {
        let t_s = self.clock.now_s();
        match fault {
            Fault::UnplugStage => self.stage_cable.unplug(true),
            Fault::PlugStage => self.stage_cable.unplug(false),
            Fault::LoseReply => self.stage_cable.disturb(ReplyFault::Lose),
            Fault::CorruptReply => self.stage_cable.disturb(ReplyFault::Corrupt),
            Fault::SplitReply => self.stage_cable.disturb(ReplyFault::Split),
            Fault::DoubleReply => self.stage_cable.disturb(ReplyFault::Double),
            Fault::NoiseReply => self.stage_cable.disturb(ReplyFault::Noise),
            Fault::UnplugInterrogator => self.interrogator_cable.unplug(true),
            Fault::PlugInterrogator => self.interrogator_cable.unplug(false),
            Fault::StreamGap { seconds } => *guard(&self.pause_until_s) = t_s + seconds,
            Fault::StreamGarbage => self.garbage.store(true, Ordering::SeqCst),
            Fault::LateReply => self.stage_cable.disturb(ReplyFault::Late),
            Fault::ForeignReply => self.stage_cable.disturb(ReplyFault::Foreign),
            Fault::InfoLines => self.stage_cable.disturb(ReplyFault::Info),
            Fault::AlertFlood { on } => self
                .stage_cable
                .flood(on.then_some(UnsolicitedTraffic::Alerts)),
            Fault::ForeignFlood { on } => self
                .stage_cable
                .flood(on.then_some(UnsolicitedTraffic::Foreign)),
            Fault::NeverAccept { on } => self.never_accepts.store(on, Ordering::SeqCst),
            Fault::ClockDrift { ppm } => guard(&self.unit_clock).drift(t_s, ppm),
            Fault::ClockStep { seconds } => guard(&self.unit_clock).step(t_s, seconds),
            Fault::ClockStop { on } => guard(&self.unit_clock).stop(t_s, on),
            Fault::FrozenCamera { on } => guard(&self.cameras).frozen = on,
            Fault::CameraSkew { ms } => guard(&self.cameras).skew_ms = ms,
            Fault::LostFrames { count } => guard(&self.cameras).lose += count,
            Fault::CameraMoved { mm, deg } => guard(&self.cameras).moved = (mm, deg),
            Fault::Exposure { factor } => guard(&self.cameras).exposure = factor,
            Fault::Board { view } => {
                self.show_board(view);
            }
            other => self.world().inject(other, t_s),
        }
    }
}

impl World {
    /// Stage position (mm) and the trajectory that the mount presents.
    fn place(&self, t_s: f64, scenario: &Scenario) -> (f64, u32) {
        let stage_mm = self.units.first().map_or(0.0, |u| u.axis.at(t_s).0);
        let trajectory = self.units.get(1).map_or(1, |mount| {
            let steps = mount.axis.spec.unit.from_mm(mount.axis.at(t_s).0);
            u32::try_from(steps / scenario.mount.steps_per_trajectory.max(1)).unwrap_or(0)
        });
        (stage_mm, trajectory)
    }

    /// Trajectory, depth of the groove (mm), and whether stage or mount move.
    pub(crate) fn camera_view(&self, t_s: f64, scenario: &Scenario) -> (u32, f64, bool) {
        let (stage_mm, trajectory) = self.place(t_s, scenario);
        let moving = self.units.iter().any(|u| u.axis.at(t_s).1 != 0.0);
        (trajectory, self.physics.groove_mm(stage_mm), moving)
    }

    fn scan(&mut self, serial: u64, t_s: f64, scenario: &Scenario) -> Scan {
        let (stage_mm, trajectory) = self.place(t_s, scenario);
        let nm = self.physics.step(t_s, trajectory, stage_mm);
        let mut peaks_nm = nm.map(Some);
        if self.crossing {
            peaks_nm[1] = Some(nm[2] + 0.0004);
        }
        for (peak, lost) in peaks_nm.iter_mut().zip(self.lost) {
            if lost {
                *peak = None;
            }
        }
        let (grating, count) = &mut self.valueless;
        if *count > 0 {
            *count -= 1;
            peaks_nm[*grating] = Some(f64::NAN);
        }
        Scan {
            serial,
            t_s,
            peaks_nm,
            health: self.health,
        }
    }

    fn inject(&mut self, fault: Fault, t_s: f64) {
        let Some(stage) = self.units.first_mut() else {
            return;
        };
        match fault {
            Fault::Stall => stage.axis.arm_stall(),
            Fault::BusyForEver => stage.axis.arm_endless(),
            Fault::Limit => stage.axis.stop_dead(t_s, "FE"),
            Fault::Displaced => stage.axis.raise("WM"),
            Fault::DriverOff => stage.axis.stop_dead(t_s, "FD"),
            Fault::Critical => stage.axis.stop_dead(t_s, "FF"),
            Fault::PowerCut | Fault::Reset => stage.power_cycle(t_s),
            Fault::SignalDrift { pm_per_s } => self.physics.drift(t_s, pm_per_s),
            Fault::LostSamples { count } => self.skip += count,
            Fault::CalibrationFault { on } => self.health.calibration_fault = on,
            Fault::TecFault { on } => self.health.tec_over = on,
            Fault::DataInvalid { on } => self.health.error_code = if on { 9 } else { 0 },
            Fault::PeakLost { grating, on } => {
                if let Some(slot) = self.lost.get_mut(grating) {
                    *slot = on;
                }
            }
            Fault::NanPeak { grating, count } if grating < self.lost.len() => {
                self.valueless = (grating, count)
            }
            Fault::PeakCrossing { on } => self.crossing = on,
            Fault::TemperatureStep { degc } => self.physics.step_temperature(degc),
            _ => {}
        }
    }
}
