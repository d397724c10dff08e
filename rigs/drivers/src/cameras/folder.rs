//! A folder of pictures as a camera: binary PGM (P5, 8 bit), in the order of the number in the
//! name.

use std::path::{Path, PathBuf};
use std::time::Duration;
use wcal_core::device::{
    Camera, CameraFrame, Clocks, DeviceError, DeviceErrorKind, DeviceIdentity,
};

/// Pictures of a folder, first to last.
#[derive(Debug)]
pub(crate) struct FolderCamera {
    folder: PathBuf,
    files: Vec<(u64, PathBuf)>,
    next: usize,
    period_s: f64,
}

impl FolderCamera {
    /// Opens a folder; picture `n` was taken at `n * period_s`.
    ///
    /// # Errors
    /// `Configuration` when there is no picture with a number in its name.
    pub(crate) fn open(folder: &Path, period_s: f64) -> Result<Self, DeviceError> {
        let fail = |found: String| {
            let kind = DeviceErrorKind::Configuration;
            error(folder, kind, "open", "numbered .pgm pictures", &found)
        };
        let entries = std::fs::read_dir(folder).map_err(|e| fail(e.to_string()))?;
        let mut files: Vec<(u64, PathBuf)> = entries
            .filter_map(|entry| {
                let path = entry.ok()?.path();
                let is_pgm = path.extension()?.eq_ignore_ascii_case("pgm");
                Some((number_in(path.file_stem()?.to_str()?)?, path)).filter(|_| is_pgm)
            })
            .collect();
        // By the number and not by the name, which would put 10 before 2.
        files.sort();
        if files.is_empty() {
            return Err(fail("none".to_owned()));
        }
        Ok(Self {
            folder: folder.to_owned(),
            files,
            next: 0,
            period_s,
        })
    }
}

fn error(
    place: &Path,
    kind: DeviceErrorKind,
    action: &str,
    expected: &str,
    found: &str,
) -> DeviceError {
    let device = format!("camera {}", place.display());
    DeviceError::new(kind, device, action, expected, found)
}

/// The last group of digits.
fn number_in(stem: &str) -> Option<u64> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |k| k + 1);
    stem[start..end].parse().ok()
}

impl Camera for FolderCamera {
    fn identity(&mut self) -> Result<DeviceIdentity, DeviceError> {
        Ok(DeviceIdentity {
            driver: "folder".to_owned(),
            model: format!("{} pictures", self.files.len()),
            ..DeviceIdentity::default()
        })
    }

    fn grab(&mut self, _timeout: Duration) -> Result<CameraFrame, DeviceError> {
        let Some((number, path)) = self.files.get(self.next) else {
            let (kind, place) = (DeviceErrorKind::Disconnected, &self.folder);
            return Err(error(place, kind, "grab", "a further picture", "the end"));
        };
        self.next += 1;
        let bad = |found: String| {
            let kind = DeviceErrorKind::Protocol;
            error(path, kind, "read", "a P5 picture", &found)
        };
        let bytes = wcal_core::files::read(path).map_err(|e| bad(e.source.to_string()))?;
        let (width_px, height_px, grey) = parse_pgm(&bytes).map_err(bad)?;
        // Pictures in a folder carry no time: number and stated rate give it.
        let taken_s = *number as f64 * self.period_s;
        Ok(CameraFrame {
            trigger: *number,
            width_px,
            height_px,
            grey,
            clocks: Clocks {
                host_s: taken_s,
                device_s: Some(taken_s),
            },
            ..CameraFrame::default()
        })
    }
}

/// Width, height and grey values of a binary PGM.
///
/// # Errors
/// What was found instead.
pub fn parse_pgm(bytes: &[u8]) -> Result<(u32, u32, Vec<u8>), String> {
    let mut at = 0;
    let mut token = || -> Result<&str, String> {
        loop {
            while bytes.get(at).is_some_and(u8::is_ascii_whitespace) {
                at += 1;
            }
            if bytes.get(at) != Some(&b'#') {
                break;
            }
            // The header of a PGM may hold comment lines.
            while bytes.get(at).is_some_and(|b| *b != b'\n') {
                at += 1;
            }
        }
        let start = at;
        while bytes.get(at).is_some_and(|b| !b.is_ascii_whitespace()) {
            at += 1;
        }
        std::str::from_utf8(&bytes[start..at])
            .map_err(|_| "bytes that are no text in the header".to_owned())
    };
    let magic = token()?.to_owned();
    if magic != "P5" {
        return Err(format!("magic {magic:?}"));
    }
    let mut number = || -> Result<u32, String> {
        let text = token()?;
        text.parse().map_err(|_| format!("{text:?} for a number"))
    };
    let (width, height, depth) = (number()?, number()?, number()?);
    if depth != 255 || width == 0 || height == 0 {
        return Err(format!("{width} x {height} with depth {depth}"));
    }
    let need = width as usize * height as usize;
    let data = bytes.get(at + 1..).unwrap_or_default();
    if data.len() != need {
        return Err(format!("{} bytes for {need} pixels", data.len()));
    }
    Ok((width, height, data.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_come_in_the_order_of_their_numbers() {
        let dir = tempfile::tempdir().unwrap();
        for n in [10, 2, 1] {
            std::fs::write(
                dir.path().join(format!("left{n}.pgm")),
                [&b"P5\n# c\n2 1\n255\n"[..], &[n, 7]].concat(),
            )
            .unwrap();
        }
        std::fs::write(dir.path().join("notes.txt"), "x").unwrap();
        let mut camera = FolderCamera::open(dir.path(), 0.1).unwrap();
        let triggers: Vec<u64> = std::iter::from_fn(|| camera.grab(Duration::ZERO).ok())
            .map(|f| f.trigger)
            .collect();
        assert_eq!(triggers, [1, 2, 10]);
        assert_eq!(
            camera.grab(Duration::ZERO).unwrap_err().kind,
            DeviceErrorKind::Disconnected
        );
        assert!(camera.configure(Some(5.0), None).is_err());
    }

    #[test]
    fn malformed_pictures_are_refused() {
        for bad in [
            &b""[..],
            b"P2\n1 1\n255\n0",
            b"P5\n2 2\n255\nabc",
            b"P5\n2 2\n65535\nabcdefgh",
            b"P5\n0 2\n255\n",
            b"P5\nx 2\n255\n",
            b"P5\n2 2\n255\nabcde",
        ] {
            assert!(parse_pgm(bad).is_err(), "{bad:?}");
        }
        assert_eq!(
            parse_pgm(b"P5 2 1 255\nab").unwrap(),
            (2, 1, b"ab".to_vec())
        );
    }
}
