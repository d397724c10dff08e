//! The steps of a sweep, one by one: what is commanded, waited for, recorded, and done when
//! something fails.

use crate::error::AcquisitionError;
use crate::limits::LimitedStage;
use crate::message::SweepEvent;
use crate::monitor::{Monitor, StreamCounts, lock};
use crate::plan::{ARRIVAL_MM, Plan, Pose, Step};
use crate::recorder::{Level, Recorder};
use crate::rig::Rig;
use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;
use wcal_core::deadline::{Deadline, Interrupt, move_allowance};
use wcal_core::device::{DeviceError, DeviceErrorKind, Mount, Permission, Stage, StageReading};

/// Pause between stage polls while it moves, and while it stands.
pub(crate) const POLL_MOVING: Duration = Duration::from_millis(4);
const POLL_STANDING: Duration = Duration::from_millis(20);
/// Speed of the sync move, mm/s.
const SYNC_MM_S: f64 = 4.0;
/// Share of a window's scans that must have come, and windows tried.
const MIN_COVERED: f64 = 0.5;
const WINDOWS: usize = 5;
/// Longest wait for the pair of a pose after its averaging window (wall time).
const PICTURE: Duration = Duration::from_secs(3);
/// A wait by the device's clock may take this many times its length, and a margin (wall): a slower
/// clock counts nothing any more.
const SLOW_TIMES: f64 = 10.0;
const SLOW_MARGIN: Duration = Duration::from_secs(30);

/// A stream that is silent this long has failed (wall time).
pub(crate) const SILENCE: Duration = Duration::from_secs(2);

/// Opens the stage again after its link was lost.
pub(crate) type Reopen<'a> = dyn FnMut() -> Result<LimitedStage, DeviceError> + 'a;

/// What a sweep works with.
pub struct SweepBench<'a> {
    /// The linear stage, behind its limits.
    pub stage: LimitedStage,
    /// Opens it again.
    pub reopen: &'a mut Reopen<'a>,
    /// The mount.
    pub mount: &'a mut dyn Mount,
    /// Watches the stream; filled by [`crate::sweep::acquire`].
    pub monitor: &'a Mutex<Monitor>,
    /// Everything is recorded here.
    pub recorder: &'a Recorder,
    /// Set when the user wants an end.
    pub interrupt: &'a Interrupt,
    /// Waits: a bench in this process lets its own time pass instead.
    pub pause: &'a mut dyn FnMut(Duration),
}

/// What a user may want to see while it runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Progress {
    /// Steps completed and in all.
    pub step: usize,
    /// Steps in all.
    pub steps: usize,
    /// Depth, mm.
    pub stage_mm: f64,
    /// Newest wavelengths of reference and sensing gratings, nm.
    pub wavelengths_nm: [Option<f64>; 3],
    /// Windows whose drift gate did not open in time.
    pub unsettled: usize,
    /// Counters of the stream.
    pub counts: StreamCounts,
    /// Device time, s.
    pub device_s: Option<f64>,
}

/// Where a sweep failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The stage itself.
    Stage,
    /// Interrogator, camera, mount, disk, or the user.
    Elsewhere,
}

/// A running sweep.
pub(crate) struct Sweep<'b, 'r, 'p> {
    pub(crate) bench: SweepBench<'b>,
    pub(crate) rig: &'r Rig,
    pub(crate) plan: &'r Plan,
    pub(crate) steps: usize,
    pub(crate) step: usize,
    pub(crate) trajectory: Option<u32>,
    pub(crate) last: StageReading,
    /// Where the stage was sent and has arrived, mm; none while it moves.
    pub(crate) stands_mm: Option<f64>,
    pub(crate) unsettled: usize,
    pub(crate) fault: Fault,
    pub(crate) progress: &'p mut dyn FnMut(&Progress),
}

