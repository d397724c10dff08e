//! Scores of the Bayes filter on SIMULATED sweeps for settings that come in line by line as JSON: `filter_search SWEEPS MESHES FIRST EACH
//! [known|unknown] OBJECT...`; prints for each the RMSE to the surface and to the contact (mm, mean over objects), the mean logarithm of
//! the belief within 1 mm of the truth, and that of the evidence: settings that are true of the sweeps have the most.
#![allow(missing_docs, clippy::print_stdout, reason = "an example")]

use rayon::prelude::*;
use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use wcal_mujoco::{Mesh, objects};
use wcal_track::bayes::{BayesFilter, BayesSettings};
use wcal_track::{Course, InverseGrid, StaticInverse, course};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, sweeps, meshes, first, each, known, names @ ..] = &args[..] else {
        return Err("filter_search SWEEPS MESHES FIRST EACH known|unknown OBJECT...".into());
    };
    let (first, each): (u64, u64) = (first.parse()?, each.parse()?);
    let mut courses = course::read_courses(&PathBuf::from(sweeps), names)?;
    for of in courses.values_mut() {
        of.retain(|c| c.sweep >= first && c.sweep < first + each);
    }
    let mesh = |object: &String| objects::named(object, Some(Path::new(meshes)));
    let all: Vec<(Mesh, &Vec<Course>)> =
        courses.iter().map(|(o, c)| Ok((mesh(o)?, c))).collect::<Result<_, wcal_mujoco::TwinError>>()?;
    let grid = InverseGrid { refine: 2, leans: 8, ..InverseGrid::default() };
    let inverse = StaticInverse::new(&wcal_core::observation::WhiskerSpec::nominal(), grid)?;
    for line in std::io::stdin().lock().lines() {
        let settings: BayesSettings = serde_json::from_str(&line?)?;
        let (mut surface, mut contact, mut belief, mut evidence, mut n) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (mesh, courses) in &all {
            let sums = courses
                .par_iter()
                .map(|c| sums(c, mesh, &inverse, settings, known == "known"))
                .reduce(|| [0.0; 5], |a, b| std::array::from_fn(|k| a[k] + b[k]));
            let count = sums[4].max(1.0);
            surface += (sums[0] / count).sqrt() / all.len() as f64;
            contact += (sums[1] / count).sqrt() / all.len() as f64;
            belief += sums[2];
            evidence += sums[3];
            n += sums[4];
        }
        println!("{surface:.4} {contact:.4} {:.4} {:.4}", belief / n, evidence / n);
        std::io::stdout().flush()?;
    }
    Ok(())
}

/// Squares to the surface and to the contact, logarithms of the belief and of the evidence, and instants.
fn sums(
    course: &Course,
    mesh: &Mesh,
    inverse: &StaticInverse,
    settings: BayesSettings,
    known: bool,
) -> [f64; 5] {
    let mut filter = BayesFilter::new(inverse, settings);
    let (mut last_s, mut sums) = (0.0, [0.0; 5]);
    for i in &course.instants {
        let dt = i.t_s - std::mem::replace(&mut last_s, i.t_s);
        let belief = filter.step(dt, i.moment_nmm, known.then_some(i.speed_mm_s));
        let (Some(truth), Some(belief)) = (i.contact, belief) else { continue };
        let both = filter.candidates().iter().zip(filter.posterior());
        let near: f64 =
            both.filter(|(c, _)| (c.point_mm - truth.point_mm).norm() < 1.0).map(|(_, w)| w).sum();
        sums[0] += course.surface_mm(mesh, i.travel_mm, &belief.point_mm).powi(2);
        sums[1] += (belief.point_mm - truth.point_mm).norm_squared();
        sums[2] += (near.max(0.0) + 1e-3).ln();
        sums[3] += filter.log_evidence();
        sums[4] += 1.0;
    }
    sums
}
