//! Serves a virtual bench from a scenario file until its input closes.
use std::io::{BufRead, Write};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("expected a scenario file")?;
    let scenario = wcal_drivers::bench::scenario::Scenario::parse(&std::fs::read_to_string(path)?)?;
    let bench = wcal_drivers::bench::VirtualBench::start(scenario, None)?;
    writeln!(std::io::stdout(), "{}", serde_json::to_string(bench.addresses())?)?;
    for line in std::io::stdin().lock().lines() {
        bench.inject(wcal_drivers::bench::faults::parse(&line?)?);
    }
    Ok(())
}
