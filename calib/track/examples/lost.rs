//! Scratch: where the filter loses the truth.
use wcal_track::bayes::{BayesFilter, BayesSettings};
use wcal_track::model_file::load;
use wcal_track::{Candidate, InverseGrid, StaticInverse, course};
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let a: Vec<String> = std::env::args().collect();
    let (_, card) = load(std::path::Path::new(&a[2]), &wcal_track::Device::flex())?;
    let inv = StaticInverse::new(&card.whisker, InverseGrid::default())?;
    let names: Vec<String> = card.objects.training.iter().step_by(4).cloned().collect();
    let each: usize = a[3].parse()?;
    println!(
        "object,sweep,t,event,contacts,settled,contacts_before,s_before,s,m,way,best_before,best,off,slid,p_before,p,tipmass,bmean"
    );
    for (name, cs) in course::read_courses(std::path::Path::new(&a[1]), &names)? {
        for c in cs.iter().take(each) {
            let mut f = BayesFilter::new(&inv, BayesSettings::default());
            let mut last = 0.0;
            let mut before: Option<(Vec<Candidate>, usize, f64, f64, usize, f64)> = None;
            for i in &c.instants {
                let dt = i.t_s - last;
                last = i.t_s;
                let belief = f.step(dt, i.moment_nmm, Some(i.speed_mm_s));
                let Some(truth) = i.contact else {
                    before = None;
                    continue;
                };
                let cand = f.candidates().to_vec();
                let post = f.posterior();
                if post.is_empty() {
                    before = None;
                    continue;
                }
                let d = |c: &Candidate| (c.point_mm - truth.point_mm).norm();
                let j = (0..cand.len()).min_by(|a, b| d(&cand[*a]).total_cmp(&d(&cand[*b]))).unwrap();
                // at the tip the lean matters: all tip nodes within
                let p: f64 = post.iter().zip(&cand).filter(|(_, c)| d(c) < 2.0).map(|(w, _)| w).sum::<f64>()
                    / post.iter().sum::<f64>();
                let tip: f64 =
                    post.iter().zip(&inv.nodes).filter(|(_, n)| n.lean > 0.0).map(|(w, _)| w).sum();
                if let Some((bc, k, bs, bp, bcon, btravel)) = &before {
                    if *bp > 0.3 && p < 0.1 {
                        let way = cand[j].point_mm - bc[*k].point_mm
                            + nalgebra::Vector3::z() * (i.travel_mm - btravel);
                        let n = (cand[j].normal + bc[*k].normal).normalize();
                        let off = n.dot(&way);
                        println!(
                            "{name},{},{:.2},{},{},{},{bcon},{bs:.2},{:.2},{:.4},{:.3},{:.3},{:.3},{:.4},{:.3},{bp:.3},{p:.4},{tip:.3},{:.2}",
                            c.sweep,
                            i.t_s,
                            i.event,
                            i.contacts,
                            i.settled,
                            truth.arclength_mm,
                            i.moment_nmm[0].hypot(i.moment_nmm[1]),
                            i.travel_mm - btravel,
                            (0.0f64).max(bc[*k].volume.min(0.0)),
                            d(&cand[j]),
                            off,
                            (way - n * off).norm(),
                            belief.map_or(-1.0, |b| b.arclength_mm)
                        );
                    }
                }
                before = Some((cand, j, truth.arclength_mm, p, i.contacts, i.travel_mm));
            }
        }
    }
    Ok(())
}
