//! Rows of errors (scratch).
use std::collections::BTreeMap;
use wcal_mujoco::Mesh;
use wcal_track::evaluate::Method;
use wcal_track::model_file::load;
use wcal_track::{InverseGrid, StaticInverse, course};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let device = wcal_track::Device::flex();
    let (tracker, card) = load(std::path::Path::new(&a[2]), &device)?;
    let fine = StaticInverse::new(&card.whisker, InverseGrid::default())?;
    let names: Vec<String> = card.objects.unseen.clone();
    let courses: BTreeMap<_, _> = course::read_courses(std::path::Path::new(&a[1]), &names)?;
    println!(
        "object,sweep,t,travel,speed,my,mz,s,contacts,settled,event,since,n_surf,n_true,n_sd,b_surf,b_true,b_sd,nodes_best"
    );
    for (name, cs) in courses {
        let mesh = Mesh::read(&std::path::Path::new(&a[3]).join(format!("{name}.stl")))?;
        for c in cs.iter().take(8) {
            let n = Method::Network(&tracker, true).run(c);
            let b = Method::Bayes(&fine, true, Default::default()).run(c);
            let mut since = 0.0;
            for ((i, n), b) in c.instants.iter().zip(&n).zip(&b) {
                if ["onset", "jump", "slip"].contains(&i.event.as_str()) {
                    since = i.travel_mm;
                }
                let Some(truth) = i.contact else { continue };
                let mut cand = Vec::new();
                fine.candidates(i.moment_nmm, &mut cand);
                let best = cand.iter().map(|c| (c.point_mm - truth.point_mm).norm()).fold(1e9, f64::min);
                let sd =
                    |e: &wcal_track::evaluate::Estimate| e.covariance_mm2.map_or(-1.0, |c| c.trace().sqrt());
                println!(
                    "{name},{},{:.3},{:.3},{:.3},{:.5},{:.5},{:.3},{},{},{},{:.3},{:.4},{:.4},{:.4},{:.4},{:.4},{:.4},{:.4}",
                    c.sweep,
                    i.t_s,
                    i.travel_mm,
                    i.speed_mm_s,
                    i.moment_nmm[0],
                    i.moment_nmm[1],
                    truth.arclength_mm,
                    i.contacts,
                    i.settled,
                    i.event,
                    i.travel_mm - since,
                    c.surface_mm(&mesh, i.travel_mm, &n.point_mm),
                    (n.point_mm - truth.point_mm).norm(),
                    sd(n),
                    c.surface_mm(&mesh, i.travel_mm, &b.point_mm),
                    (b.point_mm - truth.point_mm).norm(),
                    sd(b),
                    best
                );
            }
        }
    }
    Ok(())
}
