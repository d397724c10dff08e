//! Which peak belongs to which grating.

use crate::rig::Rig;
use wcal_core::device::FbgReading;
use wcal_core::rig_devices::InterrogatorRig;

/// Peaks closer than this cannot be resolved, nm.
const SEPARATION_NM: f64 = 0.002;

/// Wavelengths of the gratings in one scan, nm.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Assigned {
    /// Strain-isolated grating.
    pub reference_nm: Option<f64>,
    /// Sensing gratings.
    pub sensing_nm: [Option<f64>; 2],
    /// Two gratings of one channel are too close or share a peak.
    pub crossing: bool,
}

impl Assigned {
    /// Both sensing gratings, where neither is lost nor crossing.
    pub fn usable(&self) -> Option<[f64; 2]> {
        match (self.sensing_nm, self.crossing) {
            ([Some(a), Some(b)], false) => Some([a, b]),
            _ => None,
        }
    }
}

/// The channel map of a rig.
#[derive(Debug, Clone)]
pub struct ChannelMap {
    /// Reference, first, second: channel index, nominal and window, nm.
    gratings: [Option<(usize, f64, f64)>; 3],
}

impl ChannelMap {
    /// The map of a rig.
    pub fn new(rig: &Rig) -> Self {
        Self::of(
            &rig.interrogator,
            rig.interrogator
                .whiskers()
                .first()
                .copied()
                .unwrap_or_default(),
        )
    }

    /// The map of a whisker's gratings.
    pub fn of(interrogator: &InterrogatorRig, whisker: &str) -> Self {
        let find = |name: &str| {
            // A rig counts channels from 1, a scan's lists from 0.
            let g = interrogator.grating_of(whisker, name)?;
            Some((g.channel - 1, g.nominal_nm, g.window_nm))
        };
        Self {
            gratings: [find("fbg_ref"), find("fbg_1"), find("fbg_2")],
        }
    }

    /// Assigns the peaks of a scan: nearest to the nominal wavelength, inside the window.
    pub fn assign(&self, reading: &FbgReading) -> Assigned {
        let mut found = [None; 3];
        let mut crossing = false;
        for (slot, grating) in found.iter_mut().zip(&self.gratings) {
            let Some((channel, nominal, window)) = grating else {
                continue;
            };
            let peaks = reading
                .peaks_nm
                .get(*channel)
                .map_or(&[][..], Vec::as_slice);
            let inside = || {
                peaks
                    .iter()
                    .copied()
                    .filter(|nm| (nm - nominal).abs() <= *window)
            };
            *slot = inside().min_by(|a, b| (a - nominal).abs().total_cmp(&(b - nominal).abs()));
            // A second peak in the window: a neighbour has strayed into it.
            crossing |= inside().nth(1).is_some();
        }
        // On one fibre two peaks this close merge, and neither wavelength can be trusted.
        for a in 0..3 {
            for b in 0..a {
                let same = self.gratings[a]
                    .zip(self.gratings[b])
                    .is_some_and(|(x, y)| x.0 == y.0);
                let close = found[a]
                    .zip(found[b])
                    .is_some_and(|(x, y): (f64, f64)| (x - y).abs() < SEPARATION_NM);
                crossing |= same && close;
            }
        }
        Assigned {
            reference_nm: found[0],
            sensing_nm: [found[1], found[2]],
            crossing,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> ChannelMap {
        ChannelMap::new(&Rig::parse("r", super::super::rig::tests::RIG).unwrap())
    }

    fn scan(peaks: &[f64]) -> FbgReading {
        FbgReading {
            peaks_nm: vec![peaks.to_vec()],
            ..FbgReading::default()
        }
    }

    #[test]
    fn peaks_go_to_their_gratings_wherever_they_stand_in_the_list() {
        let assigned = map().assign(&scan(&[1535.9, 1537.31, 1541.0]));
        assert_eq!(assigned.reference_nm, Some(1537.31));
        assert_eq!(assigned.usable(), Some([1541.0, 1535.9]));
    }

    #[test]
    fn a_lost_peak_is_missing_and_never_replaced_by_a_neighbour() {
        assert_eq!(
            map().assign(&scan(&[1535.9, 1537.31])).sensing_nm,
            [None, Some(1535.9)]
        );
        assert_eq!(map().assign(&scan(&[])).usable(), None);
        assert_eq!(map().assign(&scan(&[1530.0, 1541.0])).sensing_nm[1], None);
    }

    #[test]
    fn crossing_gratings_are_seen() {
        assert!(map().assign(&scan(&[1535.8, 1535.801, 1537.3])).crossing);
        assert!(
            map()
                .assign(&scan(&[1535.8, 1536.4, 1537.3, 1541.0]))
                .crossing
        );
        assert!(!map().assign(&scan(&[1535.8, 1537.3, 1541.0])).crossing);
    }
}
