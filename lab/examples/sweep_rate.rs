//! Sweeps a second and core by the rod engine: `sweep_rate SWEEPS [STL ...]`; built-in objects
//! without files. Processor time of the thread is what counts; the last line is what the paper's
//! set (78 objects, 200 sweeps each) would take.
#![allow(clippy::print_stdout, reason = "an example talks to its user")]

use std::collections::BTreeMap;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::rod_engine::LINKS;
use wcal_lab_sweeps::{RodEngine, Sweep, SweepPlan, objects};
use wcal_mesh::Mesh;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let count: u64 = words
        .next()
        .ok_or("expected the number of sweeps an object")?
        .parse()?;
    let files: Vec<String> = words.collect();
    let meshes: Vec<Mesh> = if files.is_empty() {
        objects::NAMES
            .iter()
            .map(|n| objects::built_in(n))
            .collect::<Result<_, _>>()?
    } else {
        files
            .iter()
            .map(|f| Mesh::read(f.as_ref()))
            .collect::<Result<_, _>>()?
    };
    let whisker = WhiskerSpec::nominal();
    let (engine, plan) = (RodEngine::new(&whisker, LINKS)?, SweepPlan::default());
    let (mut sweeps, mut samples, mut solves, mut iterations) = (0, 0, 0, 0);
    let mut verdicts: BTreeMap<&str, u64> = BTreeMap::new();
    let begin_s = wcal_lab::dataset::thread_s();
    for mesh in &meshes {
        for index in 0..count {
            let Some(sweep) = Sweep::draw(mesh, &plan, 1, index, engine.reach_mm()) else {
                continue;
            };
            let run = engine.run(mesh, &sweep, &plan);
            sweeps += 1;
            (samples, solves, iterations) = (
                samples + run.samples.len(),
                solves + run.solves,
                iterations + run.iterations,
            );
            *verdicts.entry(run.verdict.name()).or_default() += 1;
        }
    }
    let seconds = wcal_lab::dataset::thread_s() - begin_s;
    println!(
        "{sweeps} sweeps in {seconds:.2} s: {:.2} a second and core; {verdicts:?}",
        f64::from(sweeps) / seconds
    );
    println!(
        "{samples} samples, {solves} equilibria, {iterations} Newton steps, {:.1} us a step",
        seconds * 1e6 / iterations as f64
    );
    let minutes = 15_600.0 * seconds / f64::from(sweeps) / 60.0;
    println!(
        "15,600 sweeps: {minutes:.1} core minutes, {:.1} minutes on 2 cores",
        minutes / 2.0
    );
    Ok(())
}
