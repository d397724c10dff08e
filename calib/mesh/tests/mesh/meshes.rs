//! Meshes that are refused or noted by name, and bodies that overlap.

use nalgebra::Vector3;
use std::path::Path;
use wcal_mesh::Mesh;

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
    assert!(
        metres.notes.iter().any(|n| n.contains("metres")),
        "{:?}",
        metres.notes
    );
    assert!((metres.high_mm.x - 50.0).abs() < 1e-4);
    stl(&place("open.stl"), &tetra(50.0), &closed[..3]);
    let open = Mesh::read(&place("open.stl")).unwrap();
    assert!(
        open.notes.iter().any(|n| n.contains("3 open edges")),
        "{:?}",
        open.notes
    );
    let crowded: Vec<[usize; 3]> = closed.iter().copied().chain([[0, 1, 4]]).collect();
    let fin: Vec<[f32; 3]> = tetra(50.0)
        .into_iter()
        .chain([[20.0, -20.0, -20.0]])
        .collect();
    stl(&place("fin.stl"), &fin, &crowded);
    let fin = Mesh::read(&place("fin.stl")).unwrap();
    assert!(
        fin.notes
            .iter()
            .any(|n| n.contains("1 edges of more than two")),
        "{:?}",
        fin.notes
    );
    let mut turned = closed;
    turned[3].swap(1, 2);
    stl(&place("turned.stl"), &tetra(50.0), &turned);
    let notes = Mesh::read(&place("turned.stl")).unwrap().notes;
    assert!(
        notes
            .iter()
            .any(|n| n.contains("3 edges whose triangles disagree")),
        "{notes:?}"
    );
    stl(
        &place("inward.stl"),
        &tetra(50.0),
        &closed.map(|[a, b, c]| [a, c, b]),
    );
    let inward = Mesh::read(&place("inward.stl")).unwrap();
    assert!(
        inward.notes.iter().any(|n| n.contains("pointed inward")),
        "{:?}",
        inward.notes
    );
    assert!(
        inward
            .closest_point(&Vector3::repeat(5.0), 50.0)
            .unwrap()
            .distance_mm
            < 0.0
    );
    // Negative control: nothing is remarkable about a closed mesh in millimetres.
    stl(&place("good.stl"), &tetra(50.0), &closed);
    assert!(Mesh::read(&place("good.stl")).unwrap().notes.is_empty());
    stl(&place("empty.stl"), &[], &[]);
    stl(&place("huge.stl"), &tetra(5000.0), &closed);
    stl(&place("flat.stl"), &tetra(50.0), &[[0, 1, 1]]);
    std::fs::write(place("cut.stl"), vec![0_u8; 90]).unwrap();
    for (name, word) in [
        ("empty", "expected 1 to 1,000,000 triangles, found 0"),
        (
            "huge",
            "expected a longest side of 3 to 2000 mm, found 5000",
        ),
        ("flat", "expected triangles with an area, found none"),
        ("missing", "missing.stl"),
    ] {
        let error = Mesh::read(&place(&format!("{name}.stl")))
            .unwrap_err()
            .to_string();
        assert!(error.contains(word), "{name}: {error}");
    }
    for (bytes, form) in [
        (
            &b"# ball\no ball\nv 12.0 0.0 0.0\nv -12.0 0.0 0.0\nf 1 2 3\n"[..],
            "OBJ",
        ),
        (&b"ply\nformat ascii 1.0\nelement vertex 8\n"[..], "PLY"),
        (&[0x1f, 0x8b, 8, 0].repeat(30)[..], "gzip file"),
        (
            &b"glTF\x02\x00\x00\x00"[..],
            "glTF (save it as STL, OBJ or PLY)",
        ),
    ] {
        std::fs::write(place("other.stl"), bytes).unwrap();
        let error = Mesh::read(&place("other.stl")).unwrap_err().to_string();
        assert!(error.contains(form), "{error}");
    }
    let nan = Mesh::new("nan", &[Vector3::repeat(f64::NAN); 3], &[[0, 1, 2]])
        .unwrap_err()
        .to_string();
    assert!(nan.contains("object nan: expected finite corners"), "{nan}");
}

/// Corners and triangles of a box; `inward`: its normals point into it.
fn slab(half_mm: [f64; 3], inward: bool) -> (Vec<Vector3<f64>>, Vec<[u32; 3]>) {
    let corner = |k: u32| {
        Vector3::from_fn(|axis, _| {
            if k >> axis & 1 == 1 {
                half_mm[axis]
            } else {
                -half_mm[axis]
            }
        })
    };
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let halves = faces
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
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

/// Two bars cross without a corner in each other: the faces of one that lie within the other are no
/// surface.
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
    for (x, y, z) in
        (-12..12).flat_map(|x| (-12..12).flat_map(move |y| (-6..6).map(move |z| (x, y, z))))
    {
        let p = Vector3::new(lattice(x), lattice(y), lattice(z));
        let near = cross.closest_point(&p, 100.0).unwrap();
        let known = outside(long, &p).min(outside(across, &p));
        assert_eq!(near.distance_mm < 0.0, known < 0.0, "{p} {near:?}");
        if known > 0.0 {
            assert!(
                (near.distance_mm - known).abs() < 1e-9,
                "{p} {near:?} {known}"
            );
        }
        // Nearer to a face of the other bar than to the bar's own: there the nearest face alone
        // says "outside".
        let [a, b] = [outside(long, &p), outside(across, &p)];
        hidden += usize::from((a < 0.0) != (b < 0.0) && a.max(b) < -a.min(b));
        checked += 1;
    }
    assert!(
        hidden > 50 && checked > 1000,
        "negative control: {hidden} of {checked} would be mistaken"
    );
    // A cavity stays one, and two bodies with one are doubtful.
    let hollow = together("hollow", &[slab([20.0; 3], false), slab([10.0; 3], true)]);
    assert!(
        hollow.notes.is_empty()
            && hollow
                .closest_point(&Vector3::zeros(), 50.0)
                .unwrap()
                .distance_mm
                > 9.9
    );
    let doubtful = together(
        "doubtful",
        &[
            slab([20.0; 3], false),
            slab([10.0; 3], true),
            slab([30.0, 2.0, 2.0], false),
        ],
    );
    assert!(
        doubtful
            .notes
            .iter()
            .any(|n| n.contains("2 closed bodies and 1 cavities")),
        "{:?}",
        doubtful.notes
    );
}

#[test]
fn a_mesh_that_is_refused_names_its_path() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("bad.stl", "solid x\nendsolid x\n"),
        ("bad.obj", "v 0 0 0\nf 1 2 3\n"),
        ("bad.ply", "ply\nformat ascii 1.0\nend_header\n"),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = Mesh::read(&path).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains(&path.display().to_string()), "{error}");
    }
}
