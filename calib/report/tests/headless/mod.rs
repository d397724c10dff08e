//! Opens pages in headless Chromium and tells what it logged.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

/// Enough for a machine that is busy with other builds.
const PATIENCE: Duration = Duration::from_secs(120);
/// One browser at a time: several starve one another on two cores.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// What one visit showed.
pub(crate) struct Visit {
    /// The page after loading, as HTML.
    pub dom: String,
    /// Lines of the console.
    pub console: Vec<String>,
}

/// The installed browser.
///
/// # Panics
/// Where there is none and `CI` is set: there the check must not be skipped.
pub(crate) fn browser() -> Option<PathBuf> {
    let names = [
        "chromium",
        "chromium-browser",
        "google-chrome",
        "google-chrome-stable",
    ];
    let path = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&path)
        .flat_map(|dir| names.map(|name| dir.join(name)))
        .find(|p| p.is_file());
    if found.is_none() {
        super::not_run::not_run("no Chromium is installed to open the report in");
    }
    found
}

/// Loads a page `width` CSS pixels wide. A browser that never starts gets two more chances with a
/// fresh profile.
pub(crate) fn visit(browser: &Path, page: &Path, width: u32) -> Visit {
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let mut log = String::new();
    for _ in 0..3 {
        match try_visit(browser, page, width) {
            Ok(visit) => return visit,
            Err(said) => log = said,
        }
    }
    panic!(
        "Chromium gave no page for {} within {PATIENCE:?}, three times:\n{log}",
        page.display()
    );
}

/// One try; the error is what the browser logged.
fn try_visit(browser: &Path, page: &Path, width: u32) -> Result<Visit, String> {
    let profile = tempfile::tempdir().unwrap();
    let (dom_path, log_path) = (
        profile.path().join("dom.html"),
        profile.path().join("log.txt"),
    );
    let mut child = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--no-first-run",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ])
        .args(["--enable-logging=stderr", "--v=0", "--dump-dom"])
        .arg(format!("--window-size={width},900"))
        .arg(format!(
            "--user-data-dir={}",
            profile.path().join("profile").display()
        ))
        .arg(format!("file://{}", page.canonicalize().unwrap().display()))
        .stdin(Stdio::null())
        .stdout(fs::File::create(&dom_path).unwrap())
        .stderr(fs::File::create(&log_path).unwrap())
        .spawn()
        .unwrap();
    let read =
        |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap_or_default()).into_owned();
    let start = Instant::now();
    // Chromium at times writes the page and then does not end: what counts is the page.
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > PATIENCE || read(&dom_path).trim_end().ends_with("</html>") {
            thread::sleep(Duration::from_millis(500));
            let _ = child.kill();
            break;
        }
        thread::sleep(Duration::from_millis(100));
    }
    child.wait().unwrap();
    let (dom, log) = (read(&dom_path), read(&log_path));
    if !dom.trim_end().ends_with("</html>") {
        return Err(log);
    }
    let console = log
        .lines()
        .filter(|line| line.contains("CONSOLE"))
        .map(str::to_owned)
        .collect();
    Ok(Visit { dom, console })
}

/// Writes a copy of `page` that measures its own layout and loads it in a frame `width` CSS pixels
/// wide.
///
/// The result is how far the content reaches, CSS pixels. A frame is used since the browser's
/// window has a least width.
pub(crate) fn content_width(browser: &Path, page: &str, width: u32) -> u32 {
    let folder = tempfile::tempdir().unwrap();
    let measure =
        "<script>parent.postMessage(document.documentElement.scrollWidth, '*')</script></body>";
    fs::write(
        folder.path().join("inner.html"),
        page.replace("</body>", measure),
    )
    .unwrap();
    let outer = format!(
        "<!DOCTYPE html><html><body><script>addEventListener('message', e => document.body.dataset.reach = e.data)</script><iframe src=\"inner.html\" style=\"width:{width}px;height:900px;border:0\"></iframe></body></html>"
    );
    let outer_path = folder.path().join("outer.html");
    fs::write(&outer_path, outer).unwrap();
    let dom = visit(browser, &outer_path, 1280).dom;
    let reach = dom
        .split("data-reach=\"")
        .nth(1)
        .and_then(|rest| rest.split('"').next());
    reach
        .and_then(|text| text.parse().ok())
        .unwrap_or_else(|| panic!("no measure came back:\n{dom}"))
}
