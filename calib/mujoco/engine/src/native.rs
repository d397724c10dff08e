//! Where the native libraries lie, and MuJoCo's own log.

use std::path::PathBuf;

/// Cable plugin, below [`folder`].
#[cfg(mujoco)]
pub const PLUGIN: &str = "mujoco/plugin/libelasticity.so";
/// CoACD, below [`folder`].
pub const COACD: &str = "coacd/coacd/lib_coacd.so";
/// Names the folder where it is not the one of the build.
const VARIABLE: &str = "WCAL_NATIVE";

/// Folder that `make setup` fills.
pub fn folder() -> PathBuf {
    std::env::var_os(VARIABLE).map_or_else(|| PathBuf::from(env!("WCAL_NATIVE_BUILT")), PathBuf::from)
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
