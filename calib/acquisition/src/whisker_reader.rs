//! One whisker's readings out of the scans: assigned, flagged, temperature compensated; nothing is
//! filled in.

use crate::assign::ChannelMap;
use crate::error::AcquisitionError;
use wcal_core::FbgSpec;
use wcal_core::device::FbgReading;
use wcal_core::rig_devices::InterrogatorRig;
use wcal_core::stream::{Flags, WhiskerReading};

const PM_PER_NM: f64 = 1e3;
/// Largest difference between the scan rate that is stated and that of the device's clock.
const RATE_SHARE: f64 = 0.02;

/// Turns scans into readings of one whisker.
#[derive(Debug, Clone)]
pub struct WhiskerReader {
    name: String,
    map: ChannelMap,
    fbg: FbgSpec,
    nominal_nm: [f64; 2],
    rate_hz: f64,
    first: Option<(u64, f64)>,
    last: Option<(u64, f64)>,
    /// Scans with a peak of reference and sensing gratings.
    seen: [u64; 3],
    judged: bool,
}

impl WhiskerReader {
    /// The reader of a whisker whose calibration has `fbg`; `place` names the rig.
    ///
    /// # Errors
    /// Where the rig's gratings are not those of the calibration, or one of them is missing.
    pub fn new(
        place: &str,
        interrogator: &InterrogatorRig,
        whisker: &str,
        fbg: &FbgSpec,
    ) -> Result<Self, AcquisitionError> {
        let of = if whisker.is_empty() {
            String::new()
        } else {
            format!(" of whisker {whisker}")
        };
        let fail = |field: &str, expected: String, found: String| {
            Err(AcquisitionError::input(
                format!("{place}: {field}{of}"),
                expected,
                found,
            ))
        };
        // A model of shifts has no absolute wavelength to compare a live peak with.
        let Some(nominal_nm) = fbg.nominal_nm else {
            let expected = "a calibration with nominal wavelengths".to_owned();
            return fail("gratings", expected, "one made from shifts".to_owned());
        };
        let mut wanted = vec![("fbg_1", nominal_nm[0]), ("fbg_2", nominal_nm[1])];
        if fbg.needs_reference() {
            let Some(nm) = fbg.reference_nominal_nm else {
                let expected = "a calibration with the reference's nominal wavelength".to_owned();
                return fail("fbg_ref", expected, "none".to_owned());
            };
            wanted.push(("fbg_ref", nm));
        }
        // A sensor with other gratings would give moments that look sound.
        for (name, nm) in wanted {
            let Some(grating) = interrogator.grating_of(whisker, name) else {
                let expected = format!("a grating at {nm} nm, as the calibration has");
                return fail(name, expected, "none".to_owned());
            };
            if !((grating.nominal_nm - nm).abs() <= grating.window_nm) {
                let expected = format!(
                    "the calibration's {nm} nm to within {} nm",
                    grating.window_nm
                );
                return fail(name, expected, format!("{} nm", grating.nominal_nm));
            }
        }
        Ok(Self {
            name: format!("{place}{of}"),
            map: ChannelMap::of(interrogator, whisker),
            fbg: fbg.clone(),
            nominal_nm,
            rate_hz: interrogator.rate_hz,
            first: None,
            last: None,
            seen: [0; 3],
            judged: false,
        })
    }

