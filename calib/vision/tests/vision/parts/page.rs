//! The report page.

use wcal_vision::page::page;
use wcal_vision::shapes_document::{PairDocument, ShapesDocument};

#[test]
fn a_page_is_self_contained_and_names_do_not_break_it() {
    let pair = PairDocument {
        name: "</script><b>".into(),
        status: "rejected".into(),
        why: "no <wire>".into(),
        ..PairDocument::default()
    };
    let good = PairDocument {
        name: "t1".into(),
        status: "ok".into(),
        centreline_mm: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.5]],
        ..PairDocument::default()
    };
    let html = page(&ShapesDocument { pairs: vec![pair, good], ..ShapesDocument::default() }, &[]);
    assert!(
        html.contains("1 of 2 pairs") && html.contains("no &lt;wire&gt;") && html.contains("[1.0,0.0,0.5]")
    );
    assert_eq!(html.matches("</script>").count(), 1);
    assert!(!html.contains("://"), "nothing is loaded from elsewhere");
}
