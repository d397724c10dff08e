//! Opens the sample pages in a real browser: no console message, every section laid out, nothing
//! wider than a phone.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

#[path = "../examples/sample/data.rs"]
mod data;
mod headless;
#[path = "../../../tests/support/not_run.rs"]
mod not_run;

use std::fs;
use wcal_report::{ShapePair, ShapePicture, ShapesInput, render, render_index, render_shapes};

/// A pair whose names would break a careless page.
fn shapes() -> ShapesInput {
    let picture = ShapePicture {
        size_px: [1280, 960],
        curve: vec![[10.0, 10.0], [500.0, 300.0]],
        ..ShapePicture::default()
    };
    ShapesInput {
        title: "Scene".into(),
        simulated: true,
        pairs: vec![ShapePair {
            name: "t1 </script> & more".into(),
            pictures: vec![picture.clone(), picture],
            residuals: [vec![[1.0, 0.1], [50.0, -0.1]], vec![[2.0, -0.1]]],
            centreline_mm: vec![[0.0, 0.0, 0.0], [10.0, 0.0, 0.5], [20.0, 1.0, 3.0]],
            groove_mm: Some([10.0, 0.0, 0.5]),
            ..ShapePair::default()
        }],
        ..ShapesInput::default()
    }
}

#[test]
fn pages_load_without_a_word_on_the_console() {
    let Some(browser) = headless::browser() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let samples = data::all();
    let page = render(&samples[0]);
    let reports: Vec<_> = samples
        .into_iter()
        .map(|i| ("report.html".into(), i))
        .collect();
    let pages = [
        ("report.html", page),
        ("index.html", render_index("Index", &[], &reports)),
        ("shapes.html", render_shapes(&shapes())),
    ];
    for (name, page) in pages {
        let path = folder.path().join(name);
        fs::write(&path, &page).unwrap();
        let visit = headless::visit(&browser, &path, 1280);
        assert!(visit.console.is_empty(), "{name}: {:?}", visit.console);
        let sections = |text: &str| text.matches("<section ").count();
        assert_eq!(
            sections(&visit.dom),
            sections(&page),
            "{name}: the browser sees other sections"
        );
    }
}

#[test]
fn a_page_with_a_console_error_is_noticed() {
    let Some(browser) = headless::browser() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.html");
    let bad = "<script>console.error('told'); nosuch()</script></main>";
    fs::write(&path, render(&data::transducer()).replace("</main>", bad)).unwrap();
    let console = headless::visit(&browser, &path, 1280).console;
    assert!(
        console.iter().any(|line| line.contains("told")),
        "{console:?}"
    );
    assert!(
        console
            .iter()
            .any(|line| line.contains("nosuch is not defined")),
        "{console:?}"
    );
}

#[test]
fn nothing_is_wider_than_a_phone() {
    let Some(browser) = headless::browser() else {
        return;
    };
    let page = render(&data::whisker());
    let reports = [("report.html".into(), data::whisker())];
    for page in [
        &page,
        &render_index("Index", &[], &reports),
        &render_shapes(&shapes()),
    ] {
        assert!(headless::content_width(&browser, page, 400) <= 400);
    }
    let wide = page.replace("<main>", "<main><div style=\"width:900px\">wide</div>");
    assert!(
        headless::content_width(&browser, &wide, 400) > 800,
        "a wide page must be noticed"
    );
}
