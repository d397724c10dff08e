//! Two cameras as one: frames of one trigger, their skew measured, pairs past a limit refused.

use std::time::Duration;
use wcal_core::device::{Camera, CameraFrame, DeviceError, DeviceErrorKind, DeviceIdentity};

/// A pair of one trigger.
#[derive(Debug, Clone, PartialEq)]
pub struct FramePair {
    /// First and second camera.
    pub frames: [CameraFrame; 2],
    /// Start of exposure of the second after the first, ms.
    pub skew_ms: f64,
}

/// A pair of cameras.
pub struct CameraPair {
    cameras: [Box<dyn Camera + Send>; 2],
    limit_ms: f64,
    refused: u64,
    last: Option<FramePair>,
    host_s: f64,
    /// Number of the second camera less that of the first for one trigger, once known.
    offset: Option<i128>,
}

/// Frames that one camera may be ahead of the other.
const AHEAD: usize = 32;

impl CameraPair {
    /// Two cameras and the largest skew, ms.
    pub fn new(cameras: [Box<dyn Camera + Send>; 2], limit_ms: f64) -> Self {
        Self {
            cameras,
            limit_ms,
            refused: 0,
            last: None,
            host_s: 0.0,
            offset: Some(0),
        }
    }

    /// Two cameras whose frames carry numbers of their own: the first pair closer in time than the
    /// limit sets the count.
    pub fn by_time(cameras: [Box<dyn Camera + Send>; 2], limit_ms: f64) -> Self {
        Self {
            offset: None,
            ..Self::new(cameras, limit_ms)
        }
    }

    /// Descriptions of both units.
    ///
    /// # Errors
    /// When a unit does not answer.
    pub fn identities(&mut self) -> Result<[DeviceIdentity; 2], DeviceError> {
        let [first, second] = &mut self.cameras;
        Ok([first.identity()?, second.identity()?])
    }

    /// Host time of the newest frame, s.
    pub fn host_s(&self) -> f64 {
        self.host_s
    }

    /// Pairs refused so far.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The next pair of one trigger.
    ///
    /// # Errors
    /// `DataInvalid` for a pair past the limit or a frozen camera; else what a camera reports.
    pub fn grab(&mut self, timeout: Duration) -> Result<FramePair, DeviceError> {
        let [first, second] = &mut self.cameras;
        let (mut a, mut b) = (first.grab(timeout)?, second.grab(timeout)?);
        for _ in 0..AHEAD {
            self.host_s = a.clocks.host_s.max(b.clocks.host_s);
            let ahead = match self.offset {
                Some(offset) => (i128::from(a.trigger) + offset) - i128::from(b.trigger),
                // From the first pair on numbers decide: a lost frame cannot pair two neighbours in
                // time.
                None if skew_ms(&a, &b).abs() <= self.limit_ms => {
                    self.offset = Some(i128::from(b.trigger) - i128::from(a.trigger));
                    0
                }
                None => -skew_ms(&a, &b).signum() as i128,
            };
            if ahead == 0 {
                return self.judge(a, b);
            }
            // A frozen camera sends its last picture again and again.
            if self
                .last
                .as_ref()
                .is_some_and(|l| l.frames[1].trigger == b.trigger)
            {
                return Err(self.refuse(
                    "a new picture of each camera",
                    "the second repeats its last",
                ));
            }
            let [first, second] = &mut self.cameras;
            if ahead < 0 {
                a = first.grab(timeout)?;
            } else {
                b = second.grab(timeout)?;
            }
        }
        let found = format!(
            "frames {} and {}, {:.1} ms apart",
            a.trigger,
            b.trigger,
            skew_ms(&a, &b)
        );
        Err(self.refuse("frames of one trigger", &found))
    }

    fn judge(&mut self, a: CameraFrame, b: CameraFrame) -> Result<FramePair, DeviceError> {
        // A frame truncated in transfer is a lost pair, not the end of a sweep.
        for (which, frame) in [("first", &a), ("second", &b)] {
            if let Some(found) = torn(frame) {
                let expected = format!("a whole picture of the {which} camera");
                return Err(
                    self.refuse(&expected, &format!("{found} at trigger {}", frame.trigger))
                );
            }
        }
        let skew_ms = skew_ms(&a, &b);
        // Two moments show two shapes of a wire that moves: such a pair has no depth.
        if skew_ms.abs() > self.limit_ms {
            let expected = format!("a skew of at most {} ms", self.limit_ms);
            return Err(self.refuse(
                &expected,
                &format!("{skew_ms:.3} ms at trigger {}", a.trigger),
            ));
        }
        let pair = FramePair {
            frames: [a, b],
            skew_ms,
        };
        self.last = Some(pair.clone());
        Ok(pair)
    }

    fn refuse(&mut self, expected: &str, found: &str) -> DeviceError {
        self.refused += 1;
        DeviceError::new(
            DeviceErrorKind::DataInvalid,
            "camera pair",
            "grab",
            expected,
            found,
        )
    }
}

/// Number of grey values of a frame that disagrees with its size.
fn torn(frame: &CameraFrame) -> Option<String> {
    let expected = u64::from(frame.width_px) * u64::from(frame.height_px);
    let found = frame.grey.len() as u64;
    (found != expected).then(|| {
        format!(
            "{found} grey values for {} x {} px",
            frame.width_px, frame.height_px
        )
    })
}

