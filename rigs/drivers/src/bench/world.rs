//! State shared by all servers of the virtual bench, and the scanner that makes the scans.

use super::clock::BenchClock;
use super::faults::{Fault, FaultState, ScheduledFault};
use super::lock::guard;
use super::plant::{Physics, Plant};
use super::scenario::Scenario;
use super::scene::Scene;
use super::unit::{Unit, UnitSpec};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use wcal_core::device::InterrogatorHealth;
use wcal_core::shared_time::lives;

/// One scan as the optics saw it.
#[derive(Clone, Copy)]
pub(crate) struct Scan {
    /// Running number.
    pub serial: u64,
    /// Bench time, s.
    pub t_s: f64,
    /// Reference, first and second sensing grating, nm; `None` where a peak is lost.
    pub peaks_nm: [Option<f64>; 3],
    /// Health of the unit.
    pub health: InterrogatorHealth,
}

impl Scan {
    /// Its peaks in ascending order, nm.
    pub(crate) fn ascending_nm(&self) -> Vec<f64> {
        let mut peaks: Vec<f64> = self.peaks_nm.iter().flatten().copied().collect();
        peaks.sort_by(f64::total_cmp);
        peaks
    }
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
    schedule: Vec<ScheduledFault>,
    scanned: u64,
}

/// Shared by all threads of one bench.
pub struct BenchState {
    /// The truth.
    pub scenario: Scenario,
    /// Bench time.
    pub clock: BenchClock,
    /// What the cameras see.
    pub(crate) scene: Option<Arc<dyn Scene>>,
    pub(crate) faults: Mutex<FaultState>,
    world: Mutex<World>,
    /// Scans kept for clients that are behind.
    scans: Mutex<VecDeque<Scan>>,
    fresh: Condvar,
    stop: AtomicBool,
}

impl BenchState {
    /// A bench by its own clock.
    pub(crate) fn new(scenario: Scenario, plant: Box<dyn Plant>, clock: BenchClock) -> Self {
        let mut units = vec![Unit::new(1, scenario.stage.unit.clone())];
        if scenario.mount.present {
            // Identity of a placeholder: no real mount has been seen (firmware-notes/zaber-
            // lsm100a.md).
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
        let scene = plant.scene();
        let world = World {
            units,
            physics: Physics::new(&scenario, plant),
            health: InterrogatorHealth::default(),
            lost: [false; 3],
            crossing: false,
            valueless: (0, 0),
            skip: 0,
            schedule,
            scanned: 0,
        };
        Self {
            clock,
            scene,
            faults: Mutex::new(FaultState::of(&scenario.cameras)),
            scenario,
            world: Mutex::new(world),
            scans: Mutex::default(),
            fresh: Condvar::new(),
            stop: AtomicBool::new(false),
        }
    }

    /// The moving parts.
    pub fn world(&self) -> MutexGuard<'_, World> {
        guard(&self.world)
    }

    /// Shows the board in attitude `view`, or takes it away; an attitude that there is not changes
    /// nothing.
    pub(crate) fn show_board(&self, view: Option<usize>) {
        if view.is_none_or(|k| k < self.scenario.cameras.board_views) {
            guard(&self.faults).cameras.board = view;
        }
    }

