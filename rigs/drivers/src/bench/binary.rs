//! Zaber's binary protocol (T-series): six bytes, unit, command, little-endian i32.
//!
//! Commands: firmware-notes/zaber-binary.md. A motion command is answered when the motion has
//! ended.

use super::axis::Axis;

/// Error replies carry this command number.
const ERROR: u8 = 255;
/// Speed data of T-series units count 9.375 microsteps per second.
const SPEED_STEPS: f64 = 9.375;

/// Device mode without its home status, bit 7: the knob is off.
const MODE: i64 = 0x8;
/// Firmware, times 100, from which on the home status is a separate setting, too.
const OWN_HOME_STATUS: u32 = 600;

/// One message of either direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message {
    /// Unit number; 0 addresses all.
    pub unit: u8,
    /// Command number.
    pub command: u8,
    /// Data.
    pub data: i32,
}

impl Message {
    /// Six bytes as sent.
    pub fn bytes(self) -> [u8; 6] {
        let d = self.data.to_le_bytes();
        [self.unit, self.command, d[0], d[1], d[2], d[3]]
    }

    /// From six bytes.
    pub fn from_bytes(b: [u8; 6]) -> Self {
        Self {
            unit: b[0],
            command: b[1],
            data: i32::from_le_bytes([b[2], b[3], b[4], b[5]]),
        }
    }
}

/// The binary face of an axis.
pub struct BinaryUnit {
    number: u8,
    device_id: u32,
    firmware: u32,
    serial: u32,
    pending: Option<u8>,
}

impl BinaryUnit {
    /// A unit with its number and identity; `firmware` is e.g. 513 for 5.13.
    pub fn new(number: u8, device_id: u32, firmware: u32, serial: u32) -> Self {
        Self {
            number,
            device_id,
            firmware,
            serial,
            pending: None,
        }
    }

    /// The answer to the motion command that has ended since, if one has.
    pub fn update(&mut self, axis: &mut Axis, t_s: f64) -> Option<Message> {
        axis.update(t_s);
        if axis.busy(t_s) {
            return None;
        }
        let command = self.pending.take()?;
        let stalled = axis.flags().contains(&"FS");
        // Firmware 5 answers a stalled home with error 1; moves answer with where the carriage is.
        match stalled && command == 1 {
            true => self.say(ERROR, 1),
            false => self.say(command, axis.steps(t_s)),
        }
    }

    fn say(&self, command: u8, data: i64) -> Option<Message> {
        Some(Message {
            unit: self.number,
            command,
            data: data as i32,
        })
    }

