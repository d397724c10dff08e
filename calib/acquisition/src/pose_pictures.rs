//! The pictures of a session's settled poses, read back: which two belong to a row, and which of
//! them cannot be its pictures.
//!
//! `pictures.csv` has for every file its row, time of exposure (session time), session and SHA-256.
//! A picture was exposed while the stage stood at its row's pose: after it arrived there and before
//! it arrived at the next one.

use crate::error::AcquisitionError;
use crate::pictures::PICTURES;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use wcal_core::files::read_within;
use wcal_core::provenance::sha256_hex;

/// Largest file that is read, bytes: a table of some hundred thousand rows, or a picture.
const MAX_BYTES: u64 = 1 << 26;

/// The pair of a row.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PosePair {
    /// The row's `point`.
    pub point: i64,
    /// Pictures of the first and the second camera; none where there is none.
    pub files: [Option<PathBuf>; 2],
    /// Why they are not to be used.
    pub refused: Option<String>,
    /// The row states a groove: the wire is in it.
    pub loaded: bool,
}

/// Pairs of the rows of points.csv, or with `sealed` of holdout.csv, in order of their points; none
/// where the session has no pictures of them. `cameras`: names, first and second; `session`: its
/// identifier.
///
/// # Errors
/// When a table cannot be read or is no such table.
pub fn pose_pairs(
    folder: &Path,
    session: &str,
    cameras: [&str; 2],
    sealed: bool,
) -> Result<Vec<PosePair>, AcquisitionError> {
    let of = if sealed {
        folder.join(PICTURES).join("holdout")
    } else {
        folder.join(PICTURES)
    };
    let list = of.join("pictures.csv");
    if !list.exists() {
        return Ok(Vec::new());
    }
    // Both tables: the pose after a row may be one of the holdout.
    let mut stands: Vec<PoseDwell> = Vec::new();
    for (name, of_sealed) in [("points.csv", false), ("holdout.csv", true)] {
        if folder.join(name).exists() {
            stands.extend(read_stands(&folder.join(name), of_sealed)?);
        }
    }
    let mut pairs: BTreeMap<i64, PosePair> = BTreeMap::new();
    for line in table(&list, |l: &Line| (l.point, vec![l.t_s]))? {
        // The name follows from camera and point: no list can lead to a file elsewhere.
        let file = format!("{}/{:05}.png", line.camera, line.point);
        let Some(camera) = cameras
            .iter()
            .position(|name| *name == line.camera && line.file == file)
        else {
            let place = format!("{}: point {}", list.display(), line.point);
            let expected = format!(
                "a file CAMERA/PPPPP.png of {} or {}",
                cameras[0], cameras[1]
            );
            return Err(AcquisitionError::input(
                place,
                expected,
                format!("{} of {}", line.file, line.camera),
            ));
        };
        let stand = stands
            .iter()
            .find(|s| s.sealed == sealed && s.point == line.point);
        let pair = pairs.entry(line.point).or_insert_with(|| PosePair {
            point: line.point,
            loaded: stand.is_some_and(|s| s.loaded),
            ..PosePair::default()
        });
        let path = of.join(&file);
        let why = foreign(&line, session, &path)?.or_else(|| match stand {
            None => Some(format!("point {} is not in the table", line.point)),
            Some(stand) => ill_timed(&line, stand, &stands),
        });
        if let Some(why) = why {
            pair.refused.get_or_insert(format!("{file}: {why}"));
        }
        if path.exists() {
            pair.files[camera] = Some(path);
        }
    }
    Ok(pairs.into_values().collect())
}

/// When the stage stood at a row's pose, session time, s.
#[derive(Debug, Clone, Copy)]
struct PoseDwell {
    sealed: bool,
    point: i64,
    /// Arrival; none where the table has none.
    from_s: Option<f64>,
    loaded: bool,
}

/// A line of pictures.csv.
#[derive(Deserialize)]
struct Line {
    point: i64,
    camera: String,
    file: String,
    t_s: Option<f64>,
    session: Option<String>,
    sha256: Option<String>,
}

