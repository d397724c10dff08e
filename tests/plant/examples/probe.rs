fn main() {
    let a: Vec<String> = std::env::args().collect();
    let n: usize = a[2].parse().unwrap();
    let dir = std::path::Path::new(&a[3]);
    let mut truth = serde_json::Map::new();
    for (i, o) in wcal_plant::session::orders(&a[1], n, 11, a.get(4).map(|s| s.as_str()), true).iter().enumerate() {
        let t0 = std::time::Instant::now();
        match wcal_plant::draw(o) {
            Ok(c) => { let name = format!("case-{:03}", i + 1); c.write(&dir.join(&name)).unwrap();
                println!("{name} {:?} {:?} size {} target {} reached {} {:.2} s {}", o.design, o.want, c.truth.projected_size_in_noises, c.truth.target_sigma, c.truth.target_reached, t0.elapsed().as_secs_f64(), serde_json::to_string(&c.truth.effects).unwrap());
                truth.insert(name, serde_json::to_value(&c.truth).unwrap()); }
            Err(e) => println!("{:?} {e}", o),
        }
    }
    std::fs::write(dir.join("truth.json"), serde_json::to_string_pretty(&truth).unwrap()).unwrap();
}
