//! Shards (SIMULATED): the same whatever the threads, taken up where they stopped, damaged ones made again; meshes refused by name.

use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::WhiskerSpec;
use wcal_sim::recipe::check_one_dataset;
use wcal_sim::{Dataset, Mesh, SweepPlan, objects, shard};

fn dataset(seed: u64) -> Dataset {
    Dataset {
        engine: std::sync::Arc::new(wcal_sim::RodSweeps),
        whisker: WhiskerSpec::nominal(),
        plan: SweepPlan { max_travel_mm: 40.0, rate_hz: 2.0, ..SweepPlan::default() },
        objects: ["can", "wedge"].map(|n| objects::built_in(n).unwrap()).to_vec(),
        sweeps: 27,
        seed,
        share: [0, 1],
    }
}

/// Every table's bytes.
fn tables(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = std::fs::read_dir(folder).unwrap().map(|f| f.unwrap().path());
    let tables = files.filter(|f| f.extension().is_some_and(|e| e == "parquet"));
    tables
        .map(|f| (f.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&f).unwrap()))
        .collect()
}

#[test]
fn shards_do_not_depend_on_threads_or_shares_and_go_on_where_they_stopped() {
    let [one, shared] = [0; 2].map(|_| tempfile::tempdir().unwrap());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let first = pool.install(|| dataset(1).make(one.path(), |_, _| {}).unwrap());
    assert_eq!(first["can"].sweeps, 27);
    for share in 0..3 {
        Dataset { share: [share, 3], ..dataset(1) }.make(shared.path(), |_, _| {}).unwrap();
    }
    let whole = tables(one.path());
    assert_eq!(whole.len(), 12, "two blocks of two objects, three tables each");
    assert!(whole == tables(shared.path()));
    // A damaged table is made again, what is whole is not.
    std::fs::write(one.path().join("can-000025.samples.parquet"), b"PAR1").unwrap();
    let again = dataset(1).make(one.path(), |_, _| {}).unwrap();
    assert_eq!([again["can"].made, again["wedge"].made], [2, 0]);
    assert!(whole == tables(one.path()));
    // Negative control: another seed is another dataset.
    let other = tempfile::tempdir().unwrap();
    dataset(2).make(other.path(), |_, _| {}).unwrap();
    assert!(whole != tables(other.path()));
}

/// One folder, one dataset: what differs is named, and nothing is replaced.
#[test]
fn a_folder_takes_no_other_dataset() {
    let folder = tempfile::tempdir().unwrap();
    let own = Dataset { sweeps: 2, ..dataset(1) };
    own.make(folder.path(), |_, _| {}).unwrap();
    let before = tables(folder.path());
    let refused = |other: Dataset| other.make(folder.path(), |_, _| {}).unwrap_err().to_string();
    let plan = SweepPlan { rate_hz: 3.0, ..own.plan.clone() };
    let whisker = WhiskerSpec { youngs_gpa: 60.0, ..WhiskerSpec::nominal() };
    let objects = |names: &[&str]| names.iter().map(|n| objects::built_in(n).unwrap()).collect::<Vec<_>>();
    let mut renamed = objects::built_in("ball").unwrap();
    renamed.name = "wedge".to_owned();
    for (other, words) in [
        (Dataset { seed: 2, ..own.clone() }, ["seed: there 1, asked for 2", "use another folder"]),
        (Dataset { plan, ..own.clone() }, ["plan.rate_hz: there 2.0, asked for 3.0", "expected one dataset"]),
        (Dataset { whisker, ..own.clone() }, ["whisker.youngs_gpa: there 75.0", "asked for 60.0"]),
        (Dataset { objects: objects(&["can"]), ..own.clone() }, ["object wedge: there, not asked for", ""]),
        (
            Dataset { objects: objects(&["can", "wedge", "ball"]), ..own.clone() },
            ["object ball: not there", ""],
        ),
        (
            Dataset { objects: [objects(&["can"]), vec![renamed]].concat(), ..own.clone() },
            ["object wedge: there with another mesh", ""],
        ),
    ] {
        let error = refused(other);
        assert!(words.iter().all(|w| error.contains(w)), "{words:?}: {error}");
    }
    assert!(before == tables(folder.path()), "nothing was replaced");
    // A folder from before there was a recipe: its shards say as much as they can.
    std::fs::remove_file(folder.path().join("recipe.json")).unwrap();
    let error = refused(Dataset { seed: 2, ..own.clone() });
    assert!(error.contains("shard can-000000: made from another wire"), "{error}");
    // A recipe of the format before holds Debug text, which nothing compares: refused by name, with what to do, and still read.
    own.make(folder.path(), |_, _| {}).unwrap();
    let recipe = folder.path().join("recipe.json");
    let now = std::fs::read_to_string(&recipe).unwrap();
    let mut earlier: serde_json::Value = serde_json::from_str(&now).unwrap();
    earlier["format"] = "wcal-sweep-recipe/1".into();
    earlier["engine"] = "rod, 40 links".into();
    earlier["whisker"] = "WhiskerSpec { diameter_mm: 0.3 }".into();
    std::fs::write(&recipe, earlier.to_string()).unwrap();
    let error = refused(own.clone());
    assert!(error.contains("found wcal-sweep-recipe/1") && error.contains("in another folder"), "{error}");
    check_one_dataset(folder.path()).unwrap();
    std::fs::write(&recipe, now).unwrap();
    // Control: the same dataset goes on, and may grow.
    own.make(folder.path(), |_, _| {}).unwrap();
    let grown = Dataset { sweeps: 3, ..own.clone() }.make(folder.path(), |_, _| {}).unwrap();
    assert_eq!(grown["can"].sweeps, 3);
    // What a mixture was made of is named by whoever trains on it.
    check_one_dataset(folder.path()).unwrap();
    let other = tempfile::tempdir().unwrap();
    Dataset { seed: 2, ..own }.make(other.path(), |_, _| {}).unwrap();
    for file in std::fs::read_dir(other.path()).unwrap().map(|f| f.unwrap().path()) {
        let name = file.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("can-") {
            std::fs::copy(&file, folder.path().join(name)).unwrap();
        }
    }
    let error = check_one_dataset(folder.path()).unwrap_err().to_string();
    assert!(error.contains("shard can-000000") && !error.contains("wedge"), "{error}");
}

