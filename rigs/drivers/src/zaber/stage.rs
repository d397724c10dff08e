//! A linear stage on a chain of ASCII units.

use super::chain::{Answer, Chain};
use super::flags;
use super::units::Microsteps;
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Deadline;
use wcal_core::device::{
    Clocks, DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading,
};

/// Settings that are read from a unit and kept with the session.
const SETTINGS: [&str; 7] = [
    "limit.min",
    "limit.max",
    "maxspeed",
    "accel",
    "resolution",
    "comm.alert",
    "system.voltage",
];
/// Longest wait for standstill after `stop`.
const HALT: Duration = Duration::from_secs(3);
/// Pause between polls: the line carries some 500 questions a second.
const POLL: Duration = Duration::from_millis(5);

/// One axis of a chain, in mm.
#[derive(Debug)]
pub struct ZaberStage {
    chain: Rc<RefCell<Chain>>,
    address: u8,
    axis: u8,
    unit: Microsteps,
    limit_steps: i64,
    clock: HostClock,
    commanded_mm: Option<f64>,
    homing: bool,
}

impl ZaberStage {
    /// An axis of an open chain with its microstep size (from rig.toml: the protocol does not
    /// report it). Reads travel and speed; moves nothing.
    ///
    /// # Errors
    /// When the unit does not answer or its limit is no number.
    pub fn new(
        chain: Rc<RefCell<Chain>>,
        address: u8,
        axis: u8,
        unit: Microsteps,
        clock: HostClock,
    ) -> Result<Self, DeviceError> {
        let mut stage = Self {
            chain,
            address,
            axis,
            unit,
            limit_steps: 0,
            clock,
            commanded_mm: None,
            homing: false,
        };
        stage.limit_steps = stage.number("get limit.max")?;
        stage.chain.borrow_mut().remember_speed(address, axis)?;
        Ok(stage)
    }

    /// The chain, for a second axis and for its statistics.
    pub fn chain(&self) -> Rc<RefCell<Chain>> {
        Rc::clone(&self.chain)
    }

    fn ask(&mut self, command: &str) -> Result<Answer, DeviceError> {
        self.chain
            .borrow_mut()
            .ask(self.address, self.axis, command)
    }

    fn number(&mut self, command: &str) -> Result<i64, DeviceError> {
        let answer = self.ask(command)?;
        answer
            .data
            .parse()
            .map_err(|_| self.fail(DeviceErrorKind::Protocol, command, "a number", &answer.data))
    }

    fn fail(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        DeviceError::new(kind, self.chain.borrow().name(), action, expected, found)
    }

    /// Waits between two questions.
    pub(crate) fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        self.chain.borrow_mut().pause(pause, deadline);
    }

    /// All flags shown; one question only when there is one.
    fn flags(&mut self, highest: &str) -> Result<Vec<String>, DeviceError> {
        if highest == "--" {
            return Ok(Vec::new());
        }
        let mut list = listed(&self.ask("warnings")?);
        if list.is_empty() {
            list.push(highest.to_owned());
        }
        Ok(list)
    }

    /// Refuses what the flags forbid.
    fn judge(&self, action: &str, flags: &[String]) -> Result<(), DeviceError> {
        match flags::worst(flags, self.homing) {
            None => Ok(()),
            Some((flag, kind, text)) => {
                let found = format!("{flag}: {text}{}", flags::remedy(flag));
                Err(self.fail(kind, action, "no fault or warning", &found))
            }
        }
    }
}

/// Flags of the answer to `warnings`, behind their count.
fn listed(answer: &Answer) -> Vec<String> {
    answer
        .data
        .split_whitespace()
        .skip(1)
        .map(str::to_owned)
        .collect()
}

impl Stage for ZaberStage {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        let mut get = |name: &str| self.ask(&format!("get {name}")).map(|a| a.data);
        let (model, serial) = (get("deviceid")?, get("system.serial")?);
        let firmware = get("version")?;
        let mut settings = Vec::new();
        for name in SETTINGS {
            // Older firmware lacks some of them.
            match get(name) {
                Ok(value) => settings.push((name.to_owned(), value)),
                Err(e) if e.kind == DeviceErrorKind::Rejected => {}
                Err(e) => return Err(e),
            }
        }
        settings.push(("microstep_um".to_owned(), self.unit.size_um.to_string()));
        Ok(DeviceIdentity {
            driver: "zaber-ascii".to_owned(),
            model,
            serial,
            firmware,
            settings,
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        Ok([0.0, self.unit.to_mm(self.limit_steps as f64)])
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        self.homing = true;
        self.commanded_mm = Some(0.0);
        self.ask("home").map(|_| ())
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let action = format!("move to {target_mm:.4} mm");
        let steps = self.unit.from_mm(target_mm);
        if !(0..=self.limit_steps).contains(&steps) || !target_mm.is_finite() {
            let limit = format!(
                "a target in 0..{:.3} mm",
                self.unit.to_mm(self.limit_steps as f64)
            );
            return Err(self.fail(
                DeviceErrorKind::OutOfRange,
                &action,
                &limit,
                &format!("{target_mm}"),
            ));
        }
        let answer = self.ask("")?;
        let flags = self.flags(&answer.flag)?;
        self.judge(&action, &flags)?;
        let speed = self.unit.speed_data(speed_mm_s);
        self.chain
            .borrow_mut()
            .set_speed(self.address, self.axis, speed)?;
        self.ask(&format!("move abs {steps}"))?;
        // What was commanded is the microstep, not the wish.
        self.commanded_mm = Some(self.unit.to_mm(steps as f64));
        Ok(())
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        let answer = self.ask("get pos")?;
        let host_s = self.clock.now_s();
        // "nan" parses, and would be at every target.
        let steps: f64 = answer
            .data
            .parse()
            .ok()
            .filter(|s: &f64| s.is_finite())
            .ok_or_else(|| {
                self.fail(
                    DeviceErrorKind::Protocol,
                    "read position",
                    "a number",
                    &answer.data,
                )
            })?;
        let flags = self.flags(&answer.flag)?;
        self.judge("read position", &flags)?;
        if !answer.busy {
            self.homing = false;
        }
        Ok(StageReading {
            commanded_mm: self.commanded_mm,
            measured_mm: self.unit.to_mm(steps),
            moving: answer.busy,
            flags,
            clocks: Clocks {
                host_s,
                device_s: None,
            },
        })
    }

    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        let shown = listed(&self.ask("warnings")?);
        self.ask("warnings clear")?;
        Ok(shown
            .into_iter()
            .filter(|flag| flags::is_latched(flag))
            .collect())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        let ask = |command: &str| {
            self.chain
                .borrow_mut()
                .ask_to_stop(self.address, self.axis, command)
                .map(|answer| answer.busy)
        };
        ask("stop")?;
        let deadline = Deadline::uninterruptible(HALT);
        while ask("")? {
            if deadline.is_over() {
                let name = self.chain.borrow().name().to_owned();
                return Err(deadline.error(&name, "stop", "standstill", "still moving"));
            }
            self.chain.borrow_mut().pause(POLL, &deadline);
        }
        Ok(())
    }
}
