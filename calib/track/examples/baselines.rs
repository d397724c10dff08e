//! RMSE (mm) of the baselines over a folder of shards: `baselines SHARDS MESHES [OBJECT ...]`.
use nalgebra::Vector3;
use std::path::Path;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mujoco::Mesh;
use wcal_track::bayes::{BayesFilter, BayesSettings};
use wcal_track::course::read_courses;
use wcal_track::{InverseGrid, StaticInverse};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let whisker = WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: None,
        rest_shape: RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: 60.0 },
        gravity_direction: None,
    };
    let begin = std::time::Instant::now();
    let inverse = StaticInverse::new(&whisker, InverseGrid::default())?;
    println!("inverse: {:.1} s", begin.elapsed().as_secs_f64());
    let all = read_courses(Path::new(&words[0]), &words[2..])?;
    let settings = BayesSettings::default();
    let mut total = vec![[0.0; 3]; 4];
    for (object, courses) in &all {
        let mesh = Mesh::read(&Path::new(&words[1]).join(format!("{object}.stl")))?;
        let mut sums = vec![[0.0f64; 3]; 4];
        for course in courses {
            let mut known = BayesFilter::new(&inverse, settings);
            let mut blind = BayesFilter::new(&inverse, settings);
            let mut candidates = Vec::new();
            let mut last = 0.0;
            for now in &course.instants {
                let dt = now.t_s - last;
                last = now.t_s;
                let a = known.step(dt, now.moment_nmm, Some(now.speed_mm_s));
                let b = blind.step(dt, now.moment_nmm, None);
                let Some(contact) = &now.contact else { continue };
                inverse.candidates(now.moment_nmm, &mut candidates);
                let nearest = |s: f64| {
                    let k = inverse
                        .nodes
                        .iter()
                        .map(|n| n.arclength_mm)
                        .enumerate()
                        .min_by(|a, b| (a.1 - s).abs().total_cmp(&(b.1 - s).abs()))
                        .map_or(0, |x| x.0);
                    candidates[k].point_mm
                };
                let guesses = [
                    Some(nearest(contact.arclength_mm)),
                    Some(nearest(40.0)),
                    a.map(|x| x.point_mm),
                    b.map(|x| x.point_mm),
                ];
                for (sum, guess) in sums.iter_mut().zip(guesses) {
                    let guess = guess.unwrap_or(Vector3::new(40.0, 0.0, 0.0));
                    sum[0] += course.surface_mm(&mesh, now.travel_mm, &guess).powi(2);
                    sum[1] += (guess - contact.point_mm).norm_squared();
                    sum[2] += 1.0;
                }
            }
        }
        let show: Vec<String> =
            sums.iter().map(|s| format!("{:.2}/{:.2}", (s[0] / s[2]).sqrt(), (s[1] / s[2]).sqrt())).collect();
        println!(
            "{object:30} true-arclength {} s=40 {} bayes-known {} bayes-blind {}",
            show[0], show[1], show[2], show[3]
        );
        for (t, s) in total.iter_mut().zip(&sums) {
            t[0] += (s[0] / s[2]).sqrt();
            t[1] += (s[1] / s[2]).sqrt();
            t[2] += 1.0;
        }
    }
    let show: Vec<String> = total.iter().map(|s| format!("{:.3}/{:.3}", s[0] / s[2], s[1] / s[2])).collect();
    println!(
        "mean of objects: true-arclength {} s=40 {} bayes-known {} bayes-blind {}",
        show[0], show[1], show[2], show[3]
    );
    Ok(())
}
