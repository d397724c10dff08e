//! One data frame: an 88-byte little-endian header and the peaks of four channels as u32.

use crate::host::{u16_at, u32_at};
use wcal_core::device::{Clocks, FbgReading, InterrogatorHealth};

/// Length of the header.
pub const HEADER: usize = 88;
/// Optical channels of the x30 core.
pub const CHANNELS: usize = 4;
/// Largest number of peaks of a frame; data with a larger count is not a frame.
const MAX_PEAKS: usize = 1024;
/// Wavelengths outside belong to no unit of this family, nm.
const BAND_NM: std::ops::RangeInclusive<f64> = 1200.0..=1800.0;

/// Stands, like 0, where a peak has no value: it becomes NaN, belongs to no grating, and marks its
/// scan.
const NO_VALUE: u32 = u32::MAX;

/// A decoded frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Scan counter.
    pub serial: u32,
    /// Time of the scan, s.
    pub device_s: f64,
    /// Peaks per channel, nm.
    pub peaks_nm: Vec<Vec<f64>>,
    /// Flags and error code.
    pub health: InterrogatorHealth,
    /// Counts per nm.
    pub granularity: u32,
    /// Divider of the data rate.
    pub rate_divider: u16,
    /// Thermistor count.
    pub thermistor: u16,
}

impl Frame {
    /// As a reading, with the host time of arrival (s).
    pub fn reading(self, host_s: f64) -> FbgReading {
        FbgReading {
            serial: u64::from(self.serial),
            peaks_nm: self.peaks_nm,
            health: self.health,
            clocks: Clocks {
                host_s,
                device_s: Some(self.device_s),
            },
        }
    }
}

/// Length of the frame that starts with this header, or what makes it implausible.
///
/// # Errors
/// What was expected and what was found. `header` must hold at least 88 bytes.
pub(crate) fn frame_length(header: &[u8]) -> Result<usize, String> {
    if header.len() < HEADER {
        return Err(format!(
            "a header of {HEADER} bytes, found {}",
            header.len()
        ));
    }
    // Headers are looked for byte by byte: noise must hardly ever pass for one.
    let peaks: usize = (0..CHANNELS)
        .map(|c| usize::from(u16_at(header, 16 + 2 * c)))
        .sum();
    let stated = usize::from(u16_at(header, 12));
    if peaks != stated || peaks > MAX_PEAKS {
        return Err(format!(
            "{stated} peaks in all, found {peaks} over the channels"
        ));
    }
    let length = usize::from(u16_at(header, 50));
    // Firmware that leaves the field empty means 88.
    if length != 0 && length != HEADER {
        return Err(format!("a header length of {HEADER}, found {length}"));
    }
    if u32_at(header, 72) == 0 {
        return Err("a granularity above 0, found 0".to_owned());
    }
    if u32_at(header, 32) >= 1_000_000 {
        return Err(format!(
            "microseconds below 1000000, found {}",
            u32_at(header, 32)
        ));
    }
    Ok(HEADER + 4 * peaks)
}

