//! Structure of the pages: well-formed, complete, escaped, free of NaN and of anything from
//! outside.

#[path = "../examples/sample/data.rs"]
mod data;

use quick_xml::Reader;
use quick_xml::events::Event;
use wcal_core::Provenance;
use wcal_core::verify_document::{
    HeldOutError, HoldoutOutcome, NoiseFloor, UnknownEffect, Verdict, WitnessTest,
};
use wcal_report::{
    Fact, ReportInput, ShapesInput, number, p_value, percent, render, render_index, render_shapes,
    with_interval,
};

/// Parses the page strictly; returns its text without tags, or what is wrong with it.
fn text_of(page: &str) -> Result<String, String> {
    let mut reader = Reader::from_str(page);
    let mut text = String::new();
    let mut ids = std::collections::HashSet::new();
    loop {
        match reader
            .read_event()
            .map_err(|e| format!("{e} at {}", reader.error_position()))?
        {
            Event::Eof => return Ok(text),
            Event::Start(tag) | Event::Empty(tag) => {
                for attribute in tag.attributes() {
                    let attribute = attribute.map_err(|e| e.to_string())?;
                    let value = attribute.value.clone().into_owned();
                    if attribute.key.as_ref() == "id" && !ids.insert(value.clone()) {
                        return Err(format!("id {value} occurs twice"));
                    }
                    quick_xml::escape::unescape(&value).map_err(|e| e.to_string())?;
                }
            }
            Event::Text(t) => text.push_str(&t),
            Event::GeneralRef(r) => {
                let entity = format!("&{};", &*r);
                text.push_str(&quick_xml::escape::unescape(&entity).map_err(|e| e.to_string())?);
            }
            _ => {}
        }
    }
}

fn bare(kind: &str) -> ReportInput {
    ReportInput::new(
        data::document("bare", kind, Verdict::Adequate),
        Provenance::default(),
    )
}

#[test]
fn every_sample_is_well_formed_and_needs_nothing_from_outside() {
    let samples = data::all();
    let mut pages: Vec<String> = samples.iter().map(render).collect();
    let reports: Vec<_> = samples.into_iter().map(|i| ("a.html".into(), i)).collect();
    pages.push(render_index("Index", &[], &reports));
    for page in &pages {
        text_of(page).unwrap();
        let outside = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
        for forbidden in [
            "http:", "https:", "src=", "<script", "@import", "url(", "NaN", ">inf", "infinity",
        ] {
            assert!(!outside.contains(forbidden), "{forbidden}");
        }
    }
}

#[test]
fn the_strict_parser_notices_a_broken_page() {
    let page = render(&bare("axis"));
    for broken in [
        page.replacen("</section>", "", 1),
        page.replacen("<p", "<p class=unquoted", 1),
        page.replacen("id=\"found\"", "id=\"noise\"", 1),
        page.replacen("</p>", "&nosuch;</p>", 1),
    ] {
        assert!(text_of(&broken).is_err());
    }
}

#[test]
fn every_section_is_there_and_the_contents_lead_to_it() {
    let page = render(&data::whisker());
    for id in [
        "before-after",
        "found",
        "twin",
        "residuals",
        "evidence",
        "detectable",
        "noise",
        "readings",
        "provenance",
    ] {
        assert!(page.contains(&format!("<section id=\"{id}\"")), "{id}");
        assert!(page.contains(&format!("href=\"#{id}\"")), "{id}");
    }
    assert_eq!(
        page.matches("<table>").count(),
        page.matches("<caption>").count()
    );
    // Where a table is wider than the page its box scrolls and shows it.
    assert_eq!(
        page.matches("<table>").count(),
        page.matches("<div class=\"scroll\"").count()
    );
    assert!(page.contains("background-attachment: local, local, scroll, scroll"));
    assert_eq!(
        page.matches("<svg ").count(),
        page.matches("<desc>").count()
    );
    assert!(
        page.find("Ambiguous").unwrap() < page.find("<section").unwrap(),
        "the verdict comes first"
    );
}

