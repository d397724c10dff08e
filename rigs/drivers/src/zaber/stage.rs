//! A linear stage on a chain of ASCII units.

use super::axis::Axis;
use super::chain::{Answer, Chain};
use super::flags;
use super::units::Microsteps;
use super::wire::Asks;
use super::{HALT, POLL};
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;
use wcal_core::clock::HostClock;
use wcal_core::deadline::Deadline;
use wcal_core::device::{DeviceError, DeviceErrorKind, DeviceIdentity, Stage, StageReading};

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

/// One axis of a chain, in mm.
pub struct ZaberStage {
    chain: Rc<RefCell<Chain>>,
    address: u8,
    /// Its number on the unit.
    number: u8,
    axis: Axis,
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
        number: u8,
        unit: Microsteps,
        clock: HostClock,
    ) -> Result<Self, DeviceError> {
        let limit_steps = {
            let mut chain = chain.borrow_mut();
            let limit_steps = chain.number(address, number, "get limit.max")?;
            chain.remember_speed(address, number)?;
            limit_steps
        };
        Ok(Self {
            chain,
            address,
            number,
            axis: Axis {
                unit,
                limit_steps,
                clock,
                commanded_mm: None,
            },
            homing: false,
        })
    }

    /// The chain, for a second axis and for its statistics.
    pub fn chain(&self) -> Rc<RefCell<Chain>> {
        Rc::clone(&self.chain)
    }

    fn ask(&mut self, command: &str) -> Result<Answer, DeviceError> {
        let mut chain = self.chain.borrow_mut();
        chain.ask(self.address, self.number, command)
    }

    fn fail(
        &self,
        kind: DeviceErrorKind,
        action: &str,
        expected: &str,
        found: &str,
    ) -> DeviceError {
        let mut chain = self.chain.borrow_mut();
        chain.wire().error(kind, action, expected, found)
    }

    /// Waits between two questions.
    pub(crate) fn pause(&mut self, pause: Duration, deadline: &Deadline) {
        self.chain.borrow_mut().wire().pause(pause, deadline);
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
        let Some((flag, kind, text)) = flags::worst(flags, self.homing) else {
            return Ok(());
        };
        let found = format!("{flag}: {text}{}", flags::remedy(flag));
        Err(self.fail(kind, action, "no fault or warning", &found))
    }
}

/// Flags of the answer to `warnings`, behind their count.
fn listed(answer: &Answer) -> Vec<String> {
    let words = answer.data.split_whitespace();
    words.skip(1).map(str::to_owned).collect()
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
        let size_um = self.axis.unit.size_um;
        settings.push(("microstep_um".to_owned(), size_um.to_string()));
        Ok(DeviceIdentity {
            driver: "zaber-ascii".to_owned(),
            model,
            serial,
            firmware,
            settings,
        })
    }

    fn travel_mm(&mut self) -> Result<[f64; 2], DeviceError> {
        Ok(self.axis.travel_mm())
    }

    fn start_home(&mut self) -> Result<(), DeviceError> {
        // Before the command: a unit that searches shows all the while that it has no reference.
        self.homing = true;
        self.axis.commanded_mm = Some(0.0);
        self.ask("home").map(drop)
    }

    fn start_move(&mut self, target_mm: f64, speed_mm_s: f64) -> Result<(), DeviceError> {
        let action = format!("move to {target_mm:.4} mm");
        let unit = self.axis.unit;
        let steps = self.axis.steps_to(target_mm).map_err(|expected| {
            let (kind, found) = (DeviceErrorKind::OutOfRange, target_mm.to_string());
            self.fail(kind, &action, &expected, &found)
        })?;
        // Units may refuse a move without reference (?): the driver does not rely on it.
        let answer = self.ask("")?;
        let flags = self.flags(&answer.flag)?;
        self.judge(&action, &flags)?;
        let speed = unit.speed_data(speed_mm_s);
        // Only firmware 7 takes a speed with the move itself: `maxspeed` serves older units, too.
        let (address, number) = (self.address, self.number);
        self.chain.borrow_mut().set_speed(address, number, speed)?;
        self.ask(&format!("move abs {steps}"))?;
        // What was commanded is the microstep, not the wish.
        self.axis.commanded_mm = Some(unit.to_mm(steps as f64));
        Ok(())
    }

    fn read(&mut self) -> Result<StageReading, DeviceError> {
        let answer = self.ask("get pos")?;
        // Stamped at once: the flags may take a further question.
        let host_s = self.axis.clock.now_s();
        let action = "read position";
        // "nan" parses, and would be at every target.
        let steps = answer.data.parse().ok().filter(|s: &f64| s.is_finite());
        let steps = steps.ok_or_else(|| {
            let kind = DeviceErrorKind::Protocol;
            self.fail(kind, action, "a number", &answer.data)
        })?;
        let flags = self.flags(&answer.flag)?;
        self.judge(action, &flags)?;
        self.homing &= answer.busy;
        Ok(self.axis.reading(host_s, steps, answer.busy, flags))
    }

    fn clear_flags(&mut self) -> Result<Vec<String>, DeviceError> {
        // Asked before they are cleared: afterwards nothing tells that the position is doubtful.
        let mut shown = listed(&self.ask("warnings")?);
        self.ask("warnings clear")?;
        shown.retain(|flag| flags::is_latched(flag));
        Ok(shown)
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        self.homing = false;
        let mut chain = self.chain.borrow_mut();
        let (address, number) = (self.address, self.number);
        chain.ask_to_stop(address, number, "stop")?;
        // The unit accepts the stop at once and brakes afterwards.
        let deadline = Deadline::uninterruptible(HALT);
        while chain.ask_to_stop(address, number, "")?.busy {
            if deadline.is_over() {
                let name = &chain.wire().name;
                return Err(deadline.error(name, "stop", "standstill", "still moving"));
            }
            chain.wire().pause(POLL, &deadline);
        }
        Ok(())
    }
}