    /// Executes a message; the immediate answer, if there is one.
    pub fn execute(&mut self, axis: &mut Axis, message: Message, t_s: f64) -> Option<Message> {
        if message.unit != 0 && message.unit != self.number {
            return None;
        }
        let unit = axis.spec.unit;
        let speed = |data: i32| f64::from(data) * SPEED_STEPS * unit.size_um / 1000.0;
        let reply = |data: i64| self.say(message.command, data);
        let fail = |code: u8| self.say(ERROR, code.into());
        let started = match message.command {
            0 => {
                axis.power_cycle(t_s);
                return None;
            }
            1 => axis.home(t_s),
            20 if !axis.homed() => return fail(20),
            20 => axis.move_to(t_s, message.data.into(), None),
            21 => axis.move_to(t_s, axis.steps(t_s) + i64::from(message.data), None),
            22 => match axis.move_velocity(t_s, speed(message.data)) {
                Ok(()) => return reply(message.data.into()),
                Err(_) => return fail(22),
            },
            23 => {
                axis.stop(t_s);
                Ok(())
            }
            42 => match axis.set_speed(speed(message.data)) {
                Ok(()) => return reply(message.data.into()),
                Err(_) => return fail(42),
            },
            44 => return reply(axis.spec.limit_steps),
            50 => return reply(self.device_id.into()),
            51 => return reply(self.firmware.into()),
            53 => {
                let steps_s = axis.speed_mm_s * 1000.0 / unit.size_um;
                return match message.data {
                    40 => self.say(40, MODE | i64::from(axis.homed()) << 7),
                    42 => self.say(42, (steps_s / SPEED_STEPS).round() as i64),
                    44 => self.say(44, axis.spec.limit_steps),
                    103 if self.firmware >= OWN_HOME_STATUS => self.say(103, axis.homed().into()),
                    _ => fail(53),
                };
            }
            54 => return reply(if axis.busy(t_s) { 20 } else { 0 }),
            55 => return reply(message.data.into()),
            60 => return reply(axis.steps(t_s)),
            63 => return reply(self.serial.into()),
            _ => return fail(64),
        };
        match started {
            Ok(()) => {
                self.pending = Some(message.command);
                None
            }
            Err(_) => fail(message.command),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::axis::AxisSpec;
    use super::*;
    use crate::zaber::units::Microsteps;

    fn rig(homed: bool) -> (BinaryUnit, Axis) {
        let unit = Microsteps { size_um: 0.047_625 };
        let spec = AxisSpec {
            unit,
            limit_steps: 2_133_333,
            max_speed_mm_s: 7.0,
            acceleration_mm_s2: 100.0,
        };
        (
            BinaryUnit::new(1, 4151, 513, 99),
            Axis::new(spec, 10.0, homed),
        )
    }

    fn message(command: u8, data: i32) -> Message {
        Message {
            unit: 1,
            command,
            data,
        }
    }

    #[test]
    fn bytes_are_little_endian() {
        let m = message(20, 1000);
        assert_eq!(m.bytes(), [1, 20, 0xe8, 3, 0, 0]);
        assert_eq!(Message::from_bytes(message(20, -5).bytes()).data, -5);
    }

    #[test]
    fn a_motion_is_answered_when_it_has_ended() {
        let (mut unit, mut axis) = rig(true);
        assert_eq!(unit.execute(&mut axis, message(20, 420_000), 0.0), None);
        assert_eq!(unit.update(&mut axis, 0.5), None);
        assert_eq!(unit.update(&mut axis, 5.0), Some(message(20, 420_000)));
        assert_eq!(unit.update(&mut axis, 6.0), None);
        assert_eq!(
            unit.execute(&mut axis, message(60, 0), 6.0),
            Some(message(60, 420_000))
        );
    }

    #[test]
    fn the_home_status_is_a_bit_of_the_device_mode_and_a_setting_of_later_firmware() {
        for (homed, mode) in [(false, 0x8), (true, 0x88)] {
            let (mut unit, mut axis) = rig(homed);
            assert_eq!(
                unit.execute(&mut axis, message(53, 40), 0.0),
                Some(message(40, mode))
            );
            assert_eq!(
                unit.execute(&mut axis, message(53, 103), 0.0),
                Some(message(255, 53)),
                "5.13"
            );
            let mut later = BinaryUnit::new(1, 4151, 612, 99);
            assert_eq!(
                later.execute(&mut axis, message(53, 103), 0.0),
                Some(message(103, homed.into()))
            );
        }
    }

    #[test]
    fn targets_out_of_travel_and_unknown_commands_are_errors_and_others_units_are_ignored() {
        let (mut unit, mut axis) = rig(true);
        assert_eq!(
            unit.execute(&mut axis, message(20, 99_999_999), 0.0),
            Some(message(255, 20))
        );
        assert_eq!(
            unit.execute(&mut axis, message(200, 0), 0.0),
            Some(message(255, 64))
        );
        assert_eq!(
            unit.execute(
                &mut axis,
                Message {
                    unit: 2,
                    ..message(60, 0)
                },
                0.0
            ),
            None
        );
        let (mut unit, mut axis) = rig(false);
        assert_eq!(
            unit.execute(&mut axis, message(20, 5), 0.0),
            Some(message(255, 20))
        );
    }
}