#[test]
fn a_wrong_byte_is_found_by_the_checksum() {
    let folder = tempfile::tempdir().unwrap();
    let make = |seed| {
        let totals = Dataset { sweeps: 2, ..dataset(seed) }.make(folder.path(), |_, _| {}).unwrap();
        totals.into_values().flat_map(|t| t.again).collect::<Vec<_>>().join("; ")
    };
    assert_eq!(make(1), "", "the first run makes nothing again");
    let manifest = shard::read_manifest(&folder.path().join("can-000000.json")).unwrap();
    assert!(manifest.simulated && shard::check(folder.path(), &manifest).is_ok());
    let table = folder.path().join("can-000000.samples.parquet");
    let mut bytes = std::fs::read(&table).unwrap();
    bytes[100] ^= 1;
    std::fs::write(&table, bytes).unwrap();
    let error = shard::check(folder.path(), &manifest).unwrap_err().to_string();
    assert!(error.contains("can-000000.samples.parquet") && error.contains("SHA-256"), "{error}");
    // It is made again, and that is said.
    let said = make(1);
    assert!(said.starts_with("can-000000: ") && said.contains("SHA-256"), "{said}");
    assert!(shard::check(folder.path(), &manifest).is_ok() && make(1).is_empty());
}

fn stl(path: &Path, corners: &[[f32; 3]], triangles: &[[usize; 3]]) {
    let triangles: Vec<stl_io::Triangle> = triangles
        .iter()
        .map(|t| stl_io::Triangle {
            normal: stl_io::Normal::new([0.0; 3]),
            vertices: t.map(|k| stl_io::Vertex::new(corners[k])),
        })
        .collect();
    stl_io::write_stl(&mut std::fs::File::create(path).unwrap(), triangles.iter()).unwrap();
}

#[test]
fn meshes_are_refused_or_noted_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let tetra = |s: f32| [[0.0; 3], [s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]];
    let closed = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    stl(&place("metres.stl"), &tetra(0.05), &closed);
    let metres = Mesh::read(&place("metres.stl")).unwrap();
    assert!(metres.notes.iter().any(|n| n.contains("metres")), "{:?}", metres.notes);
    assert!((metres.high_mm.x - 50.0).abs() < 1e-4);
    stl(&place("open.stl"), &tetra(50.0), &closed[..3]);
    let open = Mesh::read(&place("open.stl")).unwrap();
    assert!(open.notes.iter().any(|n| n.contains("3 open edges")), "{:?}", open.notes);
    let crowded: Vec<[usize; 3]> = closed.iter().copied().chain([[0, 1, 4]]).collect();
    let fin: Vec<[f32; 3]> = tetra(50.0).into_iter().chain([[20.0, -20.0, -20.0]]).collect();
    stl(&place("fin.stl"), &fin, &crowded);
    let fin = Mesh::read(&place("fin.stl")).unwrap();
    assert!(fin.notes.iter().any(|n| n.contains("1 edges of more than two")), "{:?}", fin.notes);
    let mut turned = closed;
    turned[3].swap(1, 2);
    stl(&place("turned.stl"), &tetra(50.0), &turned);
    let notes = Mesh::read(&place("turned.stl")).unwrap().notes;
    assert!(notes.iter().any(|n| n.contains("3 edges whose triangles disagree")), "{notes:?}");
    stl(&place("inward.stl"), &tetra(50.0), &closed.map(|[a, b, c]| [a, c, b]));
    let inward = Mesh::read(&place("inward.stl")).unwrap();
    assert!(inward.notes.iter().any(|n| n.contains("pointed inward")), "{:?}", inward.notes);
    assert!(inward.closest_point(&Vector3::repeat(5.0), 50.0).unwrap().distance_mm < 0.0);
    // Negative control: nothing is remarkable about a closed mesh in millimetres.
    stl(&place("good.stl"), &tetra(50.0), &closed);
    assert!(Mesh::read(&place("good.stl")).unwrap().notes.is_empty());
    stl(&place("empty.stl"), &[], &[]);
    stl(&place("huge.stl"), &tetra(5000.0), &closed);
    stl(&place("flat.stl"), &tetra(50.0), &[[0, 1, 1]]);
    std::fs::write(place("cut.stl"), vec![0_u8; 90]).unwrap();
    for (name, word) in [
        ("empty", "expected 1 to 1,000,000 triangles, found 0"),
        ("huge", "expected a longest side of 3 to 2000 mm, found 5000"),
        ("flat", "expected triangles with an area, found none"),
        ("missing", "missing.stl"),
    ] {
        let error = Mesh::read(&place(&format!("{name}.stl"))).unwrap_err().to_string();
        assert!(error.contains(word), "{name}: {error}");
    }
    let nan = Mesh::new("nan", &[Vector3::repeat(f64::NAN); 3], &[[0, 1, 2]]).unwrap_err().to_string();
    assert!(nan.contains("object nan: expected finite corners"), "{nan}");
}

