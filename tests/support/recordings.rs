//! Recordings with numbers that the recorder does not write.

use std::path::Path;

/// Puts another number in the place of one in a recording, whose chunks then have no checksums.
///
/// # Panics
/// Where the number is not there.
pub(crate) fn with_number(recording: &Path, from: f64, to: f64) {
    let mut bytes = std::fs::read(recording).unwrap();
    // Behind the magic bytes.
    let mut at = 8;
    // A record: operation code, length, content. 6: a chunk, whose checksum is at 24; 2: the
    // footer.
    while bytes[at] != 2 {
        if bytes[at] == 6 {
            bytes[at + 9 + 24..at + 9 + 28].fill(0);
        }
        at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
    }
    let place = bytes
        .windows(8)
        .position(|b| b == from.to_le_bytes())
        .unwrap();
    bytes[place..place + 8].copy_from_slice(&to.to_le_bytes());
    std::fs::write(recording, bytes).unwrap();
}
