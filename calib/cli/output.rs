//! Where a result goes: one rule for every `--out`.
//!
//! - What does not exist, or is empty, is made.
//! - What the same command wrote before of the same session is replaced whole: a file that the new
//!   result does not have does not stay.
//! - Anything else is refused, before anything is computed. With `--force` the result is written
//!   there all the same: files of the result's names are replaced, files of other names stay.
//!
//! A result is collected in memory and reaches the disk when it is complete. Every file goes into a
//! hidden folder inside the output folder first; then the earlier files go, the command's document
//! first, and the new ones are renamed into their places, the document last: where the document
//! lies, the whole result does. The output folder itself stays the same one, so that a shell inside
//! it, or a mount, is not cut off. Commands that go on where they stopped write in place and use
//! the check alone ([`ResultKind::check`]).

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use std::fs;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use wcal_core::files::{
    HALF_WRITTEN, folder_of, hold, remove_abandoned, sync_folder, write_atomic,
};
use wcal_core::text::brief;

/// Consent to write where something else is.
#[derive(Clone, Copy, Debug, Args)]
pub struct Overwrite {
    /// Write to --out although something else is there
    ///
    /// Files of the result's names are replaced, files of other names stay.
    #[arg(long)]
    pub force: bool,
}

/// How an earlier result of a command is distinguished from other files. In names one `*` stands
/// for any text.
#[derive(Debug, Clone, Copy)]
pub struct ResultKind<'a> {
    /// Name of the command.
    pub command: &'a str,
    /// Name of the document that makes a folder a result.
    pub document: &'a str,
    /// What the document contains.
    pub format_prefix: &'a str,
    /// Names of the other files.
    pub files: &'a [&'a str],
    /// Names that belong to the result and are never removed.
    pub kept: &'a [&'a str],
    /// The command goes on where it stopped: files without a document are its own, too.
    pub resumes: bool,
    /// What the result in a folder was made of, where it says so: a session, or tables. Pictures
    /// name no session, and a dataset's own recipe is compared.
    pub made_of: fn(&Path) -> Option<String>,
}

/// A text of a JSON document in a folder.
pub fn text_of(folder: &Path, document: &str, key: &str) -> Option<String> {
    let text = wcal_core::files::read_text(folder.join(document)).ok()?;
    Some(
        wcal_core::document::json(&text).ok()?[key]
            .as_str()?
            .to_owned(),
    )
}

impl<'a> ResultKind<'a> {
    /// A document with a format, and other files.
    pub const fn new(
        command: &'a str,
        document: &'a str,
        format_prefix: &'a str,
        files: &'a [&'a str],
    ) -> Self {
        Self {
            command,
            document,
            format_prefix,
            files,
            kept: &[],
            resumes: false,
            made_of: |_| None,
        }
    }

    /// Refuses what is neither new, nor empty, nor an earlier result.
    ///
    /// # Errors
    /// Where something else is there without `force`, or nothing can be written.
    pub fn check(&self, folder: &Path, force: bool) -> Result<()> {
        match fs::metadata(folder) {
            Err(e) if e.kind() == ErrorKind::NotFound => {}
            Err(e) => return Err(e).with_context(|| format!("--out {}", folder.display())),
            Ok(about) => {
                ensure!(
                    about.is_dir(),
                    "--out {}: expected a folder, found a file",
                    folder.display()
                );
                if let Some(name) = self.foreign(folder)?.filter(|_| !force) {
                    bail!(
                        "--out {}: expected a new folder or an earlier result of `wcal {}`, found {name}; choose another folder, or write \
                         there all the same with --force",
                        folder.display(),
                        self.command
                    );
                }
            }
        }
        writable(folder)
    }

    /// The first entry that is not of an earlier result.
    fn foreign(&self, folder: &Path) -> Result<Option<String>> {
        // Names such as report.html are anybody's: without the document they are foreign.
        let (mut recognised, mut others) = (false, None);
        for name in entries(folder)? {
            if self.files.contains(&name.as_str()) {
                others.get_or_insert(name);
            } else if matches(self.document, &name) {
                let text = wcal_core::files::read_text(folder.join(&name)).unwrap_or_default();
                let own = text.contains(self.format_prefix);
                // A damaged document of a command that goes on is one that it makes again.
                if !own && (!self.resumes || text.contains("\"format\"")) {
                    return Ok(Some(name));
                }
                recognised |= own;
            } else if self.files.iter().any(|own| matches(own, &name)) {
                others.get_or_insert(name);
            } else if !self.kept.contains(&name.as_str()) {
                return Ok(Some(name));
            }
        }
        Ok(others.filter(|_| !recognised && !self.resumes))
    }

    /// Whether a file of this name is replaced with the result.
    fn owns(&self, name: &str) -> bool {
        matches(self.document, name) || self.files.iter().any(|own| matches(own, name))
    }
}