/// What is needed of a line of points.csv or holdout.csv.
#[derive(Deserialize)]
struct PointLine {
    point: i64,
    t_s: Option<f64>,
    dwell_s: Option<f64>,
    groove_x_mm: Option<f64>,
}

/// Why a file is not the picture that the session recorded.
fn foreign(line: &Line, session: &str, path: &Path) -> Result<Option<String>, AcquisitionError> {
    if let Some(other) = line.session.as_ref().filter(|s| *s != session) {
        return Ok(Some(format!(
            "a picture of session {other:?}, not of {session:?}"
        )));
    }
    let Some(expected) = line.sha256.as_ref().filter(|_| path.exists()) else {
        return Ok(None);
    };
    let same = sha256_hex(&read_within(path, MAX_BYTES)?) == *expected;
    Ok((!same).then(|| "not the picture that was recorded: its hash is another".to_owned()))
}

/// Why the stage cannot have stood at the row's pose when the picture was exposed.
fn ill_timed(line: &Line, stand: &PoseDwell, all: &[PoseDwell]) -> Option<String> {
    // A table without these times cannot contradict a picture.
    let (t_s, from_s) = (line.t_s?, stand.from_s?);
    let next_s = all
        .iter()
        .filter_map(|s| s.from_s)
        .filter(|s| *s > from_s)
        .fold(f64::INFINITY, f64::min);
    if (from_s..next_s).contains(&t_s) {
        return None;
    }
    let until = if next_s.is_finite() {
        format!(" to {next_s:.2}")
    } else {
        " on".to_owned()
    };
    Some(format!(
        "exposed at {t_s:.2} s, but the stage stood at this pose from {from_s:.2}{until} s: clocks that disagree, or another pose's picture"
    ))
}

/// The lines of a table by the names of its columns; `numbers`: a line's point, and what else must
/// be finite.
fn table<T: DeserializeOwned>(
    path: &Path,
    numbers: impl Fn(&T) -> (i64, Vec<Option<f64>>),
) -> Result<Vec<T>, AcquisitionError> {
    let place = path.display().to_string();
    let bytes = read_within(path, MAX_BYTES)?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .from_reader(bytes.as_slice());
    let wrong = |e: csv::Error| {
        AcquisitionError::input(&place, "a CSV table with these columns", e.to_string())
    };
    let lines: Vec<T> = reader
        .deserialize()
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    for (row, line) in lines.iter().enumerate() {
        let (point, others) = numbers(line);
        let at = || format!("{place}, line {}", row + 2);
        // Characters that a file's name may have.
        if !(0..100_000).contains(&point) {
            return Err(AcquisitionError::input(
                at(),
                "a point from 0 to 99999",
                point.to_string(),
            ));
        }
        if let Some(odd) = others.into_iter().flatten().find(|v| !v.is_finite()) {
            return Err(AcquisitionError::input(at(), "a number", odd.to_string()));
        }
    }
    Ok(lines)
}

