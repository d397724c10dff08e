//! Requests, responses and the peak record of Hyperion units, all little-endian.

use crate::host::{u16_at, u32_at};
use wcal_core::device::{Clocks, FbgReading, InterrogatorHealth};

/// Length of the header of a response.
const RESPONSE_HEADER: usize = 8;
/// Fixed part of the header of a peak record, before the counts.
const PEAK_HEADER: usize = 24;
/// Longest message or content accepted.
const MAX_LENGTH: usize = 16 << 20;

/// Bytes of a request: `#Command`, arguments, and whether the reply leaves out the message text.
pub fn request(command: &str, arguments: &[u8], terse: bool) -> Vec<u8> {
    let mut bytes = vec![u8::from(terse), 0];
    bytes.extend((command.len() as u16).to_le_bytes());
    bytes.extend((arguments.len() as u32).to_le_bytes());
    bytes.extend(command.as_bytes());
    bytes.extend(arguments);
    bytes
}

/// A response of the unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// 0 when good.
    pub status: u8,
    /// Text for people.
    pub message: String,
    /// Binary content.
    pub content: Vec<u8>,
}

/// The first response in `bytes` and its length; `None` until more bytes come.
///
/// # Errors
/// What was expected and found when the lengths are absurd.
pub fn response(bytes: &[u8]) -> Result<Option<(Response, usize)>, String> {
    if bytes.len() < RESPONSE_HEADER {
        return Ok(None);
    }
    let message = usize::from(u16_at(bytes, 2));
    let content = u32_at(bytes, 4) as usize;
    // A damaged length would make the reader wait for bytes that never come.
    if content > MAX_LENGTH {
        return Err(format!(
            "content of at most {MAX_LENGTH} bytes, found {content}"
        ));
    }
    let total = RESPONSE_HEADER + message + content;
    if bytes.len() < total {
        return Ok(None);
    }
    let text = &bytes[RESPONSE_HEADER..RESPONSE_HEADER + message];
    let response = Response {
        status: bytes[0],
        message: String::from_utf8_lossy(text).into_owned(),
        content: bytes[RESPONSE_HEADER + message..total].to_vec(),
    };
    Ok(Some((response, total)))
}

/// Decodes a peak record. A peak that is no wavelength (NaN) is kept: it belongs to no grating, and
/// its scan is marked.
///
/// # Errors
/// What was expected and what was found.
pub fn peaks(content: &[u8], host_s: f64) -> Result<FbgReading, String> {
    if content.len() < PEAK_HEADER {
        return Err(format!(
            "at least {PEAK_HEADER} bytes, found {}",
            content.len()
        ));
    }
    let header = usize::from(u16_at(content, 0));
    if header < PEAK_HEADER || header > content.len() || !(header - PEAK_HEADER).is_multiple_of(2) {
        return Err(format!(
            "a header length of {PEAK_HEADER} and two a channel, found {header}"
        ));
    }
    let serial = u64::from(u32_at(content, 8)) | u64::from(u32_at(content, 12)) << 32;
    let (seconds, nanoseconds) = (u32_at(content, 16), u32_at(content, 20));
    let counts: Vec<usize> = content[PEAK_HEADER..header]
        .chunks_exact(2)
        .map(|c| usize::from(u16_at(c, 0)))
        .collect();
    let total: usize = counts.iter().sum();
    // Counts that do not fit the length would give peaks to other channels.
    if content.len() != header + 8 * total {
        return Err(format!(
            "{} bytes for {total} peaks, found {}",
            header + 8 * total,
            content.len()
        ));
    }
    let mut values = content[header..]
        .chunks_exact(8)
        .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]));
    let peaks_nm: Vec<Vec<f64>> = counts
        .iter()
        .map(|n| values.by_ref().take(*n).collect())
        .collect();
    Ok(FbgReading {
        serial,
        peaks_nm,
        // No health bits come with a record (firmware-notes/hyperion.md).
        health: InterrogatorHealth::default(),
        clocks: Clocks {
            host_s,
            device_s: Some(f64::from(seconds) + f64::from(nanoseconds) * 1e-9),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Vec<u8> {
        let mut b = vec![32, 0, 0, 0, 0, 0, 0, 0];
        b.extend(77_u64.to_le_bytes());
        b.extend(10_u32.to_le_bytes());
        b.extend(250_000_000_u32.to_le_bytes());
        for n in [2_u16, 0, 1, 0] {
            b.extend(n.to_le_bytes());
        }
        for nm in [1535.5_f64, 1541.25, 1537.0] {
            b.extend(nm.to_le_bytes());
        }
        b
    }

    #[test]
    fn a_record_decodes() {
        let reading = peaks(&record(), 5.0).unwrap();
        assert_eq!((reading.serial, reading.clocks.device_s), (77, Some(10.25)));
        assert_eq!(
            reading.peaks_nm,
            [vec![1535.5, 1541.25], vec![], vec![1537.0], vec![]]
        );
    }

    #[test]
    fn malformed_records_are_refused() {
        assert!(peaks(&record()[..20], 0.0).is_err());
        assert!(peaks(&record()[..40], 0.0).is_err());
        for (at, value) in [(0, 31), (0, 2), (24, 9)] {
            let mut bad = record();
            bad[at] = value;
            assert!(peaks(&bad, 0.0).is_err(), "byte {at} = {value}");
        }
    }

    #[test]
    fn a_peak_that_is_no_number_costs_itself_alone() {
        let mut bad = record();
        bad[32..40].copy_from_slice(&f64::NAN.to_le_bytes());
        let reading = peaks(&bad, 0.0).unwrap();
        assert!(reading.peaks_nm[0][0].is_nan());
        assert_eq!(
            (reading.peaks_nm[0][1], &reading.peaks_nm[2]),
            (1541.25, &vec![1537.0])
        );
    }

    #[test]
    fn responses_come_whole_or_not_at_all() {
        let bytes = [&[0, 0, 2, 0, 3, 0, 0, 0][..], b"ok", b"abc", b"next"].concat();
        let (r, length) = response(&bytes).unwrap().unwrap();
        assert_eq!(
            (r.status, &*r.message, &*r.content, length),
            (0, "ok", &b"abc"[..], 13)
        );
        for cut in 0..13 {
            assert_eq!(response(&bytes[..cut]).unwrap(), None);
        }
        assert!(response(&[0, 0, 0, 0, 255, 255, 255, 255]).is_err());
        assert_eq!(request("#GetPeaks", b"", false)[..4], [0, 0, 9, 0]);
    }
}