/// `pattern` with at most one `*`.
fn matches(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == name,
        Some((first, last)) => {
            name.len() >= first.len() + last.len()
                && name.starts_with(first)
                && name.ends_with(last)
        }
    }
}

/// Names in a folder, sorted; what a killed run left half-written is nobody's.
fn entries(folder: &Path) -> Result<Vec<String>> {
    let read = || -> std::io::Result<Vec<String>> {
        fs::read_dir(folder)?
            .map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()))
            .collect()
    };
    let mut names = read().with_context(|| format!("reading {}", folder.display()))?;
    names.retain(|name| !(name.starts_with(HALF_WRITTEN[0]) && name.ends_with(HALF_WRITTEN[1])));
    names.sort();
    Ok(names)
}

/// Says now, not after an hour, that nothing can be written there.
fn writable(path: &Path) -> Result<()> {
    // A folder that does not exist yet is made in the nearest one that does.
    let here = Path::new(".");
    let mut place = path;
    while !place.exists() && place != here {
        place = place
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(here);
    }
    // Permissions say less than a try: the disk may be full or read-only.
    let tried =
        tempfile::tempfile_in(place).with_context(|| format!("writing into {}", place.display()));
    tried.map(drop)
}

/// A result on its way into a folder.
pub struct OutputFolder<'a> {
    kind: &'a ResultKind<'a>,
    folder: PathBuf,
    force: bool,
    files: Vec<(String, Vec<u8>)>,
}

impl<'a> OutputFolder<'a> {
    /// Begins a result; nothing is written yet.
    ///
    /// # Errors
    /// See [`ResultKind::check`].
    pub fn open(kind: &'a ResultKind<'a>, folder: &Path, force: bool) -> Result<Self> {
        kind.check(folder, force)?;
        Ok(Self {
            kind,
            folder: folder.to_owned(),
            force,
            files: Vec::new(),
        })
    }

    /// Refuses to replace the result of something else than this one is made of.
    ///
    /// # Errors
    /// Where such a result is there without `force`.
    pub(crate) fn refuse_other(&self, own: &str) -> Result<()> {
        let earlier =
            (self.kind.made_of)(&self.folder).filter(|earlier| earlier != own && !self.force);
        if let Some(earlier) = earlier {
            bail!(
                "--out {}: expected a new folder or an earlier result of {}, found that of {}; choose another folder, or replace it with --force",
                self.folder.display(),
                brief(own),
                brief(&earlier)
            );
        }
        Ok(())
    }

    /// The folder that `--out` names.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Adds a file, in place of one of the same name.
    pub fn put(&mut self, name: &str, bytes: impl Into<Vec<u8>>) {
        debug_assert!(
            self.kind.owns(name),
            "{name} is not declared as a file of {}",
            self.kind.command
        );
        self.files.retain(|(known, _)| known != name);
        self.files.push((name.to_owned(), bytes.into()));
    }

    /// Brings the result into the folder in place of the earlier one.
    ///
    /// # Errors
    /// When the disk does not take it; before the first file is replaced in every case but a failed
    /// rename.
    pub fn finish(mut self) -> Result<()> {
        let folder = self.folder.as_path();
        let fail = |doing: &str| format!("{doing} {}", folder.display());
        fs::create_dir_all(folder).with_context(|| fail("creating"))?;
        remove_abandoned(folder);
        // Inside the folder itself: a rename must not leave the file system.
        let staging = tempfile::Builder::new()
            .prefix(HALF_WRITTEN[0])
            .suffix(HALF_WRITTEN[1])
            .tempdir_in(folder);
        let staging = staging.with_context(|| fail("writing into"))?;
        // Nobody else tidies it away while it is filled; without locks nobody tidies.
        let held = hold(staging.path());
        for (name, bytes) in &self.files {
            write_atomic(&staging.path().join(name), bytes)?;
        }
        let document = |name: &str| matches(self.kind.document, name);
        let mut old: Vec<String> = entries(folder)?
            .into_iter()
            .filter(|name| self.kind.owns(name))
            .collect();
        // Without its document a folder that is left half-replaced is not taken for a result.
        old.sort_by_key(|name| !document(name));
        for name in &old {
            fs::remove_file(folder.join(name))
                .with_context(|| format!("replacing {name} in {}", folder.display()))?;
        }
        self.files.sort_by_key(|(name, _)| document(name));
        for (name, _) in &self.files {
            fs::rename(staging.path().join(name), folder.join(name))
                .with_context(|| fail("writing into"))?;
        }
        drop(held);
        // With the folder the new names reach the disk.
        Ok(sync_folder(folder)?)
    }
}