fn read_stands(path: &Path, sealed: bool) -> Result<Vec<PoseDwell>, AcquisitionError> {
    let lines: Vec<PointLine> = table(path, |l: &PointLine| {
        (l.point, vec![l.t_s, l.dwell_s, l.groove_x_mm])
    })?;
    // `t_s` is the end of the averaging window, `dwell_s` the time since arrival.
    let stand = |l: PointLine| PoseDwell {
        sealed,
        point: l.point,
        from_s: l.t_s.zip(l.dwell_s).map(|(t, dwell)| t - dwell),
        loaded: l.groove_x_mm.is_some(),
    };
    Ok(lines.into_iter().map(stand).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINTS: &str = "point,role,t_s,dwell_s,groove_x_mm\n0,rest,5,2,\n1,calibration,10,3,18.0\n2,calibration,16,3,18.0\n";
    const HEAD: &str = "point,camera,file,t_s,host_t_s,exposure_s,session,sha256\n";

    /// A session with pictures of its three rows whose content is their name.
    fn session(change: impl Fn(&mut String)) -> tempfile::TempDir {
        let place = tempfile::tempdir().unwrap();
        std::fs::write(place.path().join("points.csv"), POINTS).unwrap();
        let mut table = HEAD.to_owned();
        for (point, t_s) in [(0, 4.2), (1, 9.5), (2, 15.5)] {
            for camera in ["left", "right"] {
                let file = format!("{camera}/{point:05}.png");
                let path = place.path().join("pictures").join(&file);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, &file).unwrap();
                table += &format!(
                    "{point},{camera},{file},{t_s},,0.005,a,{}\n",
                    sha256_hex(file.as_bytes())
                );
            }
        }
        change(&mut table);
        std::fs::write(place.path().join("pictures/pictures.csv"), table).unwrap();
        place
    }

    fn pairs(place: &tempfile::TempDir) -> Vec<PosePair> {
        pose_pairs(place.path(), "a", ["left", "right"], false).unwrap()
    }

    fn only_the_second_is_refused(place: &tempfile::TempDir, why: &str) {
        let found = pairs(place);
        let refused = found[1].refused.clone().unwrap_or_default();
        assert!(refused.contains(why), "{refused}");
        assert!(
            found[0].refused.is_none() && found[2].refused.is_none(),
            "{found:?}"
        );
    }

    #[test]
    fn pairs_come_with_their_points() {
        let place = session(|_| ());
        let found = pairs(&place);
        assert_eq!(
            found
                .iter()
                .map(|p| (p.point, p.loaded))
                .collect::<Vec<_>>(),
            [(0, false), (1, true), (2, true)]
        );
        assert!(
            found
                .iter()
                .all(|p| p.refused.is_none() && p.files.iter().all(Option::is_some)),
            "{found:?}"
        );
        // A session without pictures, and holdout pictures that are not there.
        assert!(
            pose_pairs(place.path(), "a", ["left", "right"], true)
                .unwrap()
                .is_empty()
        );
        // A table from before hashes and sessions were in it.
        let old = session(|table| {
            *table = table
                .lines()
                .map(|l| l.splitn(7, ',').take(6).collect::<Vec<_>>().join(",") + "\n")
                .collect()
        });
        assert!(pairs(&old).iter().all(|p| p.refused.is_none()));
    }

    #[test]
    fn pictures_of_another_time_session_or_content_are_refused_alone() {
        only_the_second_is_refused(
            &session(|t| *t = t.replace("9.5,", "29.5,")),
            "exposed at 29.50 s, but the stage stood",
        );
        only_the_second_is_refused(
            &session(|t| *t = t.replace("9.5,", "6.9,")),
            "exposed at 6.90 s",
        );
        let foreign =
            |t: &mut String| *t = t.replacen("00001.png,9.5,,0.005,a", "00001.png,9.5,,0.005,b", 1);
        only_the_second_is_refused(&session(foreign), "of session \"b\", not of \"a\"");
        let changed = session(|_| ());
        std::fs::write(changed.path().join("pictures/right/00001.png"), "another").unwrap();
        only_the_second_is_refused(&changed, "its hash is another");
        let unpaired = session(|_| ());
        std::fs::remove_file(unpaired.path().join("pictures/right/00001.png")).unwrap();
        let found = pairs(&unpaired);
        assert!(
            found[1].files[0].is_some() && found[1].files[1].is_none(),
            "{found:?}"
        );
    }

    #[test]
    fn tables_that_are_none_are_errors() {
        for (from, to) in [
            ("point,camera", "points,camera"),
            ("left/00001.png", "../00001.png"),
            ("left/00001.png", "left/00002.png"),
            ("1,left", "-1,left"),
            ("1,left", "1,middle"),
            ("9.5,", "nan,"),
            ("9.5,", "soon,"),
            ("a,", "a,b,c,"),
        ] {
            let place = session(|t| *t = t.replacen(from, to, 1));
            let error = pose_pairs(place.path(), "a", ["left", "right"], false)
                .unwrap_err()
                .to_string();
            assert!(
                error.contains("pictures.csv") && error.contains("expected"),
                "{from} {to}: {error}"
            );
        }
    }
}
