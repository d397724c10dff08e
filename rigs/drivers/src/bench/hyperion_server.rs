//! A Hyperion on TCP: a port for commands, a port for streamed peaks.

use super::link::{Wire, sent_so_far};
use super::lock::guard;
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
    while shared.goes_on() && !guard(&shared.faults).interrogator_out {
        let count = match stream_from {
            Some(from) => {
                let scans = shared.scans_from(from);
                let records = scans.iter().map(|s| response(0, "", &record(shared, s)));
                link.send(&records.collect::<Vec<_>>().concat())?;
                stream_from = Some(scans.last().map_or(from, |s| s.serial + 1));
                sent_so_far(&mut link, &mut bytes)?
            }
            None => link.receive(&mut bytes)?,
        };
        pending.extend_from_slice(&bytes[..count]);
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
                    stream_from = Some(shared.next_serial());
                    response(0, "Peak data streaming enabled.", b"")
                }
                "#DisablePeakDataStreaming" => {
                    stream_from = None;
                    response(0, "Peak data streaming disabled.", b"")
                }
                "#GetPeaks" => match shared.newest() {
                    Some(scan) => response(0, "", &record(shared, &scan)),
                    None => response(1, "No data.", b""),
                },
                "#GetSerialNumber" => response(0, "VIR155", b""),
                "#GetInstrumentName" => response(0, "si155 virtual", b""),
                "#GetFirmwareVersion" => response(0, "12.13.1", b""),
                _ => response(1, "Unknown command.", b""),
            };
            link.send(&reply)?;
        }
    }
    Ok(())
}

fn response(status: u8, message: &str, content: &[u8]) -> Vec<u8> {
    let mut b = vec![status, 0];
    b.extend((message.len() as u16).to_le_bytes());
    b.extend((content.len() as u32).to_le_bytes());
    b.extend(message.as_bytes());
    b.extend(content);
    b
}

fn record(shared: &BenchState, scan: &Scan) -> Vec<u8> {
    let peaks = scan.ascending_nm();
    let device_s = shared.device_s(scan.t_s);
    let mut b = Vec::with_capacity(64);
    // Length of the header: 24 bytes, and two for each of four channels.
    b.extend(32_u16.to_le_bytes());
    b.extend([1, 0, 0, 0, 0, 0]);
    b.extend(scan.serial.to_le_bytes());
    b.extend((device_s as u32).to_le_bytes());
    b.extend((((device_s % 1.0) * 1e9) as u32).to_le_bytes());
    for count in [peaks.len() as u16, 0, 0, 0] {
        b.extend(count.to_le_bytes());
    }
    b.extend(peaks.into_iter().flat_map(f64::to_le_bytes));
    b
}
