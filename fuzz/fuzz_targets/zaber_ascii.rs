//! Any line as a command to the virtual unit.
#![no_main]
use libfuzzer_sys::fuzz_target;
use wcal_drivers::bench::{ascii, unit::Unit};

fuzz_target!(|data: &[u8]| {
    let mut unit = Unit::new(1, Default::default());
    for (k, line) in data.split(|b| *b == b'\n').enumerate() {
        if let Some(command) = ascii::parse(line) {
            for packet in unit.execute(&command, k as f64) {
                assert!(packet.ends_with("\r\n"));
            }
        }
    }
});
