//! Scratch: the tip.
use wcal_track::bayes::{BayesFilter, BayesSettings};
use wcal_track::model_file::load;
use wcal_track::{Candidate, InverseGrid, StaticInverse, course};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let (_, card) = load(std::path::Path::new(&a[2]), &wcal_track::Device::flex())?;
    let inv = StaticInverse::new(&card.whisker, InverseGrid { refine: 1, ..InverseGrid::default() })?;
    let mesh = wcal_mujoco::Mesh::read(&std::path::Path::new(&a[5]).join(format!("{}.stl", a[3])))?;
    let all = course::read_courses(std::path::Path::new(&a[1]), &[a[3].clone()])?;
    let c = &all[&a[3]][a[4].parse::<usize>()?];
    let mut f = BayesFilter::new(&inv, BayesSettings::default());
    let mut last = 0.0;
    let mut before: Option<(Vec<Candidate>, f64)> = None;
    for i in &c.instants {
        let dt = i.t_s - last;
        last = i.t_s;
        f.step(dt, i.moment_nmm, Some(i.speed_mm_s));
        let Some(truth) = i.contact else { continue };
        let cand = f.candidates().to_vec();
        let post = f.posterior();
        if truth.arclength_mm > 59.9 {
            let at = truth.point_mm + nalgebra::Vector3::z() * i.travel_mm;
            let local = c.base_from_object.inverse_transform_point(&nalgebra::Point3::from(at));
            let near = mesh.near(&local.coords, 10.0).unwrap();
            println!(
                "t {:.2} m {:.4} {:.4} event {} near {:.4} {:?}",
                i.t_s,
                i.moment_nmm[0],
                i.moment_nmm[1],
                i.event,
                near.distance_mm,
                c.base_from_object.rotation * near.normal
            );
            if let Some((b, travel)) = &before {
                for (j, n) in inv.nodes.iter().enumerate().filter(|(_, n)| n.arclength_mm > 57.0) {
                    let way =
                        cand[j].point_mm - b[j].point_mm + nalgebra::Vector3::z() * (i.travel_mm - travel);
                    let nn = cand[j].normal;
                    println!(
                        "   s {:.1} lean {:.0} reach {} post {:.4} off {:.4} d {:.3} n {:.2} {:.2} {:.2} way {:.2} {:.2} {:.2} area {:.2} vol {:.3}",
                        n.arclength_mm,
                        n.lean,
                        cand[j].reachable,
                        post.get(j).unwrap_or(&-1.0),
                        nn.dot(&way),
                        (cand[j].point_mm - truth.point_mm).norm(),
                        nn.x,
                        nn.y,
                        nn.z,
                        way.x,
                        way.y,
                        way.z,
                        cand[j].area.norm(),
                        cand[j].volume
                    );
                }
            }
        }
        before = Some((cand, i.travel_mm));
    }
    Ok(())
}