#[test]
fn pages_of_empty_sessions_leave_empty_sections_out() {
    for kind in ["whisker", "transducer", "axis", ""] {
        let page = render(&bare(kind));
        let text = text_of(&page).unwrap();
        for id in [
            "before-after",
            "twin",
            "residuals",
            "evidence",
            "detectable",
            "readings",
        ] {
            assert!(!page.contains(&format!("id=\"{id}\"")), "{kind}: {id}");
        }
        assert!(
            text.contains("Noise floor and remarks"),
            "{kind}: negative control"
        );
    }
}

#[test]
fn each_verdict_is_said_in_words() {
    use Verdict::{Adequate, Ambiguous, Effect, Refused, TwinFault, UnknownEffect};
    let words = [
        (Adequate, "Adequate"),
        (Effect, "Effect found"),
        (Ambiguous, "Ambiguous"),
        (UnknownEffect, "Unknown effect"),
        (TwinFault, "Twin fault"),
        (Refused, "Refused"),
    ];
    for (verdict, word) in words {
        let mut input = bare("axis");
        input.verify.verdict = verdict;
        assert!(text_of(&render(&input)).unwrap().contains(word));
    }
}

#[test]
fn every_number_of_the_result_shows_up() {
    let input = data::whisker();
    let text = text_of(&render(&input)).unwrap();
    let verify = &input.verify;
    let mut wanted = vec![
        percent(verify.coverage95.unwrap()),
        number(verify.noise_floor.wavelength_pm.unwrap()),
    ];
    let errors = [
        verify.before.as_ref().unwrap(),
        verify.after.as_ref().unwrap(),
        &input.further_errors[0].1,
    ];
    for error in errors {
        for (key, value) in &error.rmse {
            let (value, interval) = with_interval(*value, error.interval95[key]);
            wanted.extend([value, interval]);
        }
        wanted.extend(error.moment_rmse_nmm_each.unwrap().map(number));
        wanted.push(error.points.to_string());
    }
    for parameter in verify.effects.iter().flat_map(|e| &e.parameters) {
        let (value, interval) = with_interval(parameter.value, parameter.interval95);
        wanted.extend([value, interval]);
    }
    let next = verify.next_measurement.as_ref().unwrap();
    wanted.push(percent(next.expected_power));
    wanted.extend(
        next.poses
            .iter()
            .flat_map(|p| [number(p.stage_mm), number(p.speed_mm_s), number(p.dwell_s)]),
    );
    wanted.extend(
        verify
            .detectable
            .iter()
            .filter_map(|d| d.smallest.map(number)),
    );
    wanted.extend(
        verify
            .twin
            .faults
            .iter()
            .flat_map(|f| f.points.iter().map(i64::to_string)),
    );
    for row in &input.evidence {
        wanted.extend([
            number(row.chi2_gain),
            p_value(row.p_value),
            number(row.log_likelihood_ratio),
        ]);
    }
    for record in &input.residuals {
        wanted.extend(
            [
                record.measured,
                record.predicted_before,
                record.predicted_after,
            ]
            .map(number),
        );
    }
    wanted.extend(
        input
            .provenance
            .inputs
            .iter()
            .flat_map(|f| [f.path.clone(), f.sha256.clone()]),
    );
    let absent: Vec<_> = wanted
        .iter()
        .filter(|w| !text.contains(w.as_str()))
        .collect();
    assert!(absent.is_empty(), "{absent:?}");
    assert!(
        !text.contains("7654.3"),
        "the search must not find what was never given"
    );
}

