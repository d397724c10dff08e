//! An sm130 on TCP, written after the tables of docs/src/devices.md (firmware-notes/sm130.md) and
//! independent of the client.

use super::link::{Wire, sent_so_far};
use super::lock::guard;
use super::scenario::TokenPlace;
use super::world::{BenchState, Scan};
use std::io;
use std::net::TcpStream;
use std::time::Duration;

/// Counts per nm.
const GRANULARITY: f64 = 1e6;
const TOKEN: &[u8] = b"XXXXXXXX";

/// Answers one client until it is gone, the cable is pulled, or the bench ends.
///
/// # Errors
/// Why the link ended.
pub(crate) fn serve(shared: &BenchState, mut link: TcpStream) -> io::Result<()> {
    let mut line = Vec::new();
    let mut bytes = [0_u8; 512];
    let mut stream_from: Option<u64> = None;
    while shared.goes_on() && !guard(&shared.faults).interrogator_out {
        let count = match stream_from {
            Some(from) => {
                stream_from = Some(stream(shared, &mut link, from)?);
                sent_so_far(&mut link, &mut bytes)?
            }
            None => link.receive(&mut bytes)?,
        };
        line.extend_from_slice(&bytes[..count]);
        while let Some(end) = line.iter().position(|b| *b == b'\n') {
            let command = String::from_utf8_lossy(&line[..end]).trim().to_owned();
            line.drain(..=end);
            let reply = match command.as_str() {
                "#SET_STREAMING_DATA 1" => {
                    stream_from = Some(shared.next_serial());
                    framed(b"Streaming data enabled.\n")
                }
                "#SET_STREAMING_DATA 0" => {
                    stream_from = None;
                    [framed(b"Streaming data disabled.\n"), b"ZZZZZZZZ".to_vec()].concat()
                }
                other => answer(shared, other),
            };
            send(shared, &mut link, &reply)?;
        }
    }
    Ok(())
}

/// Sends the scans that are there; the number of the next one.
fn stream(shared: &BenchState, link: &mut TcpStream, from: u64) -> io::Result<u64> {
    // Held back only: the unit's buffer keeps the scans meanwhile.
    if shared.clock.now_s() < guard(&shared.faults).pause_until_s {
        std::thread::sleep(Duration::from_millis(5));
        return Ok(from);
    }
    let scans = shared.scans_from(from);
    let mut out = Vec::with_capacity(scans.len() * 128);
    for scan in &scans {
        if std::mem::take(&mut guard(&shared.faults).garbage) {
            out.extend_from_slice(b"\x00\x17XX0000\xfe99");
        }
        let payload = frame(shared, scan);
        // Two sources count the token in the stated length, a third does not.
        let inside = shared.scenario.interrogator.token == TokenPlace::Inside;
        let stated = payload.len() + if inside { TOKEN.len() } else { 0 };
        out.extend_from_slice(format!("{stated:010}").as_bytes());
        out.extend_from_slice(&payload);
        out.extend_from_slice(TOKEN);
    }
    send(shared, link, &out)?;
    Ok(scans.last().map_or(from, |s| s.serial + 1))
}

fn send(shared: &BenchState, link: &mut TcpStream, bytes: &[u8]) -> io::Result<()> {
    match shared.scenario.interrogator.split_bytes {
        0 => link.send(bytes),
        n => bytes.chunks(n).try_for_each(|part| link.send(part)),
    }
}

fn framed(payload: &[u8]) -> Vec<u8> {
    [format!("{:010}", payload.len()).as_bytes(), payload].concat()
}

fn answer(shared: &BenchState, command: &str) -> Vec<u8> {
    let text = match command.split_whitespace().next().unwrap_or_default() {
        "#GET_DATA" | "#GET_UNBUFFERED_DATA" => {
            return match shared.newest() {
                Some(scan) => framed(&frame(shared, &scan)),
                None => framed(b"No data.\n"),
            };
        }
        "#IDN?" => "sm130-700 virtual x30 core, firmware 3.0.1",
        "#GET_SN" => "VIR130",
        "#GET_CAPABILITIES" => &format!("FBG {} Hz", shared.scenario.interrogator.rate_hz),
        "#GET_NUM_DUT_CHANNELS" => "4",
        "#GET_DATA_RATE_DIVIDER"
        | "#GET_DATA_INTERLEAVE"
        | "#GET_NUM_AVERAGES"
        | "#GET_BUFFER_ENABLE" => "1",
        "#GET_BUFFER_COUNT" => "0",
        "#FLUSH_BUFFER" | "#SAVE_SETTINGS" => "Setting accepted.",
        name if name.starts_with("#SET_") => "Setting accepted.",
        // Rounded before it is split: microseconds stay below a million.
        _ => "Unknown command.",
    };
    framed(format!("{text}\n").as_bytes())
}

/// One data frame, field by field at its offset.
fn frame(shared: &BenchState, scan: &Scan) -> Vec<u8> {
    let peaks_nm = scan.peaks_nm.iter().flatten();
    // A peak without a value (NaN) becomes 0 counts, as units are assumed to send it (?).
    let mut counts: Vec<u32> = peaks_nm
        .map(|nm| (nm * GRANULARITY).round() as u32)
        .collect();
    counts.sort_unstable();
    let mut b = vec![0_u8; 88];
    let mut put = |at: usize, bytes: &[u8]| b[at..at + bytes.len()].copy_from_slice(bytes);
    let microseconds = (shared.device_s(scan.t_s) * 1e6).round() as u64;
    let h = scan.health;
    let bit = |on: bool, value: u8| if on { value } else { 0 };
    let flags = 0x20 | bit(h.calibration_fault, 0x40) | bit(h.fan_fault, 0x10);
    put(0, &[16, 0, 3, flags]);
    put(4, &12_345_u16.to_le_bytes());
    let light =
        bit(h.soa_thermal, 8) | bit(h.soa_current, 4) | bit(h.tec_over, 2) | bit(h.tec_under, 1);
    put(7, &[light]);
    // All gratings hang on channel 1: its count is that of all peaks.
    for at in [12, 16] {
        put(at, &(counts.len() as u16).to_le_bytes());
    }
    put(24, &(scan.serial as u16).to_le_bytes());
    put(28, &(scan.serial as u32).to_le_bytes());
    put(32, &((microseconds % 1_000_000) as u32).to_le_bytes());
    put(36, &((microseconds / 1_000_000) as u32).to_le_bytes());
    put(44, &(u32::from(h.error_code) << 24).to_le_bytes());
    put(48, &[h.buffer_percent, 1]);
    put(50, &88_u16.to_le_bytes());
    put(68, &1_u16.to_le_bytes());
    put(72, &(GRANULARITY as u32).to_le_bytes());
    put(80, &(1_510_000_000_u32).to_le_bytes());
    put(84, &(1_590_000_000_u32).to_le_bytes());
    b.extend(counts.iter().flat_map(|count| count.to_le_bytes()));
    b
}
