//! How long the edges of scans are, and how far apart the contacts of SIMULATED sweeps over them: `contacts_apart SWEEPS MESHES`. Where a smooth
//! body is scanned, contacts nearer to each other than an edge is long are one (`Instant::contacts`).
#![allow(missing_docs, clippy::print_stdout, reason = "an example")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use wcal_mujoco::{objects, read};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, sweeps, meshes] = &args[..] else { return Err("contacts_apart SWEEPS MESHES".into()) };
    let folder = PathBuf::from(sweeps);
    let (mut medians, mut longest, mut apart, mut touching) = (Vec::new(), Vec::new(), Vec::new(), 0);
    let mut known = BTreeSet::new();
    for (name, manifest) in read::manifests(&folder)? {
        if known.insert(manifest.object.clone()) {
            let mesh = objects::named(&manifest.object, Some(Path::new(meshes)))?;
            let points: Vec<_> = mesh.points().collect();
            let edge = |a: u32, b: u32| (points[a as usize] - points[b as usize]).norm();
            let of = |t: &[u32; 3]| [edge(t[0], t[1]), edge(t[1], t[2]), edge(t[2], t[0])];
            let mut edges: Vec<f64> = mesh.triangles().iter().flat_map(of).collect();
            medians.push(quantile(&mut edges, 0.5));
            longest.push(quantile(&mut edges, 0.95));
        }
        let contacts = read::table(&folder.join(format!("{name}.contacts.parquet")))?;
        let at = contacts.whole("sweep")?.iter().zip(contacts.whole("sample")?);
        let mut ends: BTreeMap<(i64, i64), (usize, f64, f64)> = BTreeMap::new();
        for ((sweep, sample), mm) in at.zip(contacts.real("arclength_mm")?) {
            let (count, low, high) = ends.entry((*sweep, *sample)).or_insert((0, *mm, *mm));
            (*count, *low, *high) = (*count + 1, low.min(*mm), high.max(*mm));
        }
        touching += ends.len();
        apart.extend(ends.values().filter(|e| e.0 > 1).map(|e| e.2 - e.1));
    }
    println!(
        "edges of {} scans, mm: median {:.2}, 95 % {:.2} (medians over the scans)",
        medians.len(),
        quantile(&mut medians, 0.5),
        quantile(&mut longest, 0.5)
    );
    let share = |least: f64| apart.iter().filter(|a| **a >= least).count() as f64 / touching as f64;
    let shares = [0.0, 1.0, 2.0, 3.0, 5.0].map(|least| format!("{:.3} {least} mm", share(least)));
    println!(
        "of {touching} instants with contact have two or more, at least so far apart: {}",
        shares.join(", ")
    );
    let quantiles = [0.25, 0.5, 0.75, 0.95].map(|q| format!("{:.2}", quantile(&mut apart, q)));
    println!("distances of the outermost of them, mm: quartiles and 95 %: {}", quantiles.join(", "));
    Ok(())
}

fn quantile(all: &mut [f64], q: f64) -> f64 {
    all.sort_by(f64::total_cmp);
    all.get(((all.len().max(1) - 1) as f64 * q) as usize).copied().unwrap_or(f64::NAN)
}