#[test]
fn hostile_text_stays_text() {
    const HOSTILE: &str = "<script>alert(1)</script>\"'&\u{0}]]>";
    let mut input = data::whisker();
    let text = || HOSTILE.to_owned();
    input.verify.simulated = true;
    input.simulated_by = Some(text());
    input.verify.session = text();
    input.verify.kind = text();
    input.verify.reason = text();
    input.verify.noise_floor.source = text();
    input.verify.notes = vec![text()];
    input.verify.twin.faults[0].kind = text();
    input.verify.twin.faults[0].detail = text();
    input.verify.alternatives[0][0] = text();
    input.verify.unknown = Some(UnknownEffect {
        driver: text(),
        shape: text(),
        drivers_ranked: vec![text()],
        period: Some(1.0),
    });
    let effect = &mut input.verify.effects[0];
    effect.id = text();
    effect.class = vec![text()];
    effect.sentence = text();
    effect.parameters[0].name = text();
    effect.parameters[0].unit = text();
    input.verify.before.as_mut().unwrap().split = text();
    input
        .verify
        .before
        .as_mut()
        .unwrap()
        .rmse
        .insert(text(), 1.0);
    input.verify.next_measurement.as_mut().unwrap().instruction = text();
    input.verify.next_measurement.as_mut().unwrap().separates = vec![text()];
    input.verify.detectable[0].why = text();
    let effects = vec![text()];
    let test = WitnessTest {
        witness: text(),
        effects,
        unit: text(),
        sentence: text(),
        ..WitnessTest::default()
    };
    input.verify.tests = vec![test];
    input.verify.holdout.outcome = HoldoutOutcome::Contradicted;
    input.verify.holdout.why = text();
    input.facts = vec![Fact::new(HOSTILE, HOSTILE)];
    input.evidence[0].law = text();
    input.evidence[0].effects = vec![text()];
    input.provenance.command = vec![text()];
    input.provenance.inputs[0].path = text();
    for record in &mut input.residuals[..4] {
        record.channel = text();
        record.source = text();
        record.unit = text();
        record.rejected = Some(text());
        record.covariates.push((text(), record.measured));
    }
    let page = render(&input);
    let index = render_index(HOSTILE, &[HOSTILE], &[(text(), input)]);
    let pages = [page, index];
    for page in pages {
        assert!(!page.contains("<script"), "markup got through");
        assert!(
            text_of(&page)
                .unwrap()
                .contains("<script>alert(1)</script>")
        );
    }
}

/// What a reader wants to know first: the contact, in large type, then its row above the
/// wavelengths'; without a contact the response.
#[test]
fn the_page_begins_with_what_changed() {
    let page = render(&data::whisker());
    let contact = data::whisker().verify.contact.unwrap();
    let claim = format!(
        "<p class=\"claim\">{:.2} → {:.2}\u{a0}mm <span>error of a contact",
        contact.before.rms_mm, contact.after.rms_mm
    );
    let place = |page: &str, text: &str| page.find(text).unwrap_or_else(|| panic!("{text}"));
    let rows = [
        "<th scope=\"row\">contact (mm)",
        "<th scope=\"row\">wavelength (pm)",
    ];
    let order = [claim.as_str(), rows[0], rows[1], "<section"].map(|text| place(&page, text));
    assert!(order.is_sorted(), "{order:?}");
    let index = render_index("Index", &[], &[("a.html".into(), data::whisker())]);
    assert!(index.contains(&claim));
    let cell = render(&data::transducer());
    assert!(cell.contains("<span>error of response</span>"));
    assert!(
        !render(&bare("axis")).contains("class=\"claim\""),
        "negative control"
    );
}

/// A load cell or an axis has cycles, no trajectories, sweeps or objects.
#[test]
fn words_are_those_of_the_kind() {
    const WHISKER: [&str; 5] = ["trajector", "sweep", "object", "loto", "wire"];
    let spoken = |page: &str| {
        let [from, to] = ["<style>", "</style>"].map(|tag| page.find(tag).unwrap());
        let text = text_of(&[&page[..from], "<style>", &page[to..]].concat()).unwrap();
        WHISKER.map(|word| text.contains(word))
    };
    for mut input in [data::transducer(), data::axis()] {
        let split = HeldOutError {
            split: "loto".into(),
            ..HeldOutError::default()
        };
        input.verify.before.get_or_insert(split.clone());
        input.verify.after = Some(HeldOutError {
            rmse: input.verify.before.clone().unwrap().rmse,
            ..split
        });
        input.verify.tests = vec![WitnessTest {
            witness: "replicates".into(),
            ..WitnessTest::default()
        }];
        input
            .residuals
            .iter_mut()
            .enumerate()
            .for_each(|(k, r)| r.group = 1 + k as u32 % 3);
        let page = render(&input);
        assert_eq!(spoken(&page), [false; 5], "{}", input.verify.kind);
        assert!(page.contains("leave one cycle out") && page.contains("against cycle"));
    }
    let whisker = spoken(&render(&data::whisker()));
    assert!(whisker[0] && whisker[1], "negative control: {whisker:?}");
}

