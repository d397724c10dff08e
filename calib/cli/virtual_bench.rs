//! `wcal virtual-bench`: serves the simulated devices until its input closes.

mod scene;

use anyhow::{Context, Result};
use clap::Args;
use scene::{BenchScene, REACH, ScenePath};
use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use wcal_bench::rod::Wire;
use wcal_bench::table::{Path as GroovePath, Table};
use wcal_drivers::bench::plant::{Plant, rest_arclength_mm};
use wcal_drivers::bench::scenario::Scenario;
use wcal_drivers::bench::scene::Scene;
use wcal_drivers::bench::{VirtualBench, faults};

/// Arguments of `wcal virtual-bench`.
#[derive(Debug, Args)]
#[command(
    after_help = "Prints one JSON line of addresses and runs until its input closes. Lines of input are faults: stall, reset,
unplug-stage, {\"kind\":\"lost-samples\",\"count\":50}, ... (firmware-notes/virtual-bench.md).
Exit code 0: good; 1: the scenario or a port cannot be used; 3: the bench fell behind its own clock (lower --speed)."
)]
pub(crate) struct VirtualBenchArgs {
    /// Scenario file
    #[arg(long, value_name = "S.toml")]
    pub scenario: PathBuf,
    /// Run this many times as fast as real time, instead of the scenario's `speed`
    #[arg(long)]
    pub speed: Option<f64>,
    /// Seed, instead of the scenario's
    #[arg(long)]
    pub seed: Option<u64>,
}

/// A scenario and the wire that it describes.
pub(crate) fn load(path: &Path) -> Result<(Scenario, Box<dyn Plant>)> {
    let place = path.display();
    let text = wcal_core::files::read_text(path)?;
    let scenario = Scenario::parse(&text).map_err(|e| anyhow::anyhow!("{place}: {e}"))?;
    let plant = RodPlant::new(&scenario).with_context(|| format!("{place}: the wire"))?;
    Ok((scenario, Box::new(plant)))
}

/// Prints one JSON line of addresses, then obeys fault commands from its input until that closes.
/// Exit code 3: the bench fell behind.
///
/// # Errors
/// When the scenario cannot be used or a port cannot be opened.
pub(crate) fn run(arguments: &VirtualBenchArgs) -> Result<ExitCode> {
    let (mut scenario, plant) = load(&arguments.scenario)?;
    if let Some(speed) = arguments.speed {
        anyhow::ensure!(
            (1e-3..=1e6).contains(&speed),
            "--speed: expected a number between 0.001 and 1000000, found {speed}"
        );
        scenario.speed = speed;
    }
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    let bench = VirtualBench::start(scenario, plant).context("opening the ports of the bench")?;
    println!("{}", serde_json::to_string(bench.addresses())?);
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line.trim().is_empty() {
            continue;
        }
        // A typing error must not end a running bench.
        match faults::parse(&line) {
            Ok(fault) => bench.inject(fault),
            Err(e) => eprintln!("virtual-bench: {e}"),
        }
    }
    // In the background its input is closed or empty from the start: the bench would be gone
    // without a word.
    if !std::io::stdin().is_terminal() {
        eprintln!(
            "virtual-bench: its input closed, so it ends; without a terminal keep its input open: sleep infinity | wcal virtual-bench ..."
        );
    }
    if let Some(behind_s) = bench.fell_behind_s() {
        let speed = bench.addresses().speed;
        eprintln!(
            "virtual-bench: warning: fell behind its clock by {behind_s:.1} s of bench time at {speed} times real time: \
             programs at it waited as long; use a lower speed"
        );
        return Ok(ExitCode::from(3));
    }
    Ok(ExitCode::SUCCESS)
}

/// Chebyshev points a piece of a table.
const NODES: usize = 14;

/// The examiner's large-deflection rod behind the virtual sensor: it shares no code with the
/// fitter.
struct RodPlant {
    tables: Vec<(u32, Table)>,
    scene: Arc<BenchScene>,
}

impl RodPlant {
    fn new(scenario: &Scenario) -> Result<Self> {
        let (w, effects) = (&scenario.whisker, &scenario.effects);
        let mut wire = Wire::new(
            w.diameter_mm,
            w.length_mm,
            w.straight_mm,
            w.arc_radius_mm,
            w.youngs_gpa,
            w.shear_gpa,
        );
        // A clamp that gives turns by this angle for each N mm of its moment, alike about y and z.
        wire.root_compliance = [effects.root_turn_rad_per_nmm; 2];
        let (mut tables, mut paths) = (Vec::new(), Vec::new());
        for t in scenario.trajectories() {
            let arclength_mm = rest_arclength_mm(w, t.origin_mm);
            let path = GroovePath {
                origin_mm: t.origin_mm.into(),
                direction: nalgebra::Vector3::from(t.direction).normalize(),
                arclength_mm,
                offset_mm: effects.groove_offset_mm.into(),
            };
            let table = Table::build(&wire, &path, REACH * arclength_mm, &[0.0], NODES)
                .with_context(|| format!("trajectory {}", t.id))?;
            paths.push(ScenePath {
                id: t.id,
                path,
                touch_mm: table.touch_mm(),
            });
            tables.push((t.id, table));
        }
        let scene = Arc::new(BenchScene::new(wire, w, paths, &scenario.cameras));
        Ok(Self { tables, scene })
    }
}

impl Plant for RodPlant {
    fn moment_nmm(&mut self, id: u32, depth_mm: f64) -> [f64; 2] {
        let table = self.tables.iter().find(|(t, _)| *t == id);
        table.map_or([0.0; 2], |(_, table)| {
            let [y, z, _] = table.at(depth_mm, 0.0);
            [y, z]
        })
    }

    fn scene(&self) -> Option<Arc<dyn Scene>> {
        Some(Arc::clone(&self.scene) as Arc<dyn Scene>)
    }
}