/// Decodes a frame; bytes after its peaks (a token) are ignored.
///
/// # Errors
/// What was expected and what was found.
pub fn decode(bytes: &[u8]) -> Result<Frame, String> {
    let length = frame_length(bytes)?;
    if bytes.len() < length {
        return Err(format!("{length} bytes, found {}", bytes.len()));
    }
    let granularity = u32_at(bytes, 72);
    let mut peaks_nm = Vec::with_capacity(CHANNELS);
    let mut at = HEADER;
    for channel in 0..CHANNELS {
        let count = usize::from(u16_at(bytes, 16 + 2 * channel));
        let peaks: Vec<f64> = (0..count)
            .map(|k| match u32_at(bytes, at + 4 * k) {
                NO_VALUE | 0 => f64::NAN,
                value => f64::from(value) / f64::from(granularity),
            })
            .collect();
        // A frame that was found in noise shows itself by wavelengths of no such unit.
        if let Some(odd) = peaks
            .iter()
            .find(|nm| !nm.is_nan() && !BAND_NM.contains(*nm))
        {
            return Err(format!("wavelengths in {BAND_NM:?} nm, found {odd}"));
        }
        at += 4 * count;
        peaks_nm.push(peaks);
    }
    // Bits of the faults: docs/src/devices.md, Micron Optics sm130.
    let (flags, light) = (bytes[3], bytes[7]);
    let health = InterrogatorHealth {
        calibration_fault: flags & 0x40 != 0,
        fan_fault: flags & 0x18 != 0,
        soa_thermal: light & 0x08 != 0,
        soa_current: light & 0x04 != 0,
        tec_over: light & 0x02 != 0,
        tec_under: light & 0x01 != 0,
        error_code: bytes[47],
        buffer_percent: bytes[48],
    };
    Ok(Frame {
        serial: u32_at(bytes, 28),
        device_s: f64::from(u32_at(bytes, 36)) + f64::from(u32_at(bytes, 32)) * 1e-6,
        peaks_nm,
        health,
        granularity,
        rate_divider: u16_at(bytes, 68),
        thermistor: u16_at(bytes, 4),
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A frame written by hand after the table of docs/src/devices.md: two peaks on CH1, one on
    /// CH3.
    pub(crate) fn sample_frame(serial: u32) -> Vec<u8> {
        let mut b = vec![0_u8; HEADER];
        b[12..14].copy_from_slice(&3_u16.to_le_bytes());
        b[16..18].copy_from_slice(&2_u16.to_le_bytes());
        b[20..22].copy_from_slice(&1_u16.to_le_bytes());
        b[28..32].copy_from_slice(&serial.to_le_bytes());
        b[32..36].copy_from_slice(&500_000_u32.to_le_bytes());
        b[36..40].copy_from_slice(&1_000_u32.to_le_bytes());
        b[50..52].copy_from_slice(&88_u16.to_le_bytes());
        b[72..76].copy_from_slice(&1_000_000_u32.to_le_bytes());
        for nm in [1_535_758_000_u32, 1_541_174_000, 1_537_267_123] {
            b.extend(nm.to_le_bytes());
        }
        b
    }

    #[test]
    fn a_frame_decodes_to_nanometres_seconds_and_channels() {
        let frame = decode(&sample_frame(7)).unwrap();
        assert_eq!((frame.serial, frame.device_s), (7, 1000.5));
        assert_eq!(
            frame.peaks_nm,
            [
                vec![1535.758, 1541.174],
                vec![],
                vec![1_537.267_123],
                vec![]
            ]
        );
        assert!(frame.health.faults().is_empty());
    }

    #[test]
    fn every_fault_bit_is_surfaced() {
        for (at, bit, name) in [
            (3, 0x40, "calibration-fault"),
            (3, 0x10, "fan-fault"),
            (3, 0x08, "fan-fault"),
            (7, 0x08, "soa-thermal"),
            (7, 0x04, "soa-current"),
            (7, 0x02, "tec-over-temperature"),
            (7, 0x01, "tec-under-temperature"),
            (47, 9, "error-code"),
        ] {
            let mut b = sample_frame(0);
            b[at] = bit;
            assert_eq!(decode(&b).unwrap().health.faults(), [name]);
        }
        let mut b = sample_frame(0);
        b[3] = 0x20;
        assert!(
            decode(&b).unwrap().health.faults().is_empty(),
            "start of frame is no fault"
        );
    }

    #[test]
    fn malformed_frames_are_refused() {
        let good = sample_frame(0);
        assert!(decode(&good[..87]).is_err());
        assert!(decode(&good[..99]).is_err());
        for (at, value) in [(12, 9), (50, 7), (72 + 2, 0), (34, 255)] {
            let mut bad = good.clone();
            bad[at] = value;
            if at == 74 {
                bad[72..76].fill(0);
            }
            assert!(decode(&bad).is_err(), "byte {at}");
        }
        let mut no_value = good.clone();
        no_value[88..92].copy_from_slice(&0_u32.to_le_bytes());
        no_value[92..96].copy_from_slice(&NO_VALUE.to_le_bytes());
        let peaks_nm = decode(&no_value).unwrap().peaks_nm;
        assert!(
            peaks_nm[0].iter().all(|nm| nm.is_nan()) && peaks_nm[2] == [1_537.267_123],
            "{peaks_nm:?}"
        );
        let mut out_of_band = good;
        out_of_band[88..92].copy_from_slice(&1_u32.to_le_bytes());
        assert!(decode(&out_of_band).unwrap_err().contains("wavelengths"));
    }
}
