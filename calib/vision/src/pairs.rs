//! Pairs the pictures of two folders (or `*` patterns) by the number in their names that varies, or
//! by the whole name where it is the same.

use crate::error::VisionError;
use crate::picture::Picture;
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use wcal_core::files::FileError;

/// The two files of a pair.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PairFiles {
    /// Name of the pair: the left file's name without extension.
    pub name: String,
    /// Left picture; none where it is missing.
    pub left: Option<PathBuf>,
    /// Right picture; none where it is missing.
    pub right: Option<PathBuf>,
    /// Row of the session's table that the pair shows; none outside a session.
    pub point: Option<i64>,
    /// Why the pair is not to be used, where that is known before the pictures are read.
    pub refused: Option<String>,
}

impl PairFiles {
    /// Both pictures, of these sizes where cameras are calibrated; the reason where they cannot be
    /// used.
    ///
    /// # Errors
    /// A sentence.
    pub(crate) fn read(&self, calibrated_px: Option<[usize; 2]>) -> Result<[Picture; 2], String> {
        if let Some(why) = &self.refused {
            return Err(why.clone());
        }
        let (Some(left), Some(right)) = (&self.left, &self.right) else {
            let side = if self.left.is_none() { "left" } else { "right" };
            return Err(format!("the {side} picture is missing"));
        };
        let read = |path: &PathBuf| {
            let picture = Picture::read(path).map_err(|e| e.to_string())?;
            let found @ [x, y] = [picture.width, picture.height];
            let [w, h] = calibrated_px.unwrap_or(found);
            let path = path.display();
            if found != [w, h] {
                return Err(format!(
                    "{path}: expected {w}x{h} px as calibrated, found {x}x{y}"
                ));
            }
            picture
                .unusable()
                .map_or(Ok(picture), |why| Err(format!("{path}: {why}")))
        };
        let pictures = [read(left)?, read(right)?];
        if pictures[0] == pictures[1] {
            return Err("the left and the right picture are the same".into());
        }
        Ok(pictures)
    }
}

/// Picture files of a folder or of a pattern such as `pictures/left*.jpg`, sorted by name.
///
/// # Errors
/// Where the folder cannot be read or holds no picture.
pub fn list_pictures(source: &str) -> Result<Vec<PathBuf>, VisionError> {
    let path = Path::new(source);
    let (folder, pattern) = if path.is_dir() {
        (path, "*".to_string())
    } else {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        (folder.unwrap_or(Path::new(".")), text(path.file_name()))
    };
    let io = FileError::of("listing", path);
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(&io)? {
        let file = entry.map_err(&io)?.path();
        let name = text(file.file_name());
        let extension = text(file.extension()).to_lowercase();
        // macOS writes a file beside each picture: `._NAME`.
        let hidden = name.starts_with('.') && !pattern.starts_with('.');
        let picture = [
            "png", "jpg", "jpeg", "bmp", "tif", "tiff", "pgm", "ppm", "pnm",
        ]
        .contains(&extension.as_str());
        if picture
            && !hidden
            && file.is_file()
            && matches_pattern(pattern.as_bytes(), name.as_bytes())
        {
            files.push(file);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(VisionError::content(
            source,
            "a folder or pattern with PNG or JPEG pictures",
            "no such picture",
        ));
    }
    Ok(files)
}

/// `*` stands for any run of characters, `?` for one. A mismatch goes back to the latest `*` alone,
/// which takes one character more: the time is that of pattern times name at most.
pub fn matches_pattern(pattern: &[u8], name: &[u8]) -> bool {
    let (mut p, mut n) = (0, 0);
    // Places in pattern and name after the latest star and what it stands for.
    let mut star = None;
    while n < name.len() {
        match pattern.get(p) {
            Some(b'*') => {
                p += 1;
                star = Some((p, n));
            }
            Some(c) if *c == b'?' || *c == name[n] => (p, n) = (p + 1, n + 1),
            _ => match &mut star {
                Some((after, taken)) => {
                    *taken += 1;
                    (p, n) = (*after, *taken);
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == b'*')
}

fn text(part: Option<&OsStr>) -> String {
    part.unwrap_or_default().to_string_lossy().into_owned()
}

fn stem(path: &Path) -> String {
    text(path.file_stem())
}

/// The numbers in a name, the last one first.
fn numbers(name: &str) -> Vec<u64> {
    name.rsplit(|c: char| !c.is_ascii_digit())
        .filter_map(|digits| digits.parse().ok())
        .collect()
}

/// Place of the number that tells the pairs, counted from a name's end: of those in which no two
/// files of a side agree (a camera's own number does not vary) the one with the most pairs; the
/// last one of these. None where there is no such place.
fn varying_place(sides: [&[PathBuf]; 2]) -> Option<usize> {
    let all = sides.map(|side| side.iter().map(|f| numbers(&stem(f))).collect::<Vec<_>>());
    let places = all.iter().flatten().map(Vec::len).max().unwrap_or(0);
    let pairs = |place: usize| -> Option<usize> {
        let side = |k: usize| -> Option<BTreeSet<u64>> {
            let found = all[k].iter().filter_map(|n| n.get(place).copied());
            let distinct: BTreeSet<u64> = found.clone().collect();
            (distinct.len() == found.count()).then_some(distinct)
        };
        Some(side(0)?.intersection(&side(1)?).count())
    };
    (0..places)
        .rev()
        .filter_map(|place| Some((pairs(place)?, place)))
        .max_by_key(|found| found.0)
        .map(|f| f.1)
}

/// Pairs two lists of files: equal names first, then equal numbers. Files without partner are kept,
/// with `None`.
///
/// # Errors
/// Where two files of one side carry the same number and no partner of the same name.
pub fn pair_files(left: &[PathBuf], right: &[PathBuf]) -> Result<Vec<PairFiles>, VisionError> {
    let same_name = left
        .iter()
        .any(|l| right.iter().any(|r| stem(l) == stem(r)));
    let place = varying_place([left, right]).unwrap_or(0);
    let key = |path: &PathBuf| -> (u64, String) {
        let name = stem(path);
        let numbers = numbers(&name);
        if same_name {
            return (numbers.first().copied().unwrap_or(0), name);
        }
        numbers
            .get(place)
            .map_or((0, name), |n| (*n, String::new()))
    };
    let mut pairs: BTreeMap<(u64, String), PairFiles> = BTreeMap::new();
    type Slot = fn(&mut PairFiles) -> &mut Option<PathBuf>;
    let sides: [(&[PathBuf], Slot); 2] = [(left, |p| &mut p.left), (right, |p| &mut p.right)];
    for (files, slot) in sides {
        for file in files {
            let entry = pairs.entry(key(file)).or_insert_with(|| PairFiles {
                name: stem(file),
                ..PairFiles::default()
            });
            if let Some(other) = slot(entry).replace(file.clone()) {
                return Err(VisionError::content(
                    file.display().to_string(),
                    "one file a number and side",
                    format!("the same number as {}", other.display()),
                ));
            }
        }
    }
    Ok(pairs.into_values().collect())
}
