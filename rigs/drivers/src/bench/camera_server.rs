//! Two cameras that see the wire against a bright background; frames over TCP (firmware-notes/cameras.md).

use super::link::Wire;
use super::plant::rest_point;
use super::world::Shared;
use std::io;
use std::net::TcpStream;
use std::time::Duration;

/// First bytes of every frame.
pub const MAGIC: &[u8; 4] = b"WCAM";
/// Exposure of the virtual cameras, ms.
const EXPOSURE_MS: f64 = 5.0;
/// Scale of the picture, px/mm.
const SCALE: f64 = 4.0;
/// Half width of the drawn wire, px.
const HALF_WIDTH: f64 = 1.2;

/// Sends a picture a period until the client is gone.
///
/// # Errors
/// Why the link ended.
pub fn serve(shared: &Shared, mut link: TcpStream, index: usize) -> io::Result<()> {
    link.set_write_timeout(Some(Duration::from_secs(5)))?;
    let spec = &shared.scenario.cameras;
    let period_s = 1.0 / spec.rate_hz.max(1e-3);
    let mut trigger = (shared.clock.now_s() / period_s).ceil() as u64;
    let mut frozen: Option<Vec<u8>> = None;
    while !shared.stopping() {
        let due_s = trigger as f64 * period_s;
        let now_s = shared.clock.now_s();
        if now_s < due_s {
            std::thread::sleep(shared.clock.wall(due_s - now_s).min(Duration::from_millis(20)));
            continue;
        }
        let state = shared.camera_state();
        let second = index == 1;
        let late_s = if second { state.skew_ms * 1e-3 } else { 0.0 };
        let stage_mm = shared.world().units.first().map_or(0.0, |u| u.axis.at(due_s).0);
        let depth_mm = stage_mm - shared.scenario.stage.contact_mm();
        let mut bytes = Vec::new();
        bytes.extend(MAGIC);
        bytes.extend(spec.size_px[0].to_le_bytes());
        bytes.extend(spec.size_px[1].to_le_bytes());
        bytes.extend(0_u32.to_le_bytes());
        bytes.extend(trigger.to_le_bytes());
        bytes.extend(shared.clock.epoch_s(due_s + late_s).to_le_bytes());
        bytes.extend(EXPOSURE_MS.to_le_bytes());
        bytes.extend(picture(shared, depth_mm, index));
        if second && state.frozen {
            bytes = frozen.get_or_insert(bytes).clone();
        } else {
            frozen = None;
        }
        Wire::send(&mut link, &bytes)?;
        trigger += 1;
    }
    Ok(())
}

/// A dark wire on a bright ground, seen from the side (first camera) or from below (second).
fn picture(shared: &Shared, depth_mm: f64, index: usize) -> Vec<u8> {
    let [width, height] = shared.scenario.cameras.size_px;
    let wire = &shared.scenario.whisker;
    let mut grey = vec![220_u8; (width * height) as usize];
    let steps = (wire.length_mm * SCALE * 2.0) as usize;
    for k in 0..=steps {
        let s = wire.length_mm * k as f64 / steps as f64;
        let (p, _) = rest_point(wire, s);
        // Drawn deflection: the shape of an end-loaded cantilever, enough for a preview.
        let bend = depth_mm.max(0.0) * (s / wire.length_mm).powi(2);
        let side = if index == 0 { p[2] + bend } else { bend };
        let (x, y) = (20.0 + p[0] * SCALE, f64::from(height) * 0.3 - side * SCALE);
        for dy in -3..=3 {
            let row = y.round() + f64::from(dy);
            let dark = 180.0 * (-((row - y) / HALF_WIDTH).powi(2)).exp();
            if row >= 0.0 && row < f64::from(height) && x >= 0.0 && x < f64::from(width) {
                let at = row as usize * width as usize + x as usize;
                grey[at] = grey[at].min((220.0 - dark) as u8);
            }
        }
    }
    grey
}
