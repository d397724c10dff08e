//! Two cameras that see the bench; frames over TCP (firmware-notes/cameras.md).

use super::link::{Wire, sent_so_far};
use super::lock::guard;
use super::scene::SceneState;
use super::world::BenchState;
use std::io;
use std::net::TcpStream;
use std::time::Duration;

/// First bytes of every frame.
pub(crate) const MAGIC: &[u8; 4] = b"WCAM";
/// Right exposure of the virtual cameras, ms.
const EXPOSURE_MS: f64 = 5.0;
/// Grey value where no scene is plugged in.
const GREY: u8 = 170;
/// Longest command, bytes.
const COMMAND_LIMIT: usize = 64;

/// Sends a picture a period until the client is gone. A camera that is late by more than a period
/// leaves frames out.
///
/// # Errors
/// Why the link ended.
pub(crate) fn serve(shared: &BenchState, mut link: TcpStream, index: usize) -> io::Result<()> {
    let spec = &shared.scenario.cameras;
    let period_s = 1.0 / spec.rate_hz;
    // Both cameras count the same periods of bench time: equal numbers are one trigger.
    let mut trigger = (shared.clock.now_s() / period_s).ceil() as u64;
    let mut frozen: Option<Vec<u8>> = None;
    let mut heard = Vec::new();
    while shared.goes_on() {
        let due_s = trigger as f64 * period_s;
        let now_s = shared.clock.now_s();
        if now_s < due_s {
            obey(shared, &mut link, &mut heard)?;
            // Short sleeps: a command for the board, and the end of the bench, are heard meanwhile.
            let wait = shared.clock.wall(due_s - now_s);
            std::thread::sleep(wait.min(Duration::from_millis(20)));
            continue;
        }
        let second = index == 1;
        let state = guard(&shared.faults).cameras;
        let late_s = if second { state.skew_ms * 1e-3 } else { 0.0 };
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(spec.size_px[0].to_le_bytes());
        bytes.extend(spec.size_px[1].to_le_bytes());
        bytes.extend(0_u32.to_le_bytes());
        bytes.extend(trigger.to_le_bytes());
        bytes.extend(shared.clock.epoch_s(due_s + late_s).to_le_bytes());
        bytes.extend((EXPOSURE_MS * state.exposure).to_le_bytes());
        bytes.extend(picture(shared, index, due_s, trigger));
        if second && state.frozen {
            // Its header as well: number and time are those of the last picture before.
            bytes = frozen.get_or_insert(bytes).clone();
        } else {
            frozen = None;
        }
        if second && state.lose > 0 {
            guard(&shared.faults).cameras.lose -= 1;
        } else {
            link.send(&bytes)?;
        }
        trigger = (trigger + 1).max((shared.clock.now_s() / period_s) as u64);
    }
    Ok(())
}

/// Executes the client's commands: lines `board K` (hold up the chessboard in attitude K) and
/// `board off`; others are ignored.
fn obey(shared: &BenchState, link: &mut TcpStream, heard: &mut Vec<u8>) -> io::Result<()> {
    let mut bytes = [0_u8; COMMAND_LIMIT];
    // Commands are executed as they arrive, without a reply.
    let count = sent_so_far(link, &mut bytes)?;
    for byte in &bytes[..count] {
        if *byte != b'\n' {
            heard.push(*byte);
            heard.truncate(COMMAND_LIMIT);
            continue;
        }
        let line = String::from_utf8_lossy(heard).into_owned();
        heard.clear();
        if let Some(view) = line.trim().strip_prefix("board ") {
            let view = view.trim();
            if view == "off" {
                shared.show_board(None);
            } else if let Ok(k) = view.parse() {
                shared.show_board(Some(k));
            }
        }
    }
    Ok(())
}

/// What a camera sees at `due_s`: whole pixels at rest, blocks of them while stage or mount move,
/// so that a bench in motion is not held up by its pictures.
fn picture(shared: &BenchState, index: usize, due_s: f64, trigger: u64) -> Vec<u8> {
    let spec = &shared.scenario.cameras;
    let [width, height] = spec.size_px;
    let Some(scene) = &shared.scene else {
        return vec![GREY; (width * height) as usize];
    };
    let state = guard(&shared.faults).cameras;
    let (trajectory, depth_mm, moving) = shared.world().camera_view(due_s, &shared.scenario);
    let seen = SceneState {
        trajectory,
        depth_mm,
        board: state.board,
        exposure: state.exposure,
        moved: state.moved,
    };
    let bin = if moving { spec.moving_binning } else { 1 };
    // New noise for each picture, and the same again from the same scenario.
    let seed =
        shared.scenario.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (2 * trigger + index as u64);
    let small = scene.picture(index, &seen, [width / bin, height / bin], seed);
    if bin == 1 {
        return small;
    }
    let (bin, width) = (bin as usize, width as usize);
    let wide = |row: &[u8]| {
        let line: Vec<u8> = row.iter().flat_map(|v| vec![*v; bin]).collect();
        line.repeat(bin)
    };
    small.chunks_exact(width / bin).flat_map(wide).collect()
}
