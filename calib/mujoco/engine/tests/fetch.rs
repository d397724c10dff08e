//! `fetch.sh` keeps libraries whose SHA-256 it knows and no others. Wheels are made here: no
//! network is asked.

#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A repository of nothing but the script, and a `python3` that "downloads" what the test put into
/// `wheels/`.
struct Place(tempfile::TempDir);

/// In the place of the script's python3: `-m pip download ... --dest FOLDER` copies, the rest runs
/// as it is.
const PYTHON: &str = r#"#!/bin/sh
if [ "$1" = -m ]; then
  : >> asked
  while [ "$1" != --dest ]; do shift; done
  cp wheels/*.whl "$2"/
else
  exec REAL "$@"
fi
"#;

impl Place {
    /// The script expects the contents that `library` makes of a library's path.
    fn new(expected: impl Fn(&str) -> Vec<u8>) -> Self {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        let script =
            fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fetch.sh")).unwrap();
        let lines: Vec<String> = script
            .lines()
            .map(|line| match line.split_once("  native/") {
                Some((sum, path)) if sum.len() == 64 => {
                    format!("{}  native/{path}", sha256(&expected(path)))
                }
                _ => line.to_owned(),
            })
            .collect();
        fs::create_dir_all(at("calib/mujoco/engine")).unwrap();
        fs::write(at("calib/mujoco/engine/fetch.sh"), lines.join("\n") + "\n").unwrap();
        fs::create_dir_all(at("bin")).unwrap();
        fs::create_dir_all(at("wheels")).unwrap();
        let real = Command::new("sh")
            .args(["-c", "command -v python3"])
            .output()
            .unwrap();
        let python = PYTHON.replace("REAL", String::from_utf8_lossy(&real.stdout).trim());
        fs::write(at("bin/python3"), python).unwrap();
        assert!(
            Command::new("chmod")
                .arg("+x")
                .arg(at("bin/python3"))
                .status()
                .unwrap()
                .success()
        );
        Self(place)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Wheels with these libraries (path below native/, content).
    fn wheels(&self, libraries: &[(String, Vec<u8>)]) {
        let tree = self.path("tree");
        let _ = fs::remove_dir_all(&tree);
        for (wheel, part) in [("mujoco", "mujoco/"), ("coacd", "coacd/")] {
            let folder = tree.join(wheel);
            fs::create_dir_all(&folder).unwrap();
            for (path, content) in libraries.iter().filter(|(path, _)| path.starts_with(part)) {
                // What unpacks into native/coacd lies at the top of its wheel.
                let inside = if wheel == "coacd" {
                    path.strip_prefix("coacd/").unwrap()
                } else {
                    path
                };
                let file = folder.join(inside);
                fs::create_dir_all(file.parent().unwrap()).unwrap();
                fs::write(file, content).unwrap();
            }
            let to = self.path(&format!("wheels/{wheel}-1.whl"));
            let _ = fs::remove_file(&to);
            let zip = "import shutil,sys; shutil.move(shutil.make_archive(sys.argv[1], 'zip', sys.argv[2]), sys.argv[1])";
            let made = Command::new("python3")
                .args(["-c", zip])
                .args([&to, &folder])
                .status()
                .unwrap();
            assert!(made.success());
        }
    }

    fn run(&self) -> Output {
        let path = format!(
            "{}:{}",
            self.path("bin").display(),
            std::env::var("PATH").unwrap()
        );
        let script = self.path("calib/mujoco/engine/fetch.sh");
        Command::new("sh")
            .arg(script)
            .current_dir(self.0.path())
            .env("PATH", path)
            .output()
            .unwrap()
    }

    fn asked(&self) -> bool {
        fs::remove_file(self.path("asked")).is_ok()
    }
}

fn sha256(content: &[u8]) -> String {
    wcal_core::provenance::sha256_hex(content)
}

/// Paths below native/ that the script lists.
fn listed() -> Vec<String> {
    let script =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("fetch.sh")).unwrap();
    let path = |line: &str| {
        line.split_once("  native/")
            .filter(|(s, _)| s.len() == 64)
            .map(|l| l.1.to_owned())
    };
    script.lines().filter_map(path).collect()
}

fn content(path: &str) -> Vec<u8> {
    format!("library {path}").into_bytes()
}

#[test]
fn libraries_stay_where_every_one_is_as_listed_and_nowhere_else() {
    let good: Vec<(String, Vec<u8>)> = listed()
        .into_iter()
        .map(|p| (p.clone(), content(&p)))
        .collect();
    assert!(good.len() >= 7, "{good:?}");
    let place = Place::new(content);
    place.wheels(&good);
    let run = place.run();
    assert!(
        run.status.success() && place.asked(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let there = |place: &Place| {
        good.iter()
            .filter(|(p, _)| place.path("native").join(p).is_file())
            .count()
    };
    assert_eq!(there(&place), good.len());
    // A second run asks for nothing.
    assert!(place.run().status.success() && !place.asked());
    // One library after the other is changed in place: it is fetched anew.
    for (path, _) in &good {
        fs::write(place.path("native").join(path), "changed").unwrap();
        assert!(place.run().status.success() && place.asked(), "{path}");
        assert_eq!(
            fs::read(place.path("native").join(path)).unwrap(),
            content(path)
        );
    }
    // A library that is not listed makes the folder one to fetch anew, too.
    fs::write(place.path("native/mujoco/plugin/libmore.so"), "more").unwrap();
    assert!(place.run().status.success() && place.asked());
    assert!(!place.path("native/mujoco/plugin/libmore.so").exists());

    // Wheels with one wrong library, or one too many: an error that names it, and none stays.
    for (path, _) in &good {
        let wrong: Vec<_> = good
            .iter()
            .map(|(p, c)| {
                (
                    p.clone(),
                    if p == path {
                        b"other".to_vec()
                    } else {
                        c.clone()
                    },
                )
            })
            .collect();
        place.wheels(&wrong);
        fs::remove_dir_all(place.path("native")).unwrap_or_default();
        let run = place.run();
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(
            run.status.code() == Some(1) && said.contains(path.as_str()),
            "{path}: {said}"
        );
        assert!(!place.path("native").exists(), "{path}: nothing stays");
    }
    let more = [
        &good[..],
        &[("mujoco/plugin/libmore.so".to_owned(), content("more"))],
    ]
    .concat();
    place.wheels(&more);
    assert_eq!(place.run().status.code(), Some(1));
    assert!(!place.path("native").exists());
    // Without wheels, as without a network.
    fs::remove_dir_all(place.path("wheels")).unwrap();
    assert!(!place.run().status.success() && !place.path("native").exists());
}
