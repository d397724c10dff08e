//! Links libmujoco where `make setup` has put it; without it the program is built all the same and
//! says so when it is asked.

use std::path::Path;

const LIBRARY: &str = "libmujoco.so.3.17.0";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(mujoco)");
    let native = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../native");
    let native = native.canonicalize().unwrap_or(native);
    println!("cargo::rustc-env=WCAL_NATIVE_BUILT={}", native.display());
    let folder = native.join("mujoco");
    println!("cargo::rerun-if-changed={}", folder.join(LIBRARY).display());
    if !folder.join(LIBRARY).is_file() {
        return without(&folder);
    }
    println!("cargo::rustc-cfg=mujoco");
    println!("cargo::rustc-link-arg=-L{}", folder.display());
    println!("cargo::rustc-link-arg=-l:{LIBRARY}");
    println!("cargo::rustc-link-arg=-Wl,-rpath,{}", folder.display());
}

fn without(folder: &Path) {
    println!(
        "cargo::warning=no {} here: wcal-mujoco is built without MuJoCo (`make setup` fetches it)",
        folder.join(LIBRARY).display()
    );
}
