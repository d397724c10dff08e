//! Serves the chain of units on a pseudo-terminal and on TCP.

use super::ascii;
use super::binary::{BinaryUnit, Message};
use super::link::{Wire, pour, reply};
use super::lock::guard;
use super::scenario::StageProtocol;
use super::world::BenchState;
use std::io;
use std::time::{Duration, Instant};

/// A message that stops for this long is forgotten, as the protocol manual has it (Message Format).
const FORGETS: Duration = Duration::from_millis(10);
/// A line longer than this is noise.
const MAX_LINE: usize = 512;

/// Answers until the peer is gone, the cable is pulled, or the bench ends.
///
/// # Errors
/// Why the link ended.
pub(crate) fn serve(shared: &BenchState, wire: &mut dyn Wire) -> io::Result<()> {
    match shared.scenario.stage.protocol {
        StageProtocol::Ascii => serve_ascii(shared, wire),
        StageProtocol::Binary => serve_binary(shared, wire),
    }
}

fn open(shared: &BenchState) -> bool {
    shared.goes_on() && !guard(&shared.faults).stage_out
}

fn serve_ascii(shared: &BenchState, wire: &mut dyn Wire) -> io::Result<()> {
    let mut line = Vec::new();
    let mut bytes = [0_u8; 256];
    let mut heard = false;
    while open(shared) {
        let count = wire.receive(&mut bytes)?;
        heard |= count > 0;
        // After the first word only: a pseudo-terminal without a client would fill up.
        if heard {
            pour(&shared.faults, wire, false)?;
        }
        let alerts: Vec<String> = {
            // The time is asked with the lock held: one from before it would put the units back.
            let mut world = shared.world();
            let t_s = shared.clock.now_s();
            let units = world.units.iter_mut();
            units.filter_map(|u| u.update(t_s)).collect()
        };
        for alert in alerts {
            wire.send(alert.as_bytes())?;
        }
        // At another speed of the line nothing is understood.
        if wrong_speed(shared, wire) {
            line.clear();
            continue;
        }
        for byte in &bytes[..count] {
            if *byte != b'\n' {
                line.push(*byte);
                continue;
            }
            let command = ascii::parse(&line);
            line.clear();
            let Some(command) = command else { continue };
            let replies: Vec<String> = {
                let mut world = shared.world();
                let t_s = shared.clock.now_s();
                let hearing = world.units.iter_mut().filter(|u| u.hears(&command, t_s));
                hearing.map(|u| u.execute(&command, t_s).concat()).collect()
            };
            for text in replies {
                reply(&shared.faults, wire, text.as_bytes())?;
            }
        }
        if line.len() > MAX_LINE {
            line.clear();
        }
    }
    Ok(())
}

fn serve_binary(shared: &BenchState, wire: &mut dyn Wire) -> io::Result<()> {
    let spec = &shared.scenario.stage.unit;
    // Firmware 5.13: its home status is a bit of the device mode.
    let mut face = BinaryUnit::new(1, spec.device_id, 513, spec.serial);
    let mut pending = Vec::new();
    let mut bytes = [0_u8; 256];
    let mut heard = false;
    let mut last = Instant::now();
    while open(shared) {
        let count = wire.receive(&mut bytes)?;
        if count > 0 {
            (heard, last) = (true, Instant::now());
        } else if last.elapsed() > FORGETS {
            pending.clear();
        }
        if heard {
            pour(&shared.faults, wire, true)?;
        }
        if wrong_speed(shared, wire) {
            pending.clear();
            continue;
        }
        pending.extend_from_slice(&bytes[..count]);
        let mut answers = Vec::new();
        {
            let mut world = shared.world();
            let t_s = shared.clock.now_s();
            let axis = &mut world.units[0].axis;
            answers.extend(face.update(axis, t_s));
            while let Some((six, rest)) = pending.split_first_chunk::<6>() {
                answers.extend(face.execute(axis, Message::from_bytes(*six), t_s));
                pending = rest.to_vec();
            }
        }
        for answer in answers {
            reply(&shared.faults, wire, &answer.bytes())?;
        }
    }
    Ok(())
}

fn wrong_speed(shared: &BenchState, wire: &dyn Wire) -> bool {
    let speeds = shared.scenario.stage.baud.zip(wire.baud());
    speeds.is_some_and(|(own, peer)| own != peer)
}
