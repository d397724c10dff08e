use nalgebra::Vector3;
use wcal_plant::rod::*;
use wcal_plant::table::*;
fn grab(s: &str, k: &str) -> f64 { s.lines().find(|l| l.starts_with(k)).unwrap().split('=').nth(1).unwrap().trim().parse().unwrap() }
fn paths(w: &Wire) -> Vec<(usize, Path, f64)> {
    let mut v = vec![];
    for (id0, ls, angs) in [(1usize, vec![18.0, 31.0, 45.0], [0f64, -60.0, 60.0]), (101, vec![23.0, 38.0], [-25.0, -85.0, 35.0])] {
        for (i, l) in ls.iter().enumerate() { for (j, a) in angs.iter().enumerate() {
            let (o, t) = w.rest(*l); let n = Vector3::new(-t.z, 0.0, t.x); let a = a.to_radians();
            let hi: f64 = match *l as i32 { 18 => 5.2, 31 => 9.3, 45 => 13.5, 23 => 6.7, _ => 11.2 };
            v.push((id0 + i * 3 + j, Path { origin_mm: o, direction: n * a.cos() + Vector3::y() * a.sin(), arclength_mm: *l, offset_mm: Vector3::zeros() }, hi));
        } }
    }
    v
}
fn main() {
    let truth: serde_json::Value = serde_json::from_str(&std::fs::read_to_string("/work/shared/practice/truth.json").unwrap()).unwrap();
    for name in std::env::args().skip(1) {
        let toml = std::fs::read_to_string(format!("/work/shared/practice/{name}/session.toml")).unwrap();
        let e = grab(&toml, "youngs_gpa");
        let mut w = Wire::new(0.3, 60.0, grab(&toml, "straight_mm"), grab(&toml, "arc_radius_mm"), e, grab(&toml, "shear_gpa"));
        let ef = &truth[&name]["effects"];
        if let Some(c) = ef["base-compliance"].as_f64() { w.root_compliance = [c, c]; }
        let mu = ef["groove-friction"].as_f64().unwrap_or(0.0);
        let off: Vec<f64> = ef["contact-offset"].as_array().map(|a| a.iter().map(|x| x.as_f64().unwrap()).collect()).unwrap_or(vec![0.0; 3]);
        let off = Vector3::from_vec(off);
        let drags = if mu > 0.0 { friction_drags() } else { vec![0.0] };
        let t0 = std::time::Instant::now();
        let tables: Vec<_> = paths(&w).into_iter().filter(|p| p.0 > 100).map(|(id, mut p, hi)| { p.offset_mm = off; (id, Table::build(&w, &p, hi, &drags, 18).unwrap_or_else(|e| panic!("{id} {e}"))) }).collect();
        println!("{name} tables {:.3} s touch {:?}", t0.elapsed().as_secs_f64(), tables.iter().map(|t| t.1.touch_mm()).collect::<Vec<_>>());
        let mut rd = csv::Reader::from_path(format!("/work/shared/practice/{name}/holdout.csv")).unwrap();
        let mut grip = Grip::default();
        let mut last = 0.0; let mut worst = 0.0f64;
        for (i, rec) in rd.records().enumerate() {
            let rec = rec.unwrap();
            let x: f64 = rec[5].parse().unwrap();
            let m = &truth[&name]["holdout_moments_nmm"][i];
            let (my, mz) = (m[0].as_f64().unwrap(), m[1].as_f64().unwrap());
            if &rec[1] == "rest" { grip = Grip::default(); last = 0.0; if my != 0.0 || mz != 0.0 { println!("rest moment {my} {mz}"); } continue; }
            let tr: usize = rec[2].parse().unwrap();
            let t = &tables.iter().find(|t| t.0 == tr).unwrap().1;
            let mut drag = 0.0; let mut mm = [0.0; 2];
            if mu > 0.0 { for q in 1..=100 { (mm, drag) = grip.step(t, last + (x - last) * q as f64 / 100.0, mu); } } else { let n = t.at(x, 0.0); mm = [n[0], n[1]]; }
            last = x;
            let (a, b) = (mm[0] - my, mm[1] - mz);
            let z = t.at(x, 0.0);
            worst = worst.max(a.abs()).max(b.abs());
            println!("{name} {tr} x {x:.4} dir {} m {:.6} {:.6} truth {my:.6} {mz:.6} diff {a:.2e} {b:.2e} drag {drag:.4} s {:.3} frictionless-truth {:.5} {:.5}", &rec[6], mm[0], mm[1], z[2], z[0]-my, z[1]-mz);
        }
        println!("{name} worst {worst:.2e}");
    }
}
