use wcal_core::SessionData;
use wcal_trace::candidate::System;
use wcal_trace::engine::{atoms, fit, linear::stack, null};
use wcal_trace::whisker::WhiskerSystem;
fn main() {
    for folder in std::env::args().skip(1) {
        let t0 = std::time::Instant::now();
        let loaded = wcal_session::load(std::path::Path::new(&folder)).expect("session");
        let SessionData::Whisker(data) = &loaded.data else { panic!() };
        let rows: Vec<_> = data.rows.iter().collect();
        let system = WhiskerSystem::new(data, &rows).expect("system");
        let w = fit::Weights::equal(rows.len());
        let base = fit::fit(&system, &[], &w, 20).expect("base");
        println!("{folder} n {} sigma {:.4}", rows.len(), base.variance().sqrt());
        let nui = atoms::nuisance(&base);
        let all = atoms::of_catalogue(&system, &base, &w, &nui);
        let t1 = t0.elapsed();
        let r = stack(&base.residual);
        let refs: Vec<_> = all.iter().collect();
        let family = null::NullFamily::simulate(&refs, base.dof, 2000, 1);
        let t2 = t0.elapsed();
        let mut best: Vec<(f64, usize)> = Vec::new();
        for e in 0..system.catalogue().len() {
            let mut m = (0.0, usize::MAX);
            for (i, a) in all.iter().enumerate() {
                if a.term.effect == e {
                    let g = a.gain(&r);
                    if g > m.0 {
                        m = (g, i);
                    }
                }
            }
            if m.1 != usize::MAX {
                best.push(m);
            }
        }
        best.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (g, i) in best.iter().take(7) {
            let a = &all[*i];
            let c = &system.catalogue()[a.term.effect];
            let law = &c.laws()[a.term.law];
            let p = null::atom_p(a, *g, base.ssr, base.dof);
            let start = a.start(&r, law);
            let mut terms = base.terms.clone();
            terms.push(start.clone());
            let t = std::time::Instant::now();
            let f = fit::fit(&system, &terms, &w, 15);
            if let Some(f) = f {
                println!(
                    "  {:24} {:12} gain/s2 {:9.1} p {:.1e} adj {:.1e} share {:.3} start {:?} -> {:?} sigma {:.4} dSSR/s2 {:.1} {:?} bound {:?} {:?}",
                    c.id(),
                    law.name,
                    g / base.variance(),
                    p,
                    family.adjusted(p),
                    a.share_left,
                    start.values,
                    f.terms[0].values,
                    f.variance().sqrt(),
                    (base.ssr - f.ssr) / f.variance(),
                    f.status,
                    f.at_bound,
                    t.elapsed()
                );
            } else {
                println!("  {} fit failed", c.id());
            }
        }
        println!("  atoms {} t {:?} null {:?} total {:?}", all.len(), t1, t2 - t1, t0.elapsed());
    }
}
