//! Where a result of the picture commands came from.

use crate::simulated::is_simulated;
use std::path::Path;
use wcal_core::{InputFile, Provenance};

/// Program, command line, time, the hashes of the files read, and whether one of them is simulated.
/// A file that cannot be read is rejected elsewhere, with its reason.
pub fn provenance<'a>(files: impl IntoIterator<Item = &'a Path>) -> Provenance {
    let files: Vec<&Path> = files.into_iter().collect();
    let hash = |path: &Path| {
        let bytes = wcal_core::files::read(path).ok()?;
        Some(InputFile {
            purpose: wcal_core::Purpose::Description,
            path: path.display().to_string(),
            sha256: wcal_core::provenance::sha256_hex(&bytes),
        })
    };
    Provenance {
        program: concat!("wcal ", env!("CARGO_PKG_VERSION")).into(),
        command: crate::kept::command(),
        created: jiff::Timestamp::now().to_string(),
        seed: 0,
        simulated: files.iter().any(|path| is_simulated(path)),
        inputs: files.into_iter().filter_map(hash).collect(),
    }
}
