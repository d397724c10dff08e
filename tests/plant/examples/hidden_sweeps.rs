//! Writes hidden sweeps of foreign wires over ellipses and rounded boxes, one folder a seed, with
//! their truth (SIMULATED): `cargo run --example hidden_sweeps -- FIRST COUNT FOLDER`. The program
//! sees `session/`, `readings.csv`, `base.csv` and `object.stl`:
//!
//! ```text
//! wcal import readings.csv --kind sweep --motion base.csv --object object.stl --object-pose 0,0,0,1,0,0,0 --out sweep
//! wcal verify session --sweep sweep --out verify
//! wcal track sweep --calibration verify/calibration.json --out track.csv
//! ```
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use std::error::Error;
use std::path::Path;
use wcal_plant::sweep::SweepCase;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [first, count, folder] = &words[..] else {
        return Err(format!("expected FIRST COUNT FOLDER, found {words:?}").into());
    };
    let number = |text: &str| text.parse::<u64>().map_err(|e| format!("{text:?}: {e}"));
    let first = number(first)?;
    for seed in first..first + number(count)? {
        let place = Path::new(folder).join(seed.to_string());
        std::fs::create_dir_all(&place)?;
        SweepCase::draw(seed)?.write(&place)?;
        println!("{}", place.display());
    }
    Ok(())
}