/// Corners and triangles of a box; `inward`: its normals point into it.
fn slab(half_mm: [f64; 3], inward: bool) -> (Vec<Vector3<f64>>, Vec<[u32; 3]>) {
    let corner =
        |k: u32| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { half_mm[axis] } else { -half_mm[axis] });
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let halves = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    let turned = halves.map(|[a, b, c]| if inward { [a, c, b] } else { [a, b, c] });
    ((0..8).map(corner).collect(), turned.collect())
}

#[allow(clippy::type_complexity, reason = "used once")]
fn together(name: &str, slabs: &[(Vec<Vector3<f64>>, Vec<[u32; 3]>)]) -> Mesh {
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (more, faces) in slabs {
        let first = points.len() as u32;
        points.extend(more);
        triangles.extend(faces.iter().map(|t| t.map(|k| k + first)));
    }
    Mesh::new(name, &points, &triangles).unwrap()
}

/// Two bars cross without a corner in each other: the faces of one that lie within the other are no surface.
#[test]
fn bodies_that_overlap_are_one_body() {
    let [long, across] = [[30.0, 4.0, 4.0], [5.0, 30.0, 3.0]];
    let cross = together("cross", &[slab(long, false), slab(across, false)]);
    assert!(cross.notes.is_empty(), "{:?}", cross.notes);
    let outside = |half: [f64; 3], p: &Vector3<f64>| {
        let off = Vector3::from_fn(|k, _| p[k].abs() - half[k]);
        off.sup(&Vector3::zeros()).norm() + off.max().min(0.0)
    };
    // On a lattice that meets no face.
    let lattice = |k: i32| f64::from(k) * 0.93 + 0.41;
    let (mut hidden, mut checked) = (0, 0);
    for (x, y, z) in (-12..12).flat_map(|x| (-12..12).flat_map(move |y| (-6..6).map(move |z| (x, y, z)))) {
        let p = Vector3::new(lattice(x), lattice(y), lattice(z));
        let near = cross.closest_point(&p, 100.0).unwrap();
        let known = outside(long, &p).min(outside(across, &p));
        assert_eq!(near.distance_mm < 0.0, known < 0.0, "{p} {near:?}");
        if known > 0.0 {
            assert!((near.distance_mm - known).abs() < 1e-9, "{p} {near:?} {known}");
        }
        // Nearer to a face of the other bar than to the bar's own: there the nearest face alone says "outside".
        let [a, b] = [outside(long, &p), outside(across, &p)];
        hidden += usize::from((a < 0.0) != (b < 0.0) && a.max(b) < -a.min(b));
        checked += 1;
    }
    assert!(hidden > 50 && checked > 1000, "negative control: {hidden} of {checked} would be mistaken");
    // A cavity stays one, and two bodies with one are doubtful.
    let hollow = together("hollow", &[slab([20.0; 3], false), slab([10.0; 3], true)]);
    assert!(
        hollow.notes.is_empty() && hollow.closest_point(&Vector3::zeros(), 50.0).unwrap().distance_mm > 9.9
    );
    let doubtful =
        together("doubtful", &[slab([20.0; 3], false), slab([10.0; 3], true), slab([30.0, 2.0, 2.0], false)]);
    assert!(
        doubtful.notes.iter().any(|n| n.contains("2 closed bodies and 1 cavities")),
        "{:?}",
        doubtful.notes
    );
}
