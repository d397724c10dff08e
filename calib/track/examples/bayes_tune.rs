//! Scratch: the filter on training objects.
use rayon::prelude::*;
use wcal_mujoco::Mesh;
use wcal_track::bayes::{BayesFilter, BayesSettings};
use wcal_track::evaluate::{Estimate, compared};
use wcal_track::model_file::load;
use wcal_track::{InverseGrid, StaticInverse, course};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let (_, card) = load(std::path::Path::new(&a[2]), &wcal_track::Device::flex())?;
    let each: usize = a[4].parse()?;
    let step: usize = a[5].parse()?;
    let settings: Vec<serde_json::Value> = serde_json::from_str(&std::fs::read_to_string(&a[6])?)?;
    let names: Vec<String> = card.objects.training.iter().step_by(step).cloned().collect();
    let mut courses = Vec::new();
    for (name, cs) in course::read_courses(std::path::Path::new(&a[1]), &names)? {
        let mesh = std::sync::Arc::new(Mesh::read(&std::path::Path::new(&a[3]).join(format!("{name}.stl")))?);
        courses.extend(cs.into_iter().take(each).map(|c| (mesh.clone(), c)));
    }
    for row in settings {
        let known = row["known"].as_bool().unwrap_or(true);
        let mut g = serde_json::to_value(InverseGrid::default())?;
        if let Some(o) = row["grid"].as_object() {
            for (k, v) in o {
                g[k] = v.clone();
            }
        }
        let mut s = serde_json::to_value(BayesSettings::default())?;
        if let Some(o) = row["set"].as_object() {
            for (k, v) in o {
                s[k] = v.clone();
            }
        }
        let (grid, s): (InverseGrid, BayesSettings) =
            (serde_json::from_value(g)?, serde_json::from_value(s)?);
        let inv = StaticInverse::new(&card.whisker, grid)?;
        let begin = std::time::Instant::now();
        let rows: Vec<(f64, f64, f64, bool)> = courses
            .par_iter()
            .flat_map_iter(|(mesh, c)| {
                let mut filter = BayesFilter::new(&inv, s);
                let (mut last_s, mut last) = (0.0, nalgebra::Vector3::zeros());
                let e: Vec<Estimate> = c
                    .instants
                    .iter()
                    .map(|i| {
                        let dt = i.t_s - std::mem::replace(&mut last_s, i.t_s);
                        let b = filter.step(dt, i.moment_nmm, known.then_some(i.speed_mm_s));
                        last = b.map_or(last, |b| b.point_mm);
                        Estimate {
                            contact: b.is_some(),
                            point_mm: last,
                            covariance_mm2: b.map(|b| b.covariance_mm2),
                        }
                    })
                    .collect();
                let (pairs, _) = compared(c, mesh, &e);
                let tip: Vec<bool> =
                    c.instants.iter().filter_map(|i| i.contact).map(|c| c.arclength_mm > 59.99).collect();
                pairs
                    .into_iter()
                    .zip(tip)
                    .map(|((p, f), t)| (p.surface_mm, p.off_mm.norm(), if f { 1.0 } else { 0.0 }, t))
                    .collect::<Vec<_>>()
            })
            .collect();
        let rms = |x: Vec<f64>| (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt();
        let q = |mut x: Vec<f64>, q: f64| {
            x.sort_by(f64::total_cmp);
            x[(x.len() as f64 * q) as usize]
        };
        let get = |f: &dyn Fn(&(f64, f64, f64, bool)) -> bool, k: usize| {
            rows.iter().filter(|r| f(r)).map(|r| if k == 0 { r.0 } else { r.1 }).collect::<Vec<_>>()
        };
        println!(
            "{row}: n {} {:.1}s surf rms {:.3} med {:.3} p90 {:.3} p95 {:.3} true rms {:.3} med {:.3} | followed surf {:.3} true {:.3} | tip surf {:.3} med {:.3} wire surf {:.3} med {:.3}",
            rows.len(),
            begin.elapsed().as_secs_f64(),
            rms(get(&|_| true, 0)),
            q(get(&|_| true, 0), 0.5),
            q(get(&|_| true, 0), 0.9),
            q(get(&|_| true, 0), 0.95),
            rms(get(&|_| true, 1)),
            q(get(&|_| true, 1), 0.5),
            rms(get(&|r| r.2 > 0.5, 0)),
            rms(get(&|r| r.2 > 0.5, 1)),
            rms(get(&|r| r.3, 0)),
            q(get(&|r| r.3, 0), 0.5),
            rms(get(&|r| !r.3, 0)),
            q(get(&|r| !r.3, 0), 0.5)
        );
    }
    Ok(())
}
