use nalgebra::Vector3;
use std::path::Path;
use wcal_core::observation::{RestShape, WhiskerSpec};
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
    let inverse = StaticInverse::new(&whisker, InverseGrid::default())?;
    let all = read_courses(Path::new(&words[0]), &words[1..2])?;
    let course = &all.values().next().unwrap()[words[2].parse::<usize>()?];
    let mut f = BayesFilter::new(&inverse, BayesSettings::default());
    let (mut c, mut last, mut prev) = (Vec::new(), 0.0, None::<(Vector3<f64>, Vector3<f64>)>);
    for now in &course.instants {
        let dt = now.t_s - last;
        last = now.t_s;
        let b = f.step(dt, now.moment_nmm, Some(now.speed_mm_s));
        inverse.candidates(now.moment_nmm, &mut c);
        let Some(k) = &now.contact else {
            prev = None;
            println!("{:.1} free {:?}", now.t_s, now.moment_nmm);
            continue;
        };
        let (i, best) = c
            .iter()
            .map(|c| (c.point_mm - k.point_mm).norm())
            .enumerate()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap();
        let slant = inverse.nodes[i].slant.atan().to_degrees();
        let post = f.posterior().get(i).copied().unwrap_or(f64::NAN);
        let r = prev.map(|(p, n)| {
            (n + c[i].normal).normalize().dot(&(k.point_mm - p + Vector3::z() * now.speed_mm_s * dt))
        });
        prev = Some((k.point_mm, c[i].normal));
        println!(
            "{:.1} best {best:.2} slant {slant:.0} post {post:.4} s {:.2} M {:.3} {:.3} v {:.2} truth ({:.2} {:.2} {:.2}) cand ({:.2} {:.2} {:.2}) n ({:.2} {:.2} {:.2}) reach {} rule {:?} n={} {} {} err {:?} belief {:?}",
            now.t_s,
            k.arclength_mm,
            now.moment_nmm[0],
            now.moment_nmm[1],
            now.speed_mm_s,
            k.point_mm.x,
            k.point_mm.y,
            k.point_mm.z,
            c[i].point_mm.x,
            c[i].point_mm.y,
            c[i].point_mm.z,
            c[i].normal.x,
            c[i].normal.y,
            c[i].normal.z,
            c[i].reachable,
            r.map(|r| (r * 1000.0).round() / 1000.0),
            now.contacts,
            now.settled,
            now.event,
            b.map(|b| ((b.point_mm - k.point_mm).norm() * 100.0).round() / 100.0),
            b.map(|b| b.arclength_mm.round())
        );
    }
    Ok(())
}
