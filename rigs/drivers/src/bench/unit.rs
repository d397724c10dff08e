//! A Zaber unit of the virtual bench: one axis behind the ASCII command set.
//!
//! Commands and settings follow firmware-notes/zaber-lsm100a.md.

use super::ascii::{Answer, Command, Header};
use super::axis::{Axis, AxisSpec};
use crate::zaber::units::Microsteps;
use serde::Deserialize;
use std::collections::BTreeMap;

/// How a unit presents itself.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnitSpec {
    /// `get deviceid`.
    pub device_id: u32,
    /// `get system.serial`.
    pub serial: u32,
    /// `get version`.
    pub firmware: String,
    /// Microstep size, um.
    pub microstep_um: f64,
    /// Highest position, microsteps.
    pub limit_steps: i64,
    /// Highest speed, mm/s.
    pub max_speed_mm_s: f64,
    /// Acceleration, mm/s^2.
    pub acceleration_mm_s2: f64,
    /// Position at power-up, mm.
    pub start_mm: f64,
    /// Whether it starts with a reference.
    pub homed: bool,
    /// Replies carry checksums: `asked` when the command did, else `always` or `never`.
    pub checksums: ChecksumHabit,
}

/// When replies carry checksums.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ChecksumHabit {
    /// When the command did.
    #[default]
    Asked,
    /// Always.
    Always,
    /// Never.
    Never,
}

impl Default for UnitSpec {
    fn default() -> Self {
        Self {
            device_id: 50_105,
            serial: 67_890,
            firmware: "7.38".to_owned(),
            microstep_um: 0.047_625,
            limit_steps: 2_133_333,
            max_speed_mm_s: 26.0,
            acceleration_mm_s2: 200.0,
            start_mm: 37.0,
            homed: false,
            checksums: ChecksumHabit::Asked,
        }
    }
}

/// A unit with its address and settings.
pub struct Unit {
    address: u8,
    spec: UnitSpec,
    /// The axis; public to the plant and to the fault injector.
    pub axis: Axis,
    settings: BTreeMap<&'static str, i64>,
    silent_until_s: f64,
}

impl Unit {
    /// A unit that has just been switched on.
    pub fn new(address: u8, spec: UnitSpec) -> Self {
        let axis_spec = AxisSpec {
            unit: Microsteps {
                size_um: spec.microstep_um,
            },
            limit_steps: spec.limit_steps,
            max_speed_mm_s: spec.max_speed_mm_s,
            acceleration_mm_s2: spec.acceleration_mm_s2,
        };
        let axis = Axis::new(axis_spec, spec.start_mm, spec.homed);
        Self {
            address,
            spec,
            axis,
            settings: default_settings(),
            silent_until_s: f64::NEG_INFINITY,
        }
    }

    /// Speaks to this unit and it is awake.
    pub fn hears(&self, command: &Command, t_s: f64) -> bool {
        t_s >= self.silent_until_s && (command.device == 0 || command.device == self.address)
    }

    /// An alert when a motion ended and alerts are on.
    pub fn update(&mut self, t_s: f64) -> Option<String> {
        let ended = self.axis.update(t_s);
        let asked = self.settings["comm.alert"] == 1;
        (ended && asked).then(|| self.header(None, 1, false, t_s).alert())
    }

    /// Power lost and back: silent for a second of bench time.
    pub(crate) fn power_cycle(&mut self, t_s: f64) {
        self.axis.power_cycle(t_s);
        self.silent_until_s = t_s + 1.0;
        self.settings = default_settings();
    }

    /// Executes a command; the packets to send.
    pub fn execute(&mut self, command: &Command, t_s: f64) -> Vec<String> {
        self.axis.update(t_s);
        // A virtual unit has one axis; axis 0 is all of them.
        let answer = if command.axis > 1 {
            Answer::refused("BADAXIS")
        } else {
            self.dispatch(command, t_s)
        };
        let checked = match self.spec.checksums {
            ChecksumHabit::Asked => command.checked || self.settings["comm.checksum"] == 1,
            ChecksumHabit::Always => true,
            ChecksumHabit::Never => false,
        };
        // Once more: an armed stall strikes with the move that has just begun.
        self.axis.update(t_s);
        self.header(command.id, command.axis, checked, t_s)
            .reply(&answer)
    }

    fn header(&self, id: Option<u8>, axis: u8, checked: bool, t_s: f64) -> Header {
        Header {
            device: self.address,
            axis,
            id,
            busy: self.axis.busy(t_s),
            flag: self.axis.flags().first().unwrap_or(&"--"),
            checked,
        }
    }