/// Refuses a `--out FILE` that is neither new, nor empty, nor a table of the same command,
/// recognised by its first line.
///
/// # Errors
/// Where something else is there without `force`, or nothing can be written.
pub(crate) fn check_file(
    path: &Path,
    command: &str,
    own: impl Fn(&str) -> bool,
    force: bool,
) -> Result<()> {
    let shown = path.display();
    match fs::metadata(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => {}
        Err(e) => return Err(e).with_context(|| format!("--out {shown}")),
        Ok(about) if about.is_dir() => bail!("--out {shown}: expected a file, found a folder"),
        // A rename would put a file in the device's place.
        Ok(about) if !about.is_file() => {
            bail!("--out {shown}: expected a file, found a device or pipe")
        }
        Ok(about) => {
            ensure!(
                force || about.len() == 0 || own(&first_line(path)?),
                "--out {shown}: expected a new file or an earlier result of `wcal {command}`, found another file; choose another name, or \
                 replace it with --force"
            );
        }
    }
    writable(folder_of(path))
}

/// Refuses to write over files that stand beside a result's own name and are none of it.
///
/// # Errors
/// Where one is there without `force`.
pub(crate) fn check_beside(
    files: &[PathBuf],
    own: impl Fn(&str) -> bool,
    force: bool,
) -> Result<()> {
    for path in files.iter().filter(|path| !force && path.exists()) {
        ensure!(
            own(&start_of(path)?),
            "{}: expected no file of this name or an earlier result, found another file, which would be written over; choose another name \
             or move it away",
            path.display()
        );
    }
    Ok(())
}

/// First line of a file, in full where it is not longer than 4 kB.
///
/// # Errors
/// Where it cannot be read.
pub fn first_line(path: &Path) -> Result<String> {
    Ok(start_of(path)?
        .lines()
        .next()
        .unwrap_or_default()
        .to_owned())
}

/// The first 4 kB of a file.
fn start_of(path: &Path) -> Result<String> {
    let mut start = Vec::new();
    let read = wcal_core::files::open(path)?
        .take(4096)
        .read_to_end(&mut start);
    read.with_context(|| format!("reading {}", path.display()))?;
    Ok(String::from_utf8_lossy(&start).into_owned())
}

/// Writes a file whole; its folder is made where it is missing.
///
/// # Errors
/// When the disk does not take it.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<()> {
    if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    }
    Ok(write_atomic(path, bytes)?)
}

/// Refuses a folder that holds anything: measured data are never replaced.
///
/// # Errors
/// Where something is there.
pub(crate) fn check_new(folder: &Path, otherwise: &str) -> Result<()> {
    let found = match fs::metadata(folder) {
        Ok(about) if about.is_dir() => entries(folder)?.into_iter().next(),
        Ok(_) => Some("a file".to_owned()),
        Err(_) => None,
    };
    if let Some(found) = found {
        bail!(
            "--out {}: expected a new folder{otherwise}, found {found}",
            folder.display()
        );
    }
    writable(folder)
}