    /// Whether the bench is shutting down.
    pub(crate) fn stopping(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    /// Signals every thread to end.
    pub(crate) fn shut_down(&self) {
        self.stop.store(true, Ordering::SeqCst);
        self.fresh.notify_all();
    }

    /// Whether the bench goes on; asked in every round of a thread that its time waits for.
    pub(crate) fn goes_on(&self) -> bool {
        lives(Duration::ZERO);
        !self.stopping()
    }

    /// Wall time by which the scans that are made are behind.
    pub(crate) fn behind(&self) -> Duration {
        let made_s = self.world().scanned as f64 / self.scenario.interrogator.rate_hz;
        self.clock.wall(self.clock.now_s() - made_s)
    }

    /// Time of the interrogator's clock at bench time `t_s`, s since 1970.
    pub(crate) fn device_s(&self, t_s: f64) -> f64 {
        let spec = &self.scenario.interrogator;
        let own_s = guard(&self.faults).unit_clock.at(t_s) + t_s * spec.clock_drift_ppm * 1e-6;
        self.clock.epoch_s(own_s) + spec.clock_offset_s
    }

    /// The newest scan.
    pub(crate) fn newest(&self) -> Option<Scan> {
        guard(&self.scans).back().copied()
    }

    /// Number of the next scan.
    pub(crate) fn next_serial(&self) -> u64 {
        self.newest().map_or(0, |scan| scan.serial + 1)
    }

    /// Scans from number `from` on, waiting a moment for the first; scans that were dropped are
    /// missing.
    pub(crate) fn scans_from(&self, from: u64) -> Vec<Scan> {
        let waiting =
            |s: &mut VecDeque<Scan>| !self.stopping() && s.back().is_none_or(|s| s.serial < from);
        let moment = Duration::from_millis(20);
        let waited = self
            .fresh
            .wait_timeout_while(guard(&self.scans), moment, waiting);
        let (scans, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let start = scans.partition_point(|s| s.serial < from);
        scans.range(start..).take(4096).copied().collect()
    }

    /// Makes all scans that are due, and carries out scheduled faults. Called by one thread only.
    pub(crate) fn scan(&self) {
        let now_s = self.clock.now_s();
        // The lock goes before the faults are carried out, which take it themselves.
        let due: Vec<ScheduledFault> = {
            let schedule = &mut self.world().schedule;
            let count = schedule.partition_point(|f| f.at_s <= now_s);
            schedule.drain(..count).collect()
        };
        due.into_iter().for_each(|due| self.inject(due.fault));
        let spec = &self.scenario.interrogator;
        let period_s = 1.0 / spec.rate_hz;
        let mut fresh = Vec::new();
        {
            // A bench that is far behind catches up in portions: the lock is free in between.
            let mut world = self.world();
            while world.scanned as f64 * period_s <= now_s && fresh.len() < 20_000 {
                let serial = world.scanned;
                let scan = world.scan(serial, serial as f64 * period_s, &self.scenario);
                world.scanned += 1;
                // A lost scan keeps its number, so that the stream shows the gap.
                if world.skip > 0 {
                    world.skip -= 1;
                } else {
                    fresh.push(scan);
                }
            }
        }
        let mut scans = guard(&self.scans);
        scans.extend(fresh);
        // What the unit's buffer cannot hold is lost, the oldest first.
        let excess = scans.len().saturating_sub(spec.buffer);
        scans.drain(..excess);
        drop(scans);
        self.fresh.notify_all();
    }

    /// Carries out a fault now.
    pub(crate) fn inject(&self, fault: Fault) {
        let t_s = self.clock.now_s();
        // Alone: it takes the lock of the faults by itself.
        if let Fault::Board { view } = fault {
            return self.show_board(view);
        }
        let (mut world, mut faults) = (self.world(), guard(&self.faults));
        let stage = &mut world.units[0];
        match fault {
            Fault::Stall => stage.axis.arm_stall(),
            Fault::BusyForEver => stage.axis.arm_endless(),
            Fault::Limit => stage.axis.stop_dead(t_s, "FE"),
            Fault::Displaced => stage.axis.raise("WM"),
            Fault::DriverOff => stage.axis.stop_dead(t_s, "FD"),
            Fault::Critical => stage.axis.stop_dead(t_s, "FF"),
            Fault::PowerCut | Fault::Reset => stage.power_cycle(t_s),
            Fault::UnplugStage => faults.stage_out = true,
            Fault::PlugStage => faults.stage_out = false,
            Fault::LoseReply
            | Fault::CorruptReply
            | Fault::SplitReply
            | Fault::DoubleReply
            | Fault::NoiseReply
            | Fault::LateReply
            | Fault::ForeignReply
            | Fault::InfoLines => faults.replies.push_back(fault),
            Fault::AlertFlood { on } => faults.flood = on.then_some(false),
            Fault::ForeignFlood { on } => faults.flood = on.then_some(true),
            Fault::NeverAccept { on } => faults.never_accepts = on,
            Fault::UnplugInterrogator => faults.interrogator_out = true,
            Fault::PlugInterrogator => faults.interrogator_out = false,
            Fault::StreamGap { seconds } => faults.pause_until_s = t_s + seconds,
            Fault::StreamGarbage => faults.garbage = true,
            Fault::ClockDrift { ppm } => faults.unit_clock.drift(t_s, ppm),
            Fault::ClockStep { seconds } => faults.unit_clock.step(t_s, seconds),
            Fault::ClockStop { on } => faults.unit_clock.stop(t_s, on),
            Fault::FrozenCamera { on } => faults.cameras.frozen = on,
            Fault::CameraSkew { ms } => faults.cameras.skew_ms = ms,
            Fault::LostFrames { count } => faults.cameras.lose += count,
            Fault::CameraMoved { mm, deg } => faults.cameras.moved = (mm, deg),
            Fault::Exposure { factor } => faults.cameras.exposure = factor,
            Fault::SignalDrift { pm_per_s } => world.physics.drift = (t_s, pm_per_s),
            Fault::TemperatureStep { degc } => world.physics.temperature_step_degc += degc,
            Fault::LostSamples { count } => world.skip += count,
            Fault::CalibrationFault { on } => world.health.calibration_fault = on,
            Fault::TecFault { on } => world.health.tec_over = on,
            Fault::DataInvalid { on } => world.health.error_code = if on { 9 } else { 0 },
            Fault::PeakCrossing { on } => world.crossing = on,
            Fault::PeakLost { grating, on } if grating < world.lost.len() => {
                world.lost[grating] = on
            }
            Fault::NanPeak { grating, count } if grating < world.lost.len() => {
                world.valueless = (grating, count)
            }
            // A grating that there is not.
            Fault::PeakLost { .. } | Fault::NanPeak { .. } | Fault::Board { .. } => {}
        }
    }
}

impl World {
    /// Stage position (mm) and the trajectory that the mount presents.
    fn place(&self, t_s: f64, scenario: &Scenario) -> (f64, u32) {
        let trajectory = self.units.get(1).map_or(1, |mount| {
            let steps = mount.axis.steps(t_s) / scenario.mount.steps_per_trajectory.max(1);
            u32::try_from(steps).unwrap_or(0)
        });
        (self.units[0].axis.at(t_s).0, trajectory)
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
        // Closer than any unit resolves two peaks.
        if self.crossing {
            peaks_nm[1] = Some(nm[2] + 0.0004);
        }
        for (peak, lost) in peaks_nm.iter_mut().zip(self.lost) {
            *peak = peak.filter(|_| !lost);
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
}