    fn dispatch(&mut self, command: &Command, t_s: f64) -> Answer {
        let words: Vec<&str> = command.words.iter().map(String::as_str).collect();
        let done = match words.as_slice() {
            ["get", name] => {
                let found = self.get(name, t_s);
                return found.map_or_else(|| Answer::refused("BADCOMMAND"), Answer::ok);
            }
            ["warnings"] => return self.warnings(),
            ["warnings", "clear"] => {
                // The reply names the flags that it takes away.
                let answer = self.warnings();
                self.axis.clear_flags();
                return answer;
            }
            ["tools", "echo", rest @ ..] => return Answer::ok(rest.join(" ")),
            [] => Ok(()),
            ["home"] => self.axis.home(t_s),
            ["stop" | "estop"] => {
                self.axis.stop(t_s);
                Ok(())
            }
            ["move", rest @ ..] => self.do_move(rest, t_s),
            ["set", name, value] => self.set(name, value),
            ["system", "reset"] => {
                self.power_cycle(t_s);
                Ok(())
            }
            ["renumber", number] => match number.parse() {
                Ok(address @ 1..100) => {
                    self.address = address;
                    Ok(())
                }
                _ => Err("BADDATA"),
            },
            _ => Err("BADCOMMAND"),
        };
        match done {
            Ok(()) => Answer::ok("0"),
            Err(reason) => Answer::refused(reason),
        }
    }

    fn do_move(&mut self, words: &[&str], t_s: f64) -> Result<(), &'static str> {
        let number = |text: &str| text.parse::<f64>().map_err(|_| "BADDATA");
        let unit = self.axis.spec.unit;
        // A third word is the speed of this move, a fourth its acceleration (firmware 7).
        let speed = words.get(2).map(|w| number(w)).transpose()?;
        let speed = speed.map(|d| unit.speed_mm_s(d));
        match words {
            ["abs", target, ..] => {
                // Assumed (?): a unit without reference refuses with BADDATA.
                if !self.axis.homed() {
                    return Err("BADDATA");
                }
                self.axis.move_to(t_s, number(target)? as i64, speed)
            }
            ["rel", distance, ..] => {
                let target = self.axis.steps(t_s) + number(distance)? as i64;
                self.axis.move_to(t_s, target, speed)
            }
            ["vel", data, ..] => self.axis.move_velocity(t_s, unit.speed_mm_s(number(data)?)),
            ["min"] => self.axis.move_to(t_s, 0, None),
            ["max"] => self.axis.move_to(t_s, self.axis.spec.limit_steps, None),
            _ => Err("BADCOMMAND"),
        }
    }

    fn warnings(&self) -> Answer {
        let flags = self.axis.flags();
        let list: String = flags.iter().map(|f| format!(" {f}")).collect();
        Answer::ok(format!("{:02}{list}", flags.len()))
    }

    fn get(&self, name: &str, t_s: f64) -> Option<String> {
        let unit = self.axis.spec.unit;
        Some(match name {
            "deviceid" | "device.id" => self.spec.device_id.to_string(),
            "system.serial" => self.spec.serial.to_string(),
            "version" => self.spec.firmware.clone(),
            "pos" | "encoder.pos" => self.axis.steps(t_s).to_string(),
            "limit.max" => self.axis.spec.limit_steps.to_string(),
            "limit.min" => "0".to_owned(),
            "maxspeed" => unit.speed_data(self.axis.speed_mm_s).to_string(),
            "accel" | "motion.accelonly" | "motion.decelonly" => unit
                .acceleration_data(self.axis.motion.acceleration_mm_s2)
                .to_string(),
            "limit.home.triggered" => u8::from(self.axis.homed()).to_string(),
            "comm.address" => self.address.to_string(),
            other => self.settings.get(other)?.to_string(),
        })
    }

    fn set(&mut self, name: &str, value: &str) -> Result<(), &'static str> {
        let number: f64 = value.parse().map_err(|_| "BADDATA")?;
        let unit = self.axis.spec.unit;
        match name {
            "maxspeed" => return self.axis.set_speed(unit.speed_mm_s(number)),
            "accel" if number > 0.0 => {
                self.axis.motion.acceleration_mm_s2 = unit.acceleration_mm_s2(number);
            }
            _ => *self.settings.get_mut(name).ok_or("BADCOMMAND")? = number as i64,
        }
        Ok(())
    }
}

fn default_settings() -> BTreeMap<&'static str, i64> {
    BTreeMap::from([
        ("comm.alert", 0),
        ("comm.checksum", 0),
        ("comm.protocol", 2),
        ("comm.rs232.baud", 115_200),
        ("comm.rs232.protocol", 2),
        ("comm.packet.size.max", 80),
        ("comm.word.size.max", 50),
        ("comm.command.packets.max", 1),
        ("resolution", 64),
        ("system.access", 1),
        ("system.axiscount", 1),
        ("system.led.enable", 1),
        ("system.voltage", 48),
        ("version.build", 1234),
    ])
}