/// The charts that the residuals follow most come first, the others are folded.
#[test]
fn the_strongest_residual_charts_are_open() {
    let mut input = data::transducer();
    for (k, r) in input.residuals.iter_mut().enumerate() {
        for name in ["a", "b", "c"] {
            r.covariates
                .push((name.into(), f64::from((k as u32 * 7919 + 13) % 101)));
        }
    }
    let page = render(&input);
    let [open, folded] = ["stimulus", "Against "].map(|text| page.find(text).unwrap());
    let first = page.find("Residuals against ").unwrap();
    assert!(
        page[first..].starts_with("Residuals against stimulus"),
        "{}",
        &page[first..first + 60]
    );
    assert!(open < folded && page[..folded].matches("Residuals against ").count() == 3);
}

#[test]
fn links_cannot_run_scripts() {
    let report = ("javascript:alert(1)".into(), bare("axis"));
    assert!(!render_index("i", &[], &[report]).contains("javascript:"));
}

#[test]
fn broken_numbers_leave_the_page_whole() {
    let broken = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        f64::MIN_POSITIVE,
        -0.0,
    ];
    for value in broken {
        let mut input = data::whisker();
        input.verify.coverage95 = Some(value);
        input.verify.noise_floor = NoiseFloor {
            wavelength_pm: Some(value),
            ..NoiseFloor::default()
        };
        for error in [&mut input.verify.before, &mut input.verify.after] {
            let error: &mut HeldOutError = error.as_mut().unwrap();
            error.rmse.values_mut().for_each(|v| *v = value);
            error
                .interval95
                .values_mut()
                .for_each(|v| *v = [value, 1.0]);
            error.moment_rmse_nmm_each = Some([value; 2]);
        }
        input.verify.effects[0].p_value = value;
        input.verify.effects[0].parameters[0].interval95 = [value; 2];
        input.residuals[3].measured = value;
        input.residuals[5].predicted_after = value;
        input.residuals[7]
            .covariates
            .iter_mut()
            .for_each(|c| c.1 = value);
        input.twin[0].labels[0].moment_nmm = [value; 2];
        input.twin[1].stage_mm[3] = value;
        input.evidence[1].log_likelihood_ratio = value;
        input.evidence[2].p_value = value;
        let page = render(&input);
        text_of(&page).unwrap();
        let body = &page[page.find("<body>").unwrap()..];
        assert!(
            !body.contains("NaN") && !body.contains("inf\"") && !body.contains(">inf"),
            "{value}"
        );
    }
}

#[test]
fn simulated_data_is_labelled_at_the_top_and_at_every_picture() {
    let mut input = data::whisker();
    let page = render(&input);
    assert_eq!(
        page.matches("<figure").count(),
        page.matches("\">SIMULATED</span> ").count()
    );
    assert!(page.contains(">SIMULATED</span>"));
    input.verify.simulated = false;
    assert!(
        !render(&input).to_lowercase().contains(">simulated<"),
        "measured data must not carry the badge"
    );
}

#[test]
fn large_sessions_are_thinned_but_keep_what_was_rejected() {
    let mut input = data::axis();
    let rejected = input.residuals.len() - 1;
    input.residuals[rejected].rejected = Some("jammed".into());
    let page = render(&input);
    assert!(page.contains("rejected: jammed"));
    let mut larger = input.clone();
    for _ in 0..3 {
        larger.residuals.extend_from_slice(&input.residuals);
    }
    assert!(render(&larger).len() < 2 * page.len());
}

#[test]
fn a_page_of_shapes_without_a_pair_is_whole() {
    let page = render_shapes(&ShapesInput {
        rejected: vec![["a".into(), "b".into()]],
        ..Default::default()
    });
    text_of(&page).unwrap();
    assert!(page.contains("could not be used"));
}