    /// Takes a scan. `dropped`: scans were dropped on this side since the one before.
    ///
    /// # Errors
    /// After the first second: another scan rate than stated, or a grating that never had a peak.
    pub fn take(
        &mut self,
        reading: &FbgReading,
        dropped: bool,
    ) -> Result<WhiskerReading, AcquisitionError> {
        let device_s = reading.clocks.device_s.unwrap_or(reading.clocks.host_s);
        let first = *self.first.get_or_insert((reading.serial, device_s));
        let mut flags = Flags::default();
        let mut flag = |on: bool, which: Flags| {
            if on {
                flags = flags.with(which);
            }
        };
        if let Some((serial, last_s)) = self.last {
            flag(reading.serial != serial + 1, Flags::GAP);
            flag(!(device_s > last_s), Flags::CLOCK);
        }
        flag(dropped, Flags::DROPPED);
        self.last = Some((reading.serial, device_s));
        let faults = reading.health.faults();
        // A fan that fails falsifies no wavelength yet; every other fault may.
        flag(!faults.is_empty() && faults != ["fan-fault"], Flags::UNIT);
        let assigned = self.map.assign(reading);
        let compensate = self.fbg.needs_reference();
        flag(
            assigned.sensing_nm.iter().any(Option::is_none),
            Flags::PEAK_LOST,
        );
        flag(assigned.crossing, Flags::CROSSING);
        flag(
            compensate && assigned.reference_nm.is_none(),
            Flags::REFERENCE_LOST,
        );
        let peaks = [
            assigned.reference_nm,
            assigned.sensing_nm[0],
            assigned.sensing_nm[1],
        ];
        for (seen, peak) in self.seen.iter_mut().zip(peaks) {
            *seen += u64::from(peak.is_some());
        }
        let reference_pm = assigned
            .reference_nm
            .zip(self.fbg.reference_nominal_nm)
            .map(|(nm, at)| (nm - at) * PM_PER_NM);
        // A faulty unit's peak, or one whose temperature cannot be taken out, is no reading.
        let bad = Flags::UNIT.with(Flags::REFERENCE_LOST).0;
        let shift_pm = assigned.usable().filter(|_| flags.0 & bad == 0).map(|nm| {
            let raw_pm = [0, 1].map(|k| (nm[k] - self.nominal_nm[k]) * PM_PER_NM);
            self.fbg.compensated_pm(raw_pm, reference_pm)
        });
        self.judge(first, reading)?;
        Ok(WhiskerReading {
            serial: reading.serial,
            t_s: device_s - first.1,
            shift_pm,
            rise_degc: reference_pm
                .and_then(|pm| self.fbg.rise_degc(pm))
                .unwrap_or(0.0),
            flags,
        })
    }