#[cfg(test)]
mod tests {
    use super::super::ascii::parse;
    use super::*;

    fn say(unit: &mut Unit, line: &str, t_s: f64) -> String {
        let command = parse(line.as_bytes()).unwrap();
        unit.execute(&command, t_s).concat()
    }

    #[test]
    fn a_session_with_the_unit() {
        let mut unit = Unit::new(1, UnitSpec::default());
        assert_eq!(
            say(&mut unit, "/1 1 move abs 100", 0.0),
            "@01 1 RJ IDLE WR BADDATA\r\n"
        );
        assert_eq!(say(&mut unit, "/1 1 home", 0.0), "@01 1 OK BUSY WR 0\r\n");
        assert_eq!(say(&mut unit, "/1 1", 10.0), "@01 1 OK IDLE -- 0\r\n");
        assert_eq!(
            say(&mut unit, "/1 1 move abs 209974", 10.0),
            "@01 1 OK BUSY -- 0\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 1 get pos", 20.0),
            "@01 1 OK IDLE -- 209974\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 1 move abs 9999999", 20.0),
            "@01 1 RJ IDLE -- BADDATA\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 2 home", 20.0),
            "@01 2 RJ IDLE -- BADAXIS\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 1 dance", 20.0),
            "@01 1 RJ IDLE -- BADCOMMAND\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 get limit.max", 20.0),
            "@01 0 OK IDLE -- 2133333\r\n"
        );
    }

    #[test]
    fn warnings_are_listed_and_cleared_and_stop_interrupts() {
        let mut unit = Unit::new(
            1,
            UnitSpec {
                homed: true,
                ..UnitSpec::default()
            },
        );
        say(&mut unit, "/1 1 move vel 100000", 0.0);
        assert_eq!(say(&mut unit, "/1 1 stop", 1.0), "@01 1 OK BUSY NI 0\r\n");
        assert_eq!(
            say(&mut unit, "/1 1 warnings clear", 2.0),
            "@01 1 OK IDLE -- 01 NI\r\n"
        );
        assert_eq!(
            say(&mut unit, "/1 1 warnings", 2.0),
            "@01 1 OK IDLE -- 00\r\n"
        );
    }

    #[test]
    fn a_stall_is_shown_until_the_flags_are_cleared() {
        let mut unit = Unit::new(
            1,
            UnitSpec {
                homed: true,
                ..UnitSpec::default()
            },
        );
        unit.axis.arm_stall();
        say(&mut unit, "/1 1 move abs 0", 0.0);
        assert_eq!(
            say(&mut unit, "/1 1 warnings", 1.0),
            "@01 1 OK IDLE FS 01 FS\r\n"
        );
        // Neither a move nor a reference search takes it back.
        say(&mut unit, "/1 1 move abs 1000", 1.0);
        say(&mut unit, "/1 1 home", 20.0);
        assert_eq!(say(&mut unit, "/1 1", 40.0), "@01 1 OK IDLE FS 0\r\n");
        say(&mut unit, "/1 1 warnings clear", 40.0);
        assert_eq!(say(&mut unit, "/1 1", 40.0), "@01 1 OK IDLE -- 0\r\n");
        // A missing reference is not cleared so.
        say(&mut unit, "/1 system reset", 41.0);
        say(&mut unit, "/1 1 warnings clear", 43.0);
        assert_eq!(say(&mut unit, "/1 1", 43.0), "@01 1 OK IDLE WR 0\r\n");
    }

    #[test]
    fn a_reset_unit_is_silent_and_then_has_no_reference() {
        let mut unit = Unit::new(
            1,
            UnitSpec {
                homed: true,
                ..UnitSpec::default()
            },
        );
        say(&mut unit, "/1 system reset", 5.0);
        let poll = parse(b"/1 1").unwrap();
        assert!(!unit.hears(&poll, 5.5) && unit.hears(&poll, 6.5));
        assert_eq!(say(&mut unit, "/1 1", 6.5), "@01 1 OK IDLE WR 0\r\n");
    }

    #[test]
    fn alerts_come_when_a_motion_ends_and_only_when_asked_for() {
        let mut unit = Unit::new(
            1,
            UnitSpec {
                homed: true,
                ..UnitSpec::default()
            },
        );
        say(&mut unit, "/1 1 move abs 1000", 0.0);
        assert_eq!(unit.update(9.0), None);
        say(&mut unit, "/1 set comm.alert 1", 10.0);
        say(&mut unit, "/1 1 move abs 2000", 10.0);
        assert_eq!(unit.update(10.0), None);
        assert_eq!(unit.update(19.0).as_deref(), Some("!01 1 IDLE --\r\n"));
    }
}
