//! Tags of the three photographs (measured), corners refined, against AprilTag's own search at half
//! size, in one run on one core.
#![allow(clippy::expect_used, clippy::print_stdout, reason = "a measurement")]
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::path::Path;
use wcal_vision::picture::Picture;
use wcal_vision::tags::detection::{Search, detect_tags, find_tags};

const FAMILY: &str = "tag36h11";

fn bench(c: &mut Criterion) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/apriltag_images");
    let pictures = [
        "33369213973_9d9bb4cc96_c",
        "34085369442_304b6bafd9_c",
        "34139872896_defdb2f8d9_c",
    ]
    .map(|name| Picture::read(&folder.join(format!("{name}.jpg"))).expect("photograph"));
    let ours = |search| {
        let found = pictures.iter().map(|p| {
            find_tags(black_box(p), FAMILY, None, search)
                .expect("tags")
                .len()
        });
        found.sum::<usize>()
    };
    let quads = |search| -> usize {
        pictures
            .iter()
            .map(|p| {
                detect_tags(black_box(p), FAMILY, search)
                    .expect("tags")
                    .len()
            })
            .sum()
    };
    // Turn by turn, so that what else the machine does falls on both.
    let time = |work: &dyn Fn() -> usize| {
        let start = std::time::Instant::now();
        black_box(work());
        1e3 * start.elapsed().as_secs_f64()
    };
    let works: [&dyn Fn() -> usize; 3] = [
        &|| quads(Search::Halved),
        &|| quads(Search::StrongContrast),
        &|| ours(Search::StrongContrast),
    ];
    let mut times: Vec<[f64; 3]> = (0..101).map(|_| works.map(time)).collect();
    let medians = [0, 1, 2].map(|k| {
        times.sort_by(|a, b| a[k].total_cmp(&b[k]));
        times[times.len() / 2][k]
    });
    println!("three photographs, 47 tags listed, goal: 46 found, ratio 1");
    for (k, name) in [
        "AprilTag at half size",
        "found where contrast is strong",
        "found, corners refined",
    ]
    .iter()
    .enumerate()
    {
        println!(
            "  {name}: {} in {:.1} ms, ratio {:.2}",
            works[k](),
            medians[k],
            medians[k] / medians[0]
        );
    }
    let mut group = c.benchmark_group("tags");
    group.bench_function("strong_contrast", |b| {
        b.iter(|| ours(Search::StrongContrast))
    });
    group.bench_function("whole", |b| b.iter(|| ours(Search::Whole)));
    group.bench_function("library_half_size", |b| b.iter(|| quads(Search::Halved)));
    group.bench_function("library_full_size", |b| b.iter(|| quads(Search::Whole)));
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
