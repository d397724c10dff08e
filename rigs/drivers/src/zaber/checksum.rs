//! Checksum of Zaber's ASCII protocol: LRC of the bytes after the first, as two hex digits after a
//! colon.

/// LRC of `bytes` (without the leading `/`, `@`, `#` or `!`).
pub(crate) fn lrc(bytes: &[u8]) -> u8 {
    bytes
        .iter()
        .fold(0_u8, |sum, b| sum.wrapping_add(*b))
        .wrapping_neg()
}

#[cfg(test)]
mod tests {
    use super::lrc;

    #[test]
    fn sum_of_bytes_and_checksum_is_zero() {
        // Example of the protocol manual: /01 tools echo:... style packets sum to zero with their
        // LRC.
        for text in [&b"01 tools echo"[..], b"1 1 move abs 10234", b""] {
            let total = text.iter().fold(lrc(text), |sum, b| sum.wrapping_add(*b));
            assert_eq!(total, 0);
        }
        assert_ne!(lrc(b"1 1 move abs 10234"), lrc(b"1 1 move abs 10235"));
    }
}
