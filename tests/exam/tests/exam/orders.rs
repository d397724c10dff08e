//! What an exam draws: every effect, noise, layout and wire, the same each time.

use wcal_exam::orders::{Drawn, MIXES};
use wcal_exam::{Order, orders};
use wcal_plant::{CaseKind, Design, Noise, Request, ScalarNoise, ScalarRequest};

#[test]
fn orders_cover_the_catalogue_and_repeat() {
    let all = orders("single", 66, 4, None, false);
    assert_eq!(all, orders("single", 66, 4, None, false));
    let mut names: Vec<&str> = all
        .iter()
        .filter_map(|o| match o {
            Order::Whisker(
                Request {
                    want: CaseKind::Effects(k),
                    ..
                },
                ..,
            ) => Some(k[0].name().0),
            _ => None,
        })
        .collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 16);
    let only = orders("single", 5, 4, Some("creep"), false);
    assert!(only.iter().all(|o| matches!(
        o,
        Order::Whisker(Request { want: CaseKind::Effects(k), .. }, ..) if k.len() == 1 && k[0].name().0 == "creep"
    )));
}

#[test]
fn mixes_go_through_all_kinds_layouts_and_wires() {
    let mut noises = std::collections::BTreeSet::new();
    let mut designs = std::collections::BTreeSet::new();
    let mut wires = std::collections::BTreeSet::new();
    for order in orders("noise-null", 66, 5, None, false) {
        let Order::Whisker(request, noise, make) = order else {
            panic!("a whisker's order")
        };
        assert_eq!(request.want, CaseKind::Null);
        noises.insert(noise.name());
        designs.insert(format!("{:?}", request.design));
        wires.insert(format!("{make:?}"));
    }
    assert_eq!((noises.len(), designs.len(), wires.len()), (11, 5, 2));
    for order in orders("noise-single", 66, 5, None, false) {
        let Order::Whisker(
            Request {
                want: CaseKind::Effects(kinds),
                design,
                ..
            },
            noise,
            _,
        ) = order
        else {
            panic!("an effect")
        };
        assert!(kinds.len() == 1 && !kinds[0].is_unknown() && design != Design::Paper);
        let gross = matches!(noise, Noise::OneGross | Noise::TwoGross);
        assert!(!(gross && kinds[0] == wcal_plant::Kind::SlipOutliers));
    }
    let lines = |mix: &str| -> Vec<ScalarRequest> {
        orders(mix, 20, 5, None, false)
            .into_iter()
            .map(|o| match o {
                Order::Scalar(request) => request,
                Order::Whisker(..) | Order::PictureSetup(..) => panic!("a line's order"),
            })
            .collect()
    };
    let nulls = lines("scalar-null");
    assert!(nulls.iter().all(|r| r.effect.is_none()) && nulls.iter().any(|r| r.axis));
    assert!(
        ScalarNoise::ALL
            .iter()
            .all(|n| nulls.iter().any(|r| r.noise == *n))
    );
    assert!(lines("scalar-single").iter().all(|r| r.effect.is_some()));
    let all = orders("all", 30, 5, None, false);
    assert!(all.iter().any(|o| matches!(o, Order::Scalar(_))));
    assert!(
        all.iter()
            .any(|o| matches!(o, Order::Whisker(_, n, _) if *n != Noise::Gaussian))
    );
    // A drawn order tells its truth.
    assert!(MIXES.contains(&"noise-null"));
    let Drawn::Scalar(case) = Order::Scalar(nulls[0]).draw().unwrap() else {
        panic!("a line")
    };
    assert_eq!(Drawn::Scalar(case).truth().unwrap()["label"], "null");
}