/// Holds a number of the command line between 1 and what a machine can do.
///
/// # Errors
/// Names the option.
pub fn within(option: &str, found: u64, most: u64) -> Result<()> {
    ensure!(
        (1..=most).contains(&found),
        "{option}: expected 1 or more and at most {most}, found {found}"
    );
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
    use super::*;

    const KIND: ResultKind<'_> = ResultKind {
        command: "verify",
        document: "verify.json",
        format_prefix: "wcal-verify/",
        files: &["calibration.json", "overlay-*.png"],
        kept: &["unsealed.json"],
        resumes: false,
        made_of: |folder| text_of(folder, "verify.json", "session"),
    };

    #[test]
    fn a_result_of_another_session_is_replaced_with_force_alone() {
        let place = tempfile::tempdir().unwrap();
        let write = |session: &str, force: bool| -> Result<()> {
            let mut out = OutputFolder::open(&KIND, place.path(), force)?;
            out.refuse_other(session)?;
            out.put(
                "verify.json",
                format!(r#"{{"format":"wcal-verify/1","session":"{session}"}}"#),
            );
            out.finish()
        };
        write("a", false).unwrap();
        write("a", false).unwrap();
        let why = write("b", false).unwrap_err().to_string();
        assert!(
            why.contains("result of b, found that of a") && why.contains("--force"),
            "{why}"
        );
        assert_eq!(
            text_of(place.path(), "verify.json", "session").as_deref(),
            Some("a")
        );
        write("b", true).unwrap();
        assert_eq!(
            text_of(place.path(), "verify.json", "session").as_deref(),
            Some("b")
        );
        // Negative control: a result from before it said so.
        fs::write(
            place.path().join("verify.json"),
            r#"{"format":"wcal-verify/1"}"#,
        )
        .unwrap();
        write("c", false).unwrap();
    }

    fn names(folder: &Path) -> Vec<String> {
        entries(folder).unwrap()
    }

    fn result(folder: &Path, files: &[&str]) -> Result<()> {
        let mut out = OutputFolder::open(&KIND, folder, false)?;
        files.iter().for_each(|name| out.put(name, *name));
        out.put("verify.json", r#"{"format":"wcal-verify/1"}"#);
        out.finish()
    }

    #[test]
    fn a_result_is_replaced_whole_and_the_record_survives() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("deep/out");
        result(&folder, &["calibration.json", "overlay-a.png"]).unwrap();
        fs::write(folder.join("unsealed.json"), "seen").unwrap();
        result(&folder, &["overlay-b.png"]).unwrap();
        assert_eq!(
            names(&folder),
            ["overlay-b.png", "unsealed.json", "verify.json"]
        );
        assert_eq!(fs::read(folder.join("unsealed.json")).unwrap(), b"seen");
        assert_eq!(
            fs::read_dir(&folder).unwrap().count(),
            3,
            "nothing hidden remains"
        );
    }

    #[test]
    fn anything_else_is_refused_and_survives_force() {
        for (name, text) in [
            ("notes.txt", "mine"),
            ("verify.json", r#"{"format":"other/1"}"#),
            ("calibration.json", "of another command"),
        ] {
            let place = tempfile::tempdir().unwrap();
            fs::write(place.path().join(name), text).unwrap();
            let why = result(place.path(), &[]).unwrap_err().to_string();
            assert!(
                why.contains(name) && why.contains("--force") && why.contains("wcal verify"),
                "{why}"
            );
            assert_eq!(fs::read_to_string(place.path().join(name)).unwrap(), text);
            let mut out = OutputFolder::open(&KIND, place.path(), true).unwrap();
            out.put("verify.json", "wcal-verify/1");
            out.finish().unwrap();
            assert_eq!(
                place.path().join("notes.txt").exists(),
                name == "notes.txt",
                "{name}"
            );
        }
        // Beside a result, too.
        let place = tempfile::tempdir().unwrap();
        result(place.path(), &[]).unwrap();
        fs::write(place.path().join("notes.txt"), "mine").unwrap();
        assert!(result(place.path(), &[]).is_err());
    }

    #[test]
    fn what_goes_on_takes_its_own_damaged_documents_and_no_others() {
        let kind = ResultKind {
            document: "*.json",
            format_prefix: "wcal-sweeps/",
            files: &["*.parquet"],
            resumes: true,
            ..KIND
        };
        let place = tempfile::tempdir().unwrap();
        let check = |name: &str, text: &str| {
            fs::write(place.path().join(name), text).unwrap();
            kind.check(place.path(), false)
        };
        check("can-0.sweeps.parquet", "").unwrap();
        check("can-0.json", r#"{"form"#).unwrap();
        check("can-1.json", r#"{"format":"wcal-sweeps/1"}"#).unwrap();
        assert!(check("calibration.json", r#"{"format":"wcal-calibration/1"}"#).is_err());
    }

    #[test]
    fn a_result_that_is_not_finished_changes_nothing() {
        let place = tempfile::tempdir().unwrap();
        result(place.path(), &["calibration.json"]).unwrap();
        let mut out = OutputFolder::open(&KIND, place.path(), false).unwrap();
        out.put("verify.json", "half");
        drop(out);
        assert_eq!(names(place.path()), ["calibration.json", "verify.json"]);
        assert!(
            fs::read_to_string(place.path().join("verify.json"))
                .unwrap()
                .contains("wcal-verify/1")
        );
    }

    #[test]
    fn files_are_told_by_their_first_line() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("t.csv");
        let check = |force| check_file(&path, "twin", |line| line == "point,branch", force);
        check(false).unwrap();
        fs::write(&path, "").unwrap();
        check(false).unwrap();
        fs::write(&path, "point,branch\n1,held\n").unwrap();
        check(false).unwrap();
        fs::write(&path, "point,moment\n1,2\n").unwrap();
        assert!(check(false).unwrap_err().to_string().contains("--force"));
        check(true).unwrap();
        assert!(
            check_file(place.path(), "twin", |_| true, true).is_err(),
            "a folder"
        );
        #[cfg(unix)]
        assert!(
            check_file(Path::new("/dev/null"), "twin", |_| true, true).is_err(),
            "a device"
        );
    }
}
