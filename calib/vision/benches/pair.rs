//! A pair of pictures of the bench (ray-traced, simulated) on one core: reading apart from
//! everything else, at 1280x960 and halved.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a measurement")]
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::{Path, PathBuf};
use wcal_vision::calibrate::board::{Board, Pattern};
use wcal_vision::calibrate::chessboard::BoardSize;
use wcal_vision::calibrate::folders::calibrate_folders;
use wcal_vision::camera::OPENCV5;
use wcal_vision::pairs::PairFiles;
use wcal_vision::picture::Picture;
use wcal_vision::rig::Rig;
use wcal_vision::shape::folder::shapes_of_pairs;
use wcal_vision::stereo::StereoCameras;

/// The picture halved (means of 2x2 pixels) until it is no wider than `width_px`.
fn reduced(picture: &Picture, width_px: usize) -> Picture {
    let mut small = picture.clone();
    while small.width > width_px && small.height > 1 {
        let (width, height) = (small.width / 2, small.height / 2);
        let mean = |k: usize| {
            let at = 2 * (k / width) * small.width + 2 * (k % width);
            let below = at + small.width;
            let sum: u16 = [at, at + 1, below, below + 1]
                .map(|p| u16::from(small.data[p]))
                .iter()
                .sum();
            ((sum + 2) / 4) as u8
        };
        small = Picture {
            width,
            height,
            data: (0..width * height).map(mean).collect(),
        };
    }
    small
}

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../fixtures/stereo_bench")
        .join(name)
}

fn cameras() -> StereoCameras {
    let board = Board {
        size: BoardSize {
            columns: 9,
            rows: 6,
        },
        square_mm: 6.0,
        pattern: Pattern::Chessboard,
    };
    let side = |s: &str| fixture(&format!("board/{s}")).display().to_string();
    let (document, _) =
        calibrate_folders(&side("left"), &side("right"), &board, OPENCV5, &|_| {}).expect("board");
    document.stereo_cameras().expect("cameras")
}

/// Cameras of pictures halved once: pixel centres lie at integers.
fn halved(stereo: &StereoCameras) -> StereoCameras {
    let mut small = stereo.clone();
    for c in &mut small.cameras {
        c.image_size_px = c.image_size_px.map(|n| n / 2);
        c.focal_px = c.focal_px.map(|f| 0.5 * f);
        c.centre_px = c.centre_px.map(|v| 0.5 * v - 0.25);
    }
    small
}

fn write_pgm(path: &Path, picture: &Picture) {
    let mut bytes = format!("P5\n{} {}\n255\n", picture.width, picture.height).into_bytes();
    bytes.extend(&picture.data);
    std::fs::write(path, bytes).expect("a folder to write to");
}

fn bench(c: &mut Criterion) {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global()
        .expect("one pool");
    let rig = Rig::read(&fixture("rig.toml")).expect("rig");
    let stereo = cameras();
    let paths = ["left", "right"].map(|side| fixture(&format!("scene/{side}/t1.png")));
    let files = |[left, right]: [PathBuf; 2]| {
        vec![PairFiles {
            name: "t1".into(),
            left: Some(left),
            right: Some(right),
            ..PairFiles::default()
        }]
    };
    let place = tempfile::tempdir().expect("a folder");
    let small = ["left", "right"].map(|side| place.path().join(format!("{side}.pgm")));
    for (from, to) in paths.iter().zip(&small) {
        write_pgm(to, &reduced(&Picture::read(from).expect("picture"), 640));
    }
    let mut group = c.benchmark_group("pair");
    group.sample_size(10);
    group.bench_function("read_1280x960", |b| {
        b.iter(|| {
            paths
                .iter()
                .map(|p| Picture::read(black_box(p)).expect("picture").data.len())
                .sum::<usize>()
        });
    });
    let full = files(paths.clone());
    group.bench_function("read_and_shape_1280x960", |b| {
        b.iter(|| {
            shapes_of_pairs(black_box(&stereo), &rig, &full, &|_| {})
                .fits
                .len()
        });
    });
    let (half, small) = (halved(&stereo), files(small));
    let first = shapes_of_pairs(&half, &rig, &small, &|_| {});
    assert_eq!(first.document.pairs[0].status, "ok");
    group.bench_function("read_and_shape_640x480", |b| {
        b.iter(|| {
            shapes_of_pairs(black_box(&half), &rig, &small, &|_| {})
                .fits
                .len()
        });
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