    /// Once, after a second of scans.
    fn judge(&mut self, first: (u64, f64), reading: &FbgReading) -> Result<(), AcquisitionError> {
        let Some((serial, last_s)) = self.last else {
            return Ok(());
        };
        let scans = serial.saturating_sub(first.0) as f64;
        if self.judged || scans < self.rate_hz {
            return Ok(());
        }
        self.judged = true;
        let found_hz = scans / (last_s - first.1);
        if !((found_hz / self.rate_hz - 1.0).abs() <= RATE_SHARE) {
            let expected = format!("{} scans a second (rate_hz)", self.rate_hz);
            return Err(AcquisitionError::input(
                &self.name,
                expected,
                format!("{found_hz:.1}"),
            ));
        }
        // A grating that never showed is a wrong channel map, not a lost peak.
        for (name, seen) in ["fbg_ref", "fbg_1", "fbg_2"].iter().zip(self.seen) {
            if seen == 0 && (*name != "fbg_ref" || self.fbg.needs_reference()) {
                let expected = format!("a peak of {name} in its window (channel map)");
                let all = format!(
                    "none in a second; the last scan has {:?} nm",
                    reading.peaks_nm
                );
                return Err(AcquisitionError::input(&self.name, expected, all));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Rig, tests::RIG};
    use wcal_core::device::Clocks;

    fn fbg() -> FbgSpec {
        FbgSpec {
            nominal_nm: Some([1541.2, 1535.8]),
            reference_nominal_nm: Some(1537.3),
            temperature_pm_per_degc: Some([10.0, 12.0]),
            reference_temperature_pm_per_degc: Some(10.0),
            temperature_compensated: false,
        }
    }

    fn reader(from: &str, to: &str) -> Result<WhiskerReader, AcquisitionError> {
        let rig = Rig::parse("rig.toml", &RIG.replace(from, to)).unwrap();
        WhiskerReader::new("rig.toml", &rig.interrogator, "", &fbg())
    }

    fn scan(serial: u64, peaks: &[f64]) -> FbgReading {
        let t = 1e9 + serial as f64 / 2000.0;
        let clocks = Clocks {
            host_s: t,
            device_s: Some(t),
        };
        FbgReading {
            serial,
            peaks_nm: vec![peaks.to_vec()],
            clocks,
            ..FbgReading::default()
        }
    }

    const GOOD: [f64; 3] = [1535.812, 1537.31, 1541.21];

    #[test]
    fn readings_are_compensated_and_what_is_lost_is_flagged_never_filled_in() {
        let mut reader = reader("", "").unwrap();
        let mut take = |serial, peaks: &[f64]| reader.take(&scan(serial, peaks), false).unwrap();
        let good = take(0, &GOOD);
        // The reference rose by 10 pm: 1 K, that is 10 and 12 pm.
        let shift = good.shift_pm.unwrap();
        assert!(
            shift[0].abs() < 1e-6 && shift[1].abs() < 1e-6 && good.flags.none(),
            "{good:?}"
        );
        assert!((good.rise_degc - 1.0).abs() < 1e-6);
        for (serial, peaks, flag) in [
            (1, &[1535.8, 1537.3][..], Flags::PEAK_LOST),
            (2, &[1535.8, f64::NAN, 1541.2], Flags::REFERENCE_LOST),
            (3, &[1535.8, 1536.1, 1537.3, 1541.2], Flags::CROSSING),
            (4, &[f64::NAN, 1537.3, 1541.2], Flags::PEAK_LOST),
        ] {
            let bad = take(serial, peaks);
            assert_eq!((bad.shift_pm, bad.flags), (None, flag), "{peaks:?}");
        }
        let after = take(9, &GOOD);
        assert_eq!((after.flags, after.shift_pm.is_some()), (Flags::GAP, true));
        assert!((after.t_s - 9.0 / 2000.0).abs() < 1e-6);
        let mut sick = scan(10, &GOOD);
        sick.health.error_code = 9;
        let sick = reader.take(&sick, true).unwrap();
        assert_eq!(
            (sick.flags, sick.shift_pm),
            (Flags::UNIT.with(Flags::DROPPED), None)
        );
    }

    #[test]
    fn wrong_channel_maps_lost_gratings_and_other_rates_are_named() {
        let swapped = RIG
            .replace("\"fbg_1\"", "\"x\"")
            .replace("\"fbg_2\"", "\"fbg_1\"")
            .replace("\"x\"", "\"fbg_2\"");
        let rig = Rig::parse("rig.toml", &swapped).unwrap();
        let error = WhiskerReader::new("rig.toml", &rig.interrogator, "", &fbg())
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("fbg_1") && error.contains("1541.2") && error.contains("1535.8"),
            "{error}"
        );
        let mut slow = reader("rate_hz = 2000", "rate_hz = 1000").unwrap();
        let error = (0..3000)
            .find_map(|k| slow.take(&scan(k, &GOOD), false).err())
            .unwrap()
            .to_string();
        assert!(
            error.contains("1000 scans") && error.contains("2000.0"),
            "{error}"
        );
        let mut dark = reader(
            "channel = 1, nominal_nm = 1541.2",
            "channel = 2, nominal_nm = 1541.2",
        )
        .unwrap();
        let error = (0..3000)
            .find_map(|k| dark.take(&scan(k, &GOOD), false).err())
            .unwrap()
            .to_string();
        assert!(
            error.contains("fbg_1") && error.contains("channel map"),
            "{error}"
        );
        // Control: the right map and rate pass.
        let mut right = reader("", "").unwrap();
        assert!((0..3000).all(|k| right.take(&scan(k, &GOOD), false).is_ok()));
    }
}