/// Start of exposure of `b` after that of `a`, ms.
fn skew_ms(a: &CameraFrame, b: &CameraFrame) -> f64 {
    let start = |f: &CameraFrame| f.clocks.device_s.unwrap_or(f.clocks.host_s);
    (start(b) - start(a)) * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;
    use wcal_core::device::Clocks;

    /// Frames by number and time, s.
    struct Script(std::vec::IntoIter<(u64, f64)>);

    /// A camera of 4 x 2 px that sends so many grey values.
    struct Torn(std::vec::IntoIter<usize>, u64);

    impl Camera for Torn {
        fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
            Ok(DeviceIdentity::default())
        }

        fn configure(&mut self, _: Option<f64>, _: Option<f64>) -> Result<(), DeviceError> {
            Ok(())
        }

        fn grab(&mut self, _: Duration) -> Result<CameraFrame, DeviceError> {
            self.1 += 1;
            let grey = vec![0; self.0.next().unwrap_or(8)];
            Ok(CameraFrame {
                trigger: self.1,
                width_px: 4,
                height_px: 2,
                grey,
                ..CameraFrame::default()
            })
        }
    }

    #[test]
    fn a_torn_frame_is_a_lost_pair_and_the_next_one_counts() {
        let camera =
            |counts: Vec<usize>| Box::new(Torn(counts.into_iter(), 0)) as Box<dyn Camera + Send>;
        let mut pair = CameraPair::new([camera(vec![8, 8, 8]), camera(vec![8, 7, 8])], 2.0);
        assert!(pair.grab(Duration::ZERO).is_ok());
        let error = pair.grab(Duration::ZERO).unwrap_err();
        assert_eq!(error.kind, DeviceErrorKind::DataInvalid);
        let text = error.to_string();
        assert!(
            text.contains("whole picture of the second camera")
                && text.contains("7 grey values for 4 x 2 px"),
            "{text}"
        );
        assert!(pair.grab(Duration::ZERO).is_ok() && pair.refused() == 1);
    }

    impl Camera for Script {
        fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
            Ok(DeviceIdentity::default())
        }

        fn configure(&mut self, _: Option<f64>, _: Option<f64>) -> Result<(), DeviceError> {
            Ok(())
        }

        fn grab(&mut self, _: Duration) -> Result<CameraFrame, DeviceError> {
            let end = || {
                DeviceError::new(
                    DeviceErrorKind::Disconnected,
                    "script",
                    "grab",
                    "a frame",
                    "the end",
                )
            };
            let (trigger, at_s) = self.0.next().ok_or_else(end)?;
            let clocks = Clocks {
                host_s: at_s,
                device_s: Some(at_s),
            };
            Ok(CameraFrame {
                trigger,
                clocks,
                ..CameraFrame::default()
            })
        }
    }

    fn pair(first: Vec<(u64, f64)>, second: Vec<(u64, f64)>) -> CameraPair {
        CameraPair::by_time(
            [
                Box::new(Script(first.into_iter())),
                Box::new(Script(second.into_iter())),
            ],
            2.0,
        )
    }

    #[test]
    fn numbers_of_their_own_are_paired_by_time_and_a_lost_frame_is_skipped() {
        // The second camera began two frames later and loses one.
        let first = (10..18).map(|k| (k, k as f64 * 0.1)).collect();
        let second = [0, 1, 3, 4, 5]
            .map(|k: u64| (k, (k + 12) as f64 * 0.1 + 0.0005))
            .to_vec();
        let mut pair = pair(first, second);
        for expected in [[12, 0], [13, 1], [15, 3], [16, 4]] {
            let got = pair.grab(Duration::ZERO).unwrap();
            assert_eq!(got.frames.map(|f| f.trigger), expected);
            assert!((got.skew_ms - 0.5).abs() < 1e-6);
        }
        assert_eq!(pair.refused(), 0);
    }

    #[test]
    fn numbers_as_large_as_a_camera_may_state_do_not_overflow() {
        let ends = vec![(u64::MAX, 0.0), (0, 0.1), (u64::MAX, 0.2)];
        let mut found = pair(ends.clone(), vec![(1, 0.0), (u64::MAX, 0.1), (3, 0.2)]);
        assert!(
            found.grab(Duration::ZERO).is_ok(),
            "the first pair sets the count"
        );
        assert!(
            found.grab(Duration::ZERO).is_err(),
            "the second has no partner"
        );
        // Negative control: the same numbers of both cameras are pairs.
        let mut same = pair(ends.clone(), ends);
        (0..3).for_each(|_| assert!(same.grab(Duration::ZERO).is_ok()));
    }

    #[test]
    fn cameras_without_a_common_trigger_are_refused() {
        let at = |shift: f64| {
            (0..100)
                .map(|k| (k, k as f64 * 0.1 + shift))
                .collect::<Vec<_>>()
        };
        let error = pair(at(0.0), at(0.05)).grab(Duration::ZERO).unwrap_err();
        assert_eq!(error.kind, DeviceErrorKind::DataInvalid);
        assert!(
            error.to_string().contains("frames of one trigger"),
            "{error}"
        );
    }
}
