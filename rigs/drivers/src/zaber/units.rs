//! Units of Zaber's protocols: microsteps, and speed and acceleration data that count them.
//!
//! Source: the protocol manuals' conversion `data = v / microstep * 1.6384`
//! (firmware-notes/zaber-lsm100a.md).

/// Speed data per microstep per second.
const SPEED_FACTOR: f64 = 1.6384;
/// Acceleration data per microstep per second squared.
const ACCELERATION_FACTOR: f64 = 1.6384e-4;

/// Microsteps of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Microsteps {
    /// Size of one microstep, um.
    pub size_um: f64,
}

impl Microsteps {
    /// Nearest microstep to a position in mm.
    pub fn from_mm(self, mm: f64) -> i64 {
        (mm * 1000.0 / self.size_um).round() as i64
    }

    /// Position in mm.
    pub fn to_mm(self, steps: f64) -> f64 {
        steps * self.size_um / 1000.0
    }

    /// Speed data from mm/s, at least 1: zero means "default" to some firmware.
    pub fn speed_data(self, mm_s: f64) -> i64 {
        ((mm_s * 1000.0 / self.size_um * SPEED_FACTOR).round() as i64).max(1)
    }

    /// Speed in mm/s from its data.
    pub fn speed_mm_s(self, data: f64) -> f64 {
        data / SPEED_FACTOR * self.size_um / 1000.0
    }

    /// Acceleration in mm/s^2 from its data.
    pub fn acceleration_mm_s2(self, data: f64) -> f64 {
        data / ACCELERATION_FACTOR * self.size_um / 1000.0
    }

    /// Acceleration data from mm/s^2.
    pub(crate) fn acceleration_data(self, mm_s2: f64) -> i64 {
        ((mm_s2 * 1000.0 / self.size_um * ACCELERATION_FACTOR).round() as i64).max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::Microsteps;

    #[test]
    fn the_travel_of_the_lsm100a_is_its_number_of_microsteps() {
        let unit = Microsteps { size_um: 0.047_625 };
        assert_eq!(unit.from_mm(101.6), 2_133_333);
        assert!((unit.to_mm(2_133_333.0) - 101.6).abs() < 5e-5);
    }

    #[test]
    fn speed_and_acceleration_come_back_through_their_data() {
        let unit = Microsteps { size_um: 0.047_625 };
        assert_eq!(unit.speed_data(7.0), 240_815);
        assert!((unit.speed_mm_s(unit.speed_data(3.2) as f64) - 3.2).abs() < 1e-4);
        assert!((unit.acceleration_mm_s2(unit.acceleration_data(40.0) as f64) - 40.0).abs() < 0.2);
    }
}
