//! The mark of simulated data: what a file says of itself or of its folder.

use std::path::Path;

/// A file of this name marks what lies in its folder and in the folders one level below.
const MARKER: &str = "SIMULATED";

/// Whether a file is marked as simulated: by itself (JSON of this program), by the session that it
/// belongs to, or by a file named SIMULATED in its folder or the one above.
pub(crate) fn is_simulated(path: &Path) -> bool {
    // A folder stands for what lies in it.
    let own = if path.is_dir() {
        path
    } else {
        path.parent().unwrap_or(Path::new(""))
    };
    let marked_folder = || {
        [Some(own), own.parent()]
            .into_iter()
            .flatten()
            .any(|folder| folder.join(MARKER).is_file())
    };
    let says_so = || {
        let json = path.extension().is_some_and(|e| e == "json");
        let document = json
            .then(|| wcal_core::files::read_text(path).ok())
            .flatten();
        let document = document.and_then(|text| wcal_core::document::json(&text).ok());
        let marks = |d: &serde_json::Value| {
            [&d["simulated"], &d["provenance"]["simulated"]].map(|v| v == true)
        };
        document.is_some_and(|d| marks(&d).contains(&true))
    };
    let in_session = || {
        let session = wcal_core::files::read_text(own.join("session.toml")).ok();
        let session = session.and_then(|text| text.parse::<toml::Table>().ok());
        session.is_some_and(|t| {
            t.get("provenance")
                .and_then(|p| p.get("simulated")?.as_bool())
                == Some(true)
        })
    };
    marked_folder() || says_so() || in_session()
}

/// Adds a last column that says so to a table made from simulated data.
pub(crate) fn mark_table(csv: &str, simulated: bool) -> String {
    if !simulated {
        return csv.to_owned();
    }
    let marked =
        |(k, line): (usize, &str)| format!("{line},{}\n", if k == 0 { "simulated" } else { "1" });
    csv.lines().enumerate().map(marked).collect()
}

/// What stands behind a name on the terminal.
pub(crate) fn word(simulated: bool) -> &'static str {
    if simulated { " (SIMULATED)" } else { "" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_marked_by_itself_its_session_or_its_folder_and_by_nothing_else() {
        let place = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = place.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, text).unwrap();
            path
        };
        let picture = write("scene/left/1.png", "");
        let (measured, other) = (
            write("a/stereo.json", "{\"provenance\":{}}"),
            write("b/points.csv", ""),
        );
        for path in [&picture, &measured, &other] {
            assert!(!is_simulated(path), "{}", path.display());
        }
        write("scene/SIMULATED", "");
        write("b/session.toml", "[provenance]\nsimulated = true\n");
        std::fs::write(&measured, "{\"provenance\":{\"simulated\":true}}").unwrap();
        for path in [&picture, &measured, &other, &place.path().join("b")] {
            assert!(is_simulated(path), "{}", path.display());
        }
    }

    #[test]
    fn a_table_of_simulated_data_says_so_in_every_row() {
        assert_eq!(
            mark_table("a,b\n1,2\n3,4\n", true),
            "a,b,simulated\n1,2,1\n3,4,1\n"
        );
        assert_eq!(mark_table("a,b\n1,2\n", false), "a,b\n1,2\n");
    }
}
