//! A Hyperion on TCP: a port for commands, a port for streamed peaks.

use super::link::Wire;
use super::world::{BenchState, Scan};
use crate::host::{u16_at, u32_at};
use std::io;
use std::net::TcpStream;

/// Answers one client on either port.
///
/// # Errors
/// Why the link ended.
pub(crate) fn serve(shared: &BenchState, mut link: TcpStream) -> io::Result<()> {
    let mut pending = Vec::new();
    let mut bytes = [0_u8; 512];
    let mut stream_from: Option<u64> = None;
    while shared.goes_on() && !shared.interrogator_cable.is_out() {
        if let Some(from) = stream_from {
            let scans = shared.scans_from(from);
            let out: Vec<u8> = scans
                .iter()
                .flat_map(|s| response("", &record(shared, s)))
                .collect();
            Wire::send(&mut link, &out)?;
            stream_from = Some(scans.last().map_or(from, |s| s.serial + 1));
            link.set_nonblocking(true)?;
            match io::Read::read(&mut link, &mut bytes) {
                Ok(0) => return Ok(()),
                Ok(count) => pending.extend_from_slice(&bytes[..count]),
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => {}
                Err(e) => return Err(e),
            }
            link.set_nonblocking(false)?;
        } else {
            let count = Wire::receive(&mut link, &mut bytes)?;
            pending.extend_from_slice(&bytes[..count]);
        }
        while pending.len() >= 8 {
            let command = usize::from(u16_at(&pending, 2));
            let arguments = u32_at(&pending, 4) as usize;
            let total = 8 + command + arguments;
            if pending.len() < total {
                break;
            }
            let name = String::from_utf8_lossy(&pending[8..8 + command]).into_owned();
            pending.drain(..total);
            let reply = match name.as_str() {
                "#EnablePeakDataStreaming" => {
                    stream_from = Some(shared.newest().map_or(0, |s| s.serial + 1));
                    response("Peak data streaming enabled.", b"")
                }
                "#DisablePeakDataStreaming" => {
                    stream_from = None;
                    response("Peak data streaming disabled.", b"")
                }
                "#GetPeaks" => match shared.newest() {
                    Some(scan) => response("", &record(shared, &scan)),
                    None => refusal("No data."),
                },
                "#GetSerialNumber" => response("VIR155", b""),
                "#GetInstrumentName" => response("si155 virtual", b""),
                "#GetFirmwareVersion" => response("12.13.1", b""),
                _ => refusal("Unknown command."),
            };
            Wire::send(&mut link, &reply)?;
        }
    }
    Ok(())
}

fn response(message: &str, content: &[u8]) -> Vec<u8> {
    let mut b = vec![0, 0];
    b.extend((message.len() as u16).to_le_bytes());
    b.extend((content.len() as u32).to_le_bytes());
    b.extend(message.as_bytes());
    b.extend(content);
    b
}

fn refusal(message: &str) -> Vec<u8> {
    let mut b = response(message, b"");
    b[0] = 1;
    b
}

fn record(shared: &BenchState, scan: &Scan) -> Vec<u8> {
    let mut peaks: Vec<f64> = scan.peaks_nm.iter().flatten().copied().collect();
    peaks.sort_by(f64::total_cmp);
    let device_s = shared.device_s(scan.t_s);
    let mut b = Vec::with_capacity(64);
    b.extend(32_u16.to_le_bytes());
    b.extend([1, 0, 0, 0, 0, 0]);
    b.extend(scan.serial.to_le_bytes());
    b.extend((device_s as u32).to_le_bytes());
    b.extend((((device_s % 1.0) * 1e9) as u32).to_le_bytes());
    for count in [peaks.len() as u16, 0, 0, 0] {
        b.extend(count.to_le_bytes());
    }
    for nm in peaks {
        b.extend(nm.to_le_bytes());
    }
    b
}