impl Sweep<'_, '_, '_> {
    /// Reference, stream, a safe place before the first move toward the wire, and there the mount.
    pub(crate) fn prepare(&mut self, allowed: Permission) -> Result<(), DeviceError> {
        self.reference(allowed)?;
        // Later waits count by the device's clock: the stream has to run before the first move.
        let first_scan = Deadline::uninterruptible(SILENCE * 2);
        while self.monitor().device_s().is_none() {
            let over = first_scan.is_over();
            self.tick(POLL_STANDING)?;
            if over && self.monitor().device_s().is_none() {
                let (kind, action) = (DeviceErrorKind::Timeout, "wait for scans");
                let device = "interrogator";
                return Err(DeviceError::new(kind, device, action, "scans", "silence"));
            }
        }
        self.event("start", SweepEvent::default())?;
        // The mount turns only while the groove is free of the wire.
        self.go_to(self.rig.stage.retract_mm, self.rig.stage.speed_mm_s)?;
        self.bench.mount.prepare(allowed)
    }

    /// Every step that is not done yet, then back from the wire.
    pub(crate) fn all_steps(
        &mut self,
        steps: &[Step],
        skip: &BTreeSet<u32>,
        done: &mut usize,
    ) -> Result<(), DeviceError> {
        for (index, step) in steps.iter().enumerate() {
            self.step = index;
            // A resumed sweep turns the mount again only where readings are still to be made.
            if let Step::Mount { trajectory } = step {
                self.trajectory = Some(*trajectory);
                let open = steps[index + 1..]
                    .iter()
                    .enumerate()
                    .take_while(|(_, s)| !matches!(s, Step::Mount { .. }))
                    .any(|(k, _)| !skip.contains(&((index + 1 + k) as u32)));
                if open {
                    self.mount(*trajectory)?;
                }
                continue;
            }
            if skip.contains(&(index as u32)) {
                continue;
            }
            self.carry_out(step)?;
            // Last of all: a run that is killed before it makes the step again.
            self.event("done", SweepEvent::default())?;
            *done += 1;
        }
        self.go_to(self.rig.stage.retract_mm, self.rig.stage.speed_mm_s)?;
        self.event("finished", SweepEvent::default())
    }

    fn carry_out(&mut self, step: &Step) -> Result<(), DeviceError> {
        let at_mm = self.last.measured_mm - self.rig.stage.zero_mm;
        let depths_mm = step.waypoints(at_mm, &self.rig.stage);
        match step {
            Step::Mount { trajectory } => self.mount(*trajectory),
            Step::Soak => self.soak(),
            Step::Sync { .. } => self.sync(&depths_mm),
            Step::Settled(pose) => self.settled(pose, &depths_mm),
            Step::Moving { rows_hz, pose, .. } => self.moving(&depths_mm, *rows_hz, pose),
        }
    }

    fn mount(&mut self, trajectory: u32) -> Result<(), DeviceError> {
        self.go_to(self.rig.stage.retract_mm, self.rig.stage.speed_mm_s)?;
        self.bench.mount.select(trajectory)?;
        self.trajectory = Some(trajectory);
        let event = SweepEvent {
            trajectory,
            begin_s: self.stage_s(),
            ..SweepEvent::default()
        };
        self.event("mount", event)
    }

    /// Waits at rest until the drift gate opens, or the soak time is over.
    fn soak(&mut self) -> Result<(), DeviceError> {
        let begin_s = self.device_s();
        // Drift of a bench that warms up is slow: a longer window shows it above the noise.
        let window_s = self.plan.settle.window_s * 5.0;
        let settled = self.wait_for_gate(begin_s, window_s, self.plan.soak_s)?;
        let event = SweepEvent {
            begin_s,
            end_s: self.device_s(),
            settled,
            ..SweepEvent::default()
        };
        self.event("soak", event)
    }

    /// In and out of contact at a known speed: the signal reveals the delay between the devices.
    fn sync(&mut self, depths_mm: &[f64]) -> Result<(), DeviceError> {
        let speed_mm_s = SYNC_MM_S.min(self.rig.stage.speed_mm_s);
        let (away, there_and_back) = depths_mm.split_at(1);
        self.go_through(away, speed_mm_s)?;
        // At rest for 0.3 s at both ends: any delay that is searched for (0.25 s at most) fits in.
        let begin_s = self.stage_s();
        self.wait_until(begin_s + 0.3)?;
        self.go_through(there_and_back, speed_mm_s)?;
        let end_s = self.stage_s() + 0.3;
        self.wait_until(end_s)?;
        let event = SweepEvent {
            begin_s,
            end_s,
            speed_mm_s,
            trajectory: self.trajectory.unwrap_or(0),
            ..SweepEvent::default()
        };
        self.event("sync", event)
    }

    /// Move, dwell, drift gate, averaging window.
    fn settled(&mut self, pose: &Pose, depths_mm: &[f64]) -> Result<(), DeviceError> {
        self.go_through(depths_mm, pose.speed_mm_s)?;
        let arrived_s = self.stage_s();
        self.wait_until(arrived_s + pose.dwell_s)?;
        // Scans of the dwell count for the gate, those of the move do not.
        let settle = self.plan.settle;
        let settled = self.wait_for_gate(arrived_s, settle.window_s, settle.timeout_s)?;
        // The reading is kept and marked: one pose that creeps does not end a day's sweep.
        if !settled {
            self.unsettled += 1;
            let text = format!(
                "step {}: the signal did not settle in {} s",
                self.step, settle.timeout_s
            );
            let recorder = self.bench.recorder;
            let noted = recorder.text(self.last.clocks.host_s, Level::Warning, &text);
            noted.map_err(|e| disk(&e))?;
        }
        // The cameras take their picture while the window is averaged: both show the pose at rest.
        if !self.rig.camera.is_empty() {
            let since_host_s = self.last.clocks.host_s;
            self.monitor().picture = Some((self.step as u32, since_host_s));
        }
        let (begin_s, end_s) = self.window(pose.average_s)?;
        self.wait_for_picture()?;
        let event = SweepEvent {
            begin_s,
            end_s,
            arrived_s,
            settled,
            ..pose_event(pose)
        };
        self.event("window", event)
    }

    /// The stage stands until the pair of the pose is recorded; after a time limit the sweep
    /// continues without it.
    fn wait_for_picture(&mut self) -> Result<(), DeviceError> {
        let deadline = Deadline::uninterruptible(PICTURE);
        while self.monitor().picture.is_some() && !deadline.is_over() {
            self.tick(POLL_STANDING)?;
        }
        if self.monitor().picture.take().is_some() {
            self.event("picture-missed", SweepEvent::default())?;
        }
        Ok(())
    }

    /// An averaging window that the stream covers: one in a gap is repeated.
    fn window(&mut self, average_s: f64) -> Result<(f64, f64), DeviceError> {
        let min_scans = MIN_COVERED * average_s * self.rig.interrogator.rate_hz;
        for _ in 0..WINDOWS {
            let begin_s = self.device_s();
            let end_s = begin_s + average_s;
            self.wait_until(end_s)?;
            if self.monitor().scans_between(begin_s, end_s) >= min_scans {
                return Ok((begin_s, end_s));
            }
        }
        let expected = format!("{MIN_COVERED} of a window's scans in one of {WINDOWS}");
        Err(DeviceError::new(
            DeviceErrorKind::Timeout,
            "interrogator",
            "average",
            expected,
            "gaps",
        ))
    }

    /// Rows recorded during motion.
    fn moving(&mut self, depths_mm: &[f64], rows_hz: f64, pose: &Pose) -> Result<(), DeviceError> {
        let (from, to) = depths_mm.split_at(1);
        self.go_through(from, pose.speed_mm_s)?;
        let begin_s = self.stage_s() + 0.1;
        self.wait_until(begin_s)?;
        self.go_through(to, pose.speed_mm_s)?;
        let end_s = self.stage_s();
        // The stream may be behind the stage: scans of the last rows are waited for.
        self.wait_until(end_s + 0.1)?;
        let event = SweepEvent {
            begin_s,
            end_s,
            arrived_s: end_s,
            rows_hz,
            ..pose_event(pose)
        };
        self.event("moving", event)
    }

    fn go_through(&mut self, depths_mm: &[f64], speed_mm_s: f64) -> Result<(), DeviceError> {
        depths_mm
            .iter()
            .try_for_each(|depth_mm| self.go_to(*depth_mm, speed_mm_s))
    }

    /// Moves to a depth and checks that the stage got there.
    fn go_to(&mut self, depth_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let target_mm = self.rig.stage.zero_mm + depth_mm;
        let way_mm = target_mm - self.last.measured_mm;
        self.stands_mm = None;
        let started = self.bench.stage.start_move(target_mm, speed_mm_s);
        self.of_stage(started)?;
        self.until_standing(&format!("move to {target_mm:.4} mm"), way_mm, speed_mm_s)?;
        // A unit of the binary protocol has no stall flag: only another position shows it. A blocked
        // carriage stops on its way, never beyond.
        let found_mm = self.last.measured_mm;
        let short_mm = (target_mm - found_mm) * way_mm.signum();
        if short_mm.abs() > ARRIVAL_MM {
            if short_mm < 0.0 || short_mm > way_mm.abs() + ARRIVAL_MM {
                return self.displaced(target_mm);
            }
            return Err(DeviceError::new(
                DeviceErrorKind::Stalled,
                "stage",
                "move",
                format!("{target_mm:.4} mm"),
                format!("{found_mm:.4} mm"),
            ));
        }
        self.stands_mm = Some(target_mm);
        Ok(())
    }

    /// A stage that stands stays where it was sent: another program, or a hand at its knob, would
    /// leave readings of another place.
    fn still_there(&mut self) -> Result<(), DeviceError> {
        match self.stands_mm {
            Some(target_mm)
                if self.last.moving || (self.last.measured_mm - target_mm).abs() > ARRIVAL_MM =>
            {
                self.displaced(target_mm)
            }
            _ => Ok(()),
        }
    }

    /// Somebody else moves the stage.
    fn displaced(&mut self, target_mm: f64) -> Result<(), DeviceError> {
        let at_mm = self.last.measured_mm;
        let moves = if self.last.moving {
            "moving"
        } else {
            "standing"
        };
        self.of_stage(Err(DeviceError::new(
            DeviceErrorKind::Displaced,
            "stage",
            "stand",
            format!("the stage at {target_mm:.4} mm, where it was sent"),
            format!("it {moves} at {at_mm:.4} mm: another program or a hand moves it"),
        )))
    }

    /// Waits for the end of a motion, for as long as one of this way and speed may take: a stage
    /// that stays BUSY has failed.
    pub(crate) fn until_standing(
        &mut self,
        action: &str,
        way_mm: f64,
        speed_mm_s: f64,
    ) -> Result<(), DeviceError> {
        let allowed = move_allowance(way_mm, speed_mm_s, self.rig.clock_scale);
        let deadline = Deadline::after(allowed, self.bench.interrupt);
        loop {
            // The last look begins after the end: recording, or a busy computer, may have kept this
            // program from it.
            let over = deadline.is_over();
            self.tick(POLL_MOVING)?;
            if !self.last.moving {
                return Ok(());
            }
            if over {
                let found = format!("still moving (BUSY) at {:.4} mm", self.last.measured_mm);
                return self.of_stage(Err(deadline.error("stage", action, "standstill", &found)));
            }
        }
    }

    /// Waits for the stream to get there.
    fn wait_until(&mut self, end_s: f64) -> Result<(), DeviceError> {
        let deadline = self.by_device_clock(end_s - self.device_s());
        while self.device_s() < end_s {
            self.tick(POLL_STANDING)?;
            self.not_too_slow(&deadline, end_s)?;
        }
        Ok(())
    }

    /// A deadline for a wait that the device's clock counts, s.
    fn by_device_clock(&self, span_s: f64) -> Deadline {
        let own = Duration::try_from_secs_f64(SLOW_TIMES * span_s.max(0.0) / self.rig.clock_scale);
        let allowed = own.unwrap_or(Duration::MAX).saturating_add(SLOW_MARGIN);
        Deadline::after(allowed, self.bench.interrupt)
    }

    fn not_too_slow(&self, deadline: &Deadline, end_s: f64) -> Result<(), DeviceError> {
        if !deadline.is_over() {
            return Ok(());
        }
        let expected = format!("{end_s:.3} s by the device's clock");
        let found = format!("{:.3} s: it runs too slowly", self.device_s());
        Err(deadline.error("interrogator", "wait", &expected, &found))
    }

    /// True when the drift fell below the gate; a drift that its own error hides has not.
    fn wait_for_gate(
        &mut self,
        since_s: f64,
        window_s: f64,
        timeout_s: f64,
    ) -> Result<bool, DeviceError> {
        let end_s = self.device_s() + timeout_s;
        let gate = self.plan.settle.gate_pm_per_s;
        let deadline = self.by_device_clock(timeout_s);
        loop {
            let drift = self.monitor().drift_pm_per_s(since_s, window_s);
            if drift.is_some_and(|(slope, error)| slope.abs() < gate && error < gate) {
                return Ok(true);
            }
            if self.device_s() > end_s {
                return Ok(false);
            }
            self.tick(POLL_STANDING)?;
            self.not_too_slow(&deadline, end_s)?;
        }
    }

    /// One check of everything: stage, stream, user.
    fn tick(&mut self, pause: Duration) -> Result<(), DeviceError> {
        (self.bench.pause)(pause);
        self.bench.interrupt.check("sweep", "run")?;
        if let Some(fault) = self.monitor().fault() {
            return Err(fault.clone());
        }
        // Every look asks the stage: its answers are all that the reduction knows of its place.
        let reading = self.bench.stage.read();
        let reading = self.of_stage(reading)?;
        self.note(reading)?;
        self.still_there()?;
        let progress = {
            let monitor = self.monitor();
            let [first_nm, second_nm] = monitor.latest().sensing_nm;
            Progress {
                step: self.step,
                steps: self.steps,
                stage_mm: self.last.measured_mm - self.rig.stage.zero_mm,
                wavelengths_nm: [monitor.latest().reference_nm, first_nm, second_nm],
                unsettled: self.unsettled,
                counts: monitor.counts(),
                device_s: monitor.device_s(),
            }
        };
        (self.progress)(&progress);
        Ok(())
    }

    fn monitor(&self) -> MutexGuard<'_, Monitor> {
        lock(self.bench.monitor)
    }

    /// Remembers that it was the stage that failed.
    pub(crate) fn of_stage<T>(&mut self, done: Result<T, DeviceError>) -> Result<T, DeviceError> {
        // A user who wants an end is no fault of the stage: it may still retract.
        if matches!(&done, Err(e) if e.kind != DeviceErrorKind::Interrupted) {
            self.fault = Fault::Stage;
        }
        done
    }

    pub(crate) fn note(&mut self, reading: StageReading) -> Result<(), DeviceError> {
        self.bench.recorder.stage(&reading).map_err(|e| disk(&e))?;
        self.last = reading;
        Ok(())
    }

    /// Device time of the newest scan, s.
    fn device_s(&self) -> f64 {
        self.monitor().device_s().unwrap_or(0.0)
    }

    /// Device time of the last stage reading, s: a stream that is behind has not shown that moment
    /// yet.
    fn stage_s(&self) -> f64 {
        let host_s = self.last.clocks.host_s;
        self.monitor().device_s_at(host_s).unwrap_or(0.0)
    }

    fn event(&mut self, kind: &str, event: SweepEvent) -> Result<(), DeviceError> {
        let event = SweepEvent {
            kind: kind.to_owned(),
            step: self.step as u32,
            ..event
        };
        let recorded = self.bench.recorder.event(self.last.clocks.host_s, &event);
        recorded.map_err(|e| disk(&e))
    }
}

fn pose_event(pose: &Pose) -> SweepEvent {
    SweepEvent {
        role: format!("{:?}", pose.role).to_lowercase(),
        trajectory: pose.trajectory,
        replicate: pose.replicate,
        target_mm: pose.stage_mm,
        direction: pose.direction,
        speed_mm_s: pose.speed_mm_s,
        sealed: pose.sealed,
        ..SweepEvent::default()
    }
}

/// The recording could not be written: where, and why.
pub(crate) fn disk(error: &AcquisitionError) -> DeviceError {
    let (kind, expected) = (DeviceErrorKind::Configuration, "space on disk");
    DeviceError::new(kind, "recorder", "record", expected, error.to_string())
}
