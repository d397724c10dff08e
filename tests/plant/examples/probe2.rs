#![allow(warnings)]
use nalgebra::*;
use wcal_plant::rod::*;
use wcal_plant::table::*;
fn grab(s: &str, k: &str) -> f64 { s.lines().find(|l| l.starts_with(k)).unwrap().split('=').nth(1).unwrap().trim().parse().unwrap() }
fn paths(w: &Wire) -> Vec<(usize, Path, f64)> {
    let mut v = vec![];
    for (id0, ls, angs) in [(1usize, vec![18.0, 31.0, 45.0], [0f64, -60.0, 60.0]), (101, vec![23.0, 38.0], [-25.0, -85.0, 35.0])] {
        for (i, l) in ls.iter().enumerate() { for (j, a) in angs.iter().enumerate() {
            let (o, t) = w.rest(*l); let n = Vector3::new(-t.z, 0.0, t.x); let a = a.to_radians();
            let hi: f64 = match *l as i32 { 18 => 5.4, 31 => 9.5, 45 => 13.8, 23 => 6.7, _ => 11.2 };
            v.push((id0 + i * 3 + j, Path { origin_mm: o, direction: n * a.cos() + Vector3::y() * a.sin(), arclength_mm: *l, offset_mm: Vector3::zeros() }, hi));
        } }
    }
    v
}
pub struct Row { pub hold: bool, pub rest: bool, pub tr: usize, pub rep: usize, pub t: f64, pub x: f64, pub dir: f64, pub v: f64, pub dwell: f64, pub temp: f64, pub y: [f64; 2], pub n: f64 }
fn load(name: &str, toml: &str) -> Vec<Row> {
    let nums = |k: &str| -> Vec<f64> { toml.lines().find(|l| l.starts_with(k)).unwrap().split('=').nth(1).unwrap().trim().trim_matches(['[', ']']).split(',').map(|x| x.trim().parse().unwrap()).collect() };
    let nom = nums("nominal_nm"); let rn = nums("reference_nominal_nm")[0];
    let mut out = vec![];
    for (f, hold) in [("points.csv", false), ("holdout.csv", true)] {
        let mut rd = csv::Reader::from_path(format!("/work/shared/practice/{name}/{f}")).unwrap();
        for r in rd.records() { let r = r.unwrap(); let g = |i: usize| r[i].parse::<f64>().unwrap();
            let dt = (g(13) - rn) * 100.0;
            out.push(Row { hold, rest: &r[1] == "rest", tr: g(2) as usize, rep: g(3) as usize, t: g(4), x: g(5), dir: g(6), v: g(7), dwell: g(8), temp: dt, n: g(18), y: [(g(14) - nom[0]) * 1e3 - 10.0 * dt, (g(15) - nom[1]) * 1e3 - 10.0 * dt] }); }
    }
    out
}
fn fit(rows: &[Row], cols: &[Vec<f64>], noise: f64, label: &str) -> Vec<DVector<f64>> {
    let n = rows.len(); let k = cols.len();
    let a = DMatrix::from_fn(n, k, |i, j| cols[j][i]);
    let svd = a.clone().svd(true, true);
    let mut res = vec![]; let mut s = String::new(); let mut chi = 0.0;
    for c in 0..2 { let b = DVector::from_fn(n, |i, _| rows[i].y[c]); let x = svd.solve(&b, 1e-12).unwrap(); let r = &b - &a * &x; s += &format!(" {:?}", x.iter().map(|v| (v * 1e4).round() / 1e4).collect::<Vec<_>>()); chi += r.norm_squared(); res.push(r); }
    println!("  {label}: rms/noise {:.4} chi2 {:.1} coef{s}", (chi / (2 * n) as f64).sqrt() / noise, chi / noise / noise);
    res
}
fn main() {
    let truth: serde_json::Value = serde_json::from_str(&std::fs::read_to_string("/work/shared/practice/truth.json").unwrap()).unwrap();
    for name in std::env::args().skip(1) {
        let toml = std::fs::read_to_string(format!("/work/shared/practice/{name}/session.toml")).unwrap();
        let e = grab(&toml, "youngs_gpa"); let tn = &truth[&name]; let ef = &tn["effects"]; let noise = tn["noise_pm"].as_f64().unwrap();
        let mk = || Wire::new(0.3, 60.0, grab(&toml, "straight_mm"), grab(&toml, "arc_radius_mm"), e, grab(&toml, "shear_gpa"));
        let rows = load(&name, &toml);
        let w0 = mk();
        let mu = ef["groove-friction"].as_f64().unwrap_or(0.0);
        let tab = |w: &Wire, off: Vector3<f64>, mu: f64| -> Vec<(usize, Table)> { paths(w).into_iter().map(|(id, mut p, hi)| { p.offset_mm = off; (id, Table::build(w, &p, hi, &if mu > 0.0 { friction_drags() } else { vec![0.0] }, 18).unwrap()) }).collect() };
        let t0 = tab(&w0, Vector3::zeros(), mu);
        let find = |t: &Vec<(usize, Table)>, id: usize| t.iter().position(|q| q.0 == id).unwrap();
        let m_at = |t: &Vec<(usize, Table)>, r: &Row, x: f64| -> [f64; 2] { if r.rest { return [0.0; 2]; } let v = t[find(t, r.tr)].1.at(x, 0.0); [v[0], v[1]] };
        let n = rows.len();
        let one = vec![1.0; n];
        let colm = |f: &dyn Fn(&Row) -> [f64; 2]| -> Vec<Vec<f64>> { let v: Vec<_> = rows.iter().map(|r| f(r)).collect(); vec![one.clone(), v.iter().map(|m| m[0]).collect(), v.iter().map(|m| m[1]).collect()] };
        println!("{name} {} noise {noise:.3} delta {}", tn["label"], tn["projected_size_in_noises"]);
        let base = colm(&|r| m_at(&t0, r, r.x));
        fit(&rows, &base, noise, "base");
        // size definitions: project true effect off base over points / all
        let size = |cols: &Vec<Vec<f64>>, d: &dyn Fn(usize) -> [f64; 2], label: &str| {
            for (lab, lim) in [("points", false), ("all", true)] {
                let idx: Vec<usize> = (0..n).filter(|&i| lim || !rows[i].hold).collect();
                let a = DMatrix::from_fn(idx.len(), cols.len(), |i, j| cols[j][idx[i]]);
                let svd = a.clone().svd(true, true); let mut s = 0.0;
                for c in 0..2 { let b = DVector::from_fn(idx.len(), |i, _| d(idx[i])[c]); let x = svd.solve(&b, 1e-12).unwrap(); s += (b - &a * x).norm_squared(); }
                println!("  size {label} {lab}: {:.2}", s.sqrt() / noise);
            }
        };
        let kk: Vec<f64> = tn["K"].as_array().unwrap().iter().flat_map(|r| r.as_array().unwrap().iter().map(|x| x.as_f64().unwrap())).collect();
        let km = |m: [f64; 2]| [kk[0] * m[0] + kk[1] * m[1], kk[2] * m[0] + kk[3] * m[1]];
        match tn["label"].as_str().unwrap() {
            "temperature-mismatch" => { let mut c = base.clone(); c.push(rows.iter().map(|r| r.temp).collect()); fit(&rows, &c, noise, "dk"); let dk = &ef["temperature-mismatch"]; size(&base, &|i| [dk[0].as_f64().unwrap() * rows[i].temp, dk[1].as_f64().unwrap() * rows[i].temp], "dk"); }
            "time-lag" => { let tau = ef["time-lag"].as_f64().unwrap();
                let mut z = colm(&|r| m_at(&t0, r, r.x - r.v * r.dir * tau)); fit(&rows, &z, noise, "x-v tau");
                let z2 = colm(&|r| m_at(&t0, r, r.x - r.v * tau)); fit(&rows, &z2, noise, "x-|v| tau");
                size(&base, &|i| { let r = &rows[i]; let a = km(m_at(&t0, r, r.x - r.v * r.dir * tau)); let b = km(m_at(&t0, r, r.x)); [a[0] - b[0], a[1] - b[1]] }, "lag"); }
            "stage-backlash" => { let b = ef["stage-backlash"].as_f64().unwrap();
                for (l, up, dn) in [("unloading x+b", 0.0, b), ("unloading x-b", 0.0, -b), ("+-b/2", -b / 2.0, b / 2.0), ("loading x-b", -b, 0.0)] { let z = colm(&|r| m_at(&t0, r, r.x + if r.dir > 0.0 { up } else { dn })); fit(&rows, &z, noise, l);
                  size(&base, &|i| { let r = &rows[i]; let a = km(m_at(&t0, r, r.x + if r.dir > 0.0 { up } else { dn })); let b = km(m_at(&t0, r, r.x)); [a[0] - b[0], a[1] - b[1]] }, l); } }
            "fbg-nonlinearity" => { let c: Vec<f64> = ef["fbg-nonlinearity"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
                let mut z = base.clone(); for f in [(0, 0), (0, 1), (1, 1)] { z.push((0..n).map(|i| base[1 + f.0][i] * base[1 + f.1][i]).collect()); } fit(&rows, &z, noise, "quad");
                let mut z = base.clone(); z.push((0..n).map(|i| base[1][i].hypot(base[2][i]) * base[1][i]).collect()); z.push((0..n).map(|i| base[1][i].hypot(base[2][i]) * base[2][i]).collect()); fit(&rows, &z, noise, "|m|m"); 
                println!("  truth {c:?}");
                for (l, q) in [("A", [c[0], c[1], 0.0, 0.0, 0.0, c[2]]), ("B", [c[0], c[1], 0.0, 0.0, -c[1], c[2]]), ("C", [c[0], c[1], 0.0, 0.0, c[1], c[2]]), ("D", [c[0], 0.0, 0.0, 0.0, c[1], c[2]]), ("E", [c[0], c[1], 0.0, 0.0, c[0], c[2]]), ("F", [c[0], c[1], 0.0, 0.0, 0.5*c[1], c[2]]), ("G", [c[0], c[1], 0.0, 0.0, -c[0], c[2]]),("H", [c[0], c[1], 0.0, 0.0, -0.5*c[1], c[2]]),("I", [c[0], 0.5*c[1], 0.0, 0.0, -0.5*c[1], c[2]]),("J", [c[0], 0.5*c[1], 0.0, 0.0, 0.5*c[1], c[2]])] {
                    let d = |i: usize| { let (a, b) = (base[1][i], base[2][i]); [q[0] * a * a + q[1] * a * b + q[2] * b * b, q[3] * a * a + q[4] * a * b + q[5] * b * b] };
                    size(&base, &d, l);
                    let rr: Vec<Row> = (0..n).map(|i| { let r = &rows[i]; let dd = d(i); Row { y: [r.y[0] - dd[0], r.y[1] - dd[1]], ..Row{hold:r.hold,rest:r.rest,tr:r.tr,rep:r.rep,t:r.t,x:r.x,dir:r.dir,v:r.v,dwell:r.dwell,temp:r.temp,y:r.y,n:r.n} } }).collect();
                    fit(&rr, &base, noise, l);
                } }
            "contact-offset" => { let o: Vec<f64> = ef["contact-offset"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect(); let t1 = tab(&w0, Vector3::from_vec(o), 0.0);
                println!("  touch {:?}", t1.iter().map(|t| t.1.touch_mm()).collect::<Vec<_>>());
                let z = colm(&|r| m_at(&t1, r, r.x)); let res = fit(&rows, &z, noise, "offset, rest 0");
                let z2 = colm(&|r| { let v = t1[find(&t1, r.tr)].1.at(r.x, 0.0); [v[0], v[1]] }); fit(&rows, &z2, noise, "offset, rest loaded");
                size(&base, &|i| { let r = &rows[i]; let a = km(m_at(&t1, r, r.x)); let b = km(m_at(&t0, r, r.x)); [a[0] - b[0], a[1] - b[1]] }, "off"); }
            "base-compliance" => { let c = ef["base-compliance"].as_f64().unwrap(); let mut w = mk(); w.root_compliance = [c, c]; let t1 = tab(&w, Vector3::zeros(), 0.0); fit(&rows, &colm(&|r| m_at(&t1, r, r.x)), noise, "compl");
                size(&base, &|i| { let r = &rows[i]; let a = km(m_at(&t1, r, r.x)); let b = km(m_at(&t0, r, r.x)); [a[0] - b[0], a[1] - b[1]] }, "comp"); }
            "creep" => { let a = ef["creep"]["amplitude"].as_f64().unwrap(); let tau = ef["creep"]["tau_s"].as_f64().unwrap();
                // variants
                for variant in 0..6 {
                    let mut z = [0.0f64; 2]; let mut mprev = [0.0; 2]; let mut out = vec![];
                    for i in 0..n { let r = &rows[i]; let m = m_at(&t0, r, r.x);
                        let newtr = i > 0 && (rows[i-1].tr != r.tr);
                        let dt = if i == 0 { r.t } else { r.t - rows[i - 1].t };
                        let relax = |z: f64, from: f64, to: f64, dt: f64, mv: f64| -> f64 { // ramp in mv then hold
                            let mut z = z; let k = 40; for q in 0..k { let mm = from + (to - from) * (q as f64 + 0.5) / k as f64; let h = mv / k as f64; z = mm + (z - mm) * (-h / tau).exp(); } let hold = (dt - mv).max(0.0); to + (z - to) * (-hold / tau).exp() };
                        let mv = if r.v > 0.0 { dt } else { (dt - r.dwell).max(0.0) };
                        for c in 0..2 { z[c] = match variant { 0 => relax(z[c], mprev[c], m[c], dt, mv), 1 => m[c] + (z[c] - m[c]) * (-dt / tau).exp(), 2 => { let h = r.dwell; let zz = mprev[c] + (z[c] - mprev[c]) * (-(dt - h).max(0.0) / tau).exp(); m[c] + (zz - m[c]) * (-h / tau).exp() }, 3 => { let mm = 0.5*(m[c]+mprev[c]); let q=(-dt/tau).exp(); let lin = 1.0-(tau/dt)*(1.0-q); z[c]*q + m[c]*lin + mprev[c]*(1.0-q-lin) }, _ => relax(z[c], mprev[c], m[c], dt, mv) }; }
                        mprev = m;
                        out.push(match variant { 4 => [m[0] - a * z[0], m[1] - a * z[1]], 5 => [m[0] + a * (m[0] - z[0]), m[1] + a * (m[1] - z[1])], _ => [m[0] + a * z[0], m[1] + a * z[1]] });
                    }
                    let cols = vec![one.clone(), out.iter().map(|m| m[0]).collect(), out.iter().map(|m| m[1]).collect::<Vec<_>>()];
                    fit(&rows, &cols, noise, &format!("creep variant {variant}"));
                    size(&base, &|i| { let a = km(out[i]); let r = &rows[i]; let b = km(m_at(&t0, r, r.x)); [a[0] - b[0], a[1] - b[1]] }, "creep");
                } }
            "groove-friction" | "pair" => {
                let dk = if ef["temperature-mismatch"].is_null() { [0.0; 2] } else { [ef["temperature-mismatch"][0].as_f64().unwrap(), ef["temperature-mismatch"][1].as_f64().unwrap()] };
                for variant in 0..2 {
                let mut grip = Grip::default(); let mut out: Vec<[f64; 2]> = vec![]; let mut last = 0.0; let mut stuck = 0;
                for i in 0..n { let r = &rows[i]; if r.rest { grip = Grip::default(); last = 0.0; out.push([0.0; 2]); continue; }
                    let t = &t0[find(&t0, r.tr)].1; let mut mm = ([0.0; 2], 0.0);
                    if variant == 0 { for q in 1..=20 { mm = grip.step(t, last + (r.x - last) * q as f64 / 20.0, mu); } if mm.1.abs() < mu * 0.999 { stuck += 1; } } else { let v = t.at(r.x, mu * r.dir); mm.0 = [v[0], v[1]]; }
                    last = r.x; out.push(mm.0); }
                let mut cols = vec![one.clone(), out.iter().map(|m| m[0]).collect(), out.iter().map(|m| m[1]).collect::<Vec<_>>()];
                if dk[0] != 0.0 { cols.push(rows.iter().map(|r| r.temp).collect()); }
                println!("  variant {variant} stuck {stuck}");
                fit(&rows, &cols, noise, "friction");
                size(&base, &|i| { let r = &rows[i]; let a = km(out[i]); let b = km(m_at(&t0, r, r.x)); [a[0] - b[0] + dk[0] * r.temp, a[1] - b[1] + dk[1] * r.temp] }, "fric");
                } }
            _ => {}
        }
    }
}
