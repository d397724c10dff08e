//! Where the native libraries lie, whether they are the expected ones, and MuJoCo's own log.

use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Cable plugin, below [`folder`].
#[cfg(mujoco)]
pub const PLUGIN: &str = "mujoco/plugin/libelasticity.so";
/// MuJoCo, below [`folder`].
#[cfg(mujoco)]
const MUJOCO: &str = "mujoco/libmujoco.so.3.17.0";
/// CoACD, and what it loads itself, below [`folder`].
pub const COACD: &str = "coacd/coacd/lib_coacd.so";
pub const COACD_OPENMP: &str = "coacd/coacd.libs/libgomp-a34b3233.so.1.0.0";
/// Names the folder where it is neither the installed one nor that of the build.
const VARIABLE: &str = "WCAL_NATIVE";
/// Lists every library with its SHA-256, as `sha256sum` does.
const LIST: &str = include_str!("../fetch.sh");

/// Folder of the libraries: `lib/wcal` beside the `bin` of an installed program, else the one that
/// `make setup` fills.
fn folder() -> PathBuf {
    let installed = || {
        Some(
            std::env::current_exe()
                .ok()?
                .ancestors()
                .nth(2)?
                .join("lib/wcal"),
        )
    };
    std::env::var_os(VARIABLE)
        .map(PathBuf::from)
        .or_else(|| installed().filter(|folder| folder.is_dir()))
        .unwrap_or_else(|| PathBuf::from(env!("WCAL_NATIVE_BUILT")))
}

/// A library of the folder whose content is the listed one; nothing else of that folder is loaded.
///
/// # Errors
/// Where it is not there, or another one.
pub fn checked(name: &str) -> Result<PathBuf, String> {
    let path = folder().join(name);
    if !path.is_file() {
        return Err(format!(
            "expected {}, found none (`make setup` fetches it)",
            path.display()
        ));
    }
    compare(&path, name)?;
    Ok(path)
}

fn compare(path: &Path, name: &str) -> Result<(), String> {
    let listed = LIST.lines().find_map(|line| {
        let (sum, listed) = line.split_once("  native/")?;
        (sum.len() == 64 && listed == name).then_some(sum)
    });
    let expected =
        listed.ok_or_else(|| format!("{name}: expected a library of fetch.sh, found another"))?;
    let bytes = std::fs::read(path).map_err(|e| format!("reading {}: {e}", path.display()))?;
    let found: String = Sha256::digest(&bytes)
        .iter()
        .map(|b| format!("{b:02x}"))
        .collect();
    if found == expected {
        return Ok(());
    }
    Err(format!(
        "{}: expected the library of SHA-256 {expected}, found {found}: it is not loaded (`make setup` fetches it anew; {VARIABLE} names the folder)",
        path.display()
    ))
}

/// Compares the libmujoco that the system has loaded with this program. That happens before the
/// program's first line: what is compared is whether it is used.
///
/// # Errors
/// Where it is another one, or cannot be determined.
#[cfg(mujoco)]
pub fn loaded() -> Result<(), String> {
    let maps = std::fs::read_to_string("/proc/self/maps")
        .map_err(|e| format!("reading /proc/self/maps: {e}"))?;
    let paths = maps
        .lines()
        .filter_map(|line| Some(Path::new(&line[line.find('/')?..])));
    let own = |path: &&Path| {
        path.file_name()
            .is_some_and(|n| n.to_string_lossy().starts_with("libmujoco"))
    };
    let path = paths
        .into_iter()
        .find(own)
        .ok_or("expected libmujoco among the loaded libraries, found none")?;
    compare(path, MUJOCO)
}

#[cfg(not(mujoco))]
pub fn loaded() -> Result<(), String> {
    Ok(())
}

/// No MUJOCO_LOG.TXT in the user's folder and nothing between the lines of the protocol.
#[cfg(mujoco)]
pub fn quiet() {
    use mujoco_rs::wrappers::mj_logging::{log_config, set_log_config};
    let mut config = log_config();
    config.set_logto_file(false);
    config.set_logto_console(false);
    #[allow(unsafe_code)]
    // SAFETY: the first call of the program, before any thread or model.
    unsafe {
        set_log_config(config);
    }
}

#[cfg(not(mujoco))]
pub fn quiet() {}
