//! Fills the report from what the other crates computed.

use wcal_core::verify_document::VerifyDocument;
use wcal_core::{Provenance, Role, TransducerData, WhiskerData};
use wcal_report::{
    EvidenceRow, Fact, GateTest, ReportInput, TwinMark, TwinTrajectory, model_after,
};
use wcal_session::LoadedSession;
use wcal_verify::method::search_result::RankedHypothesis;
use wcal_verify::scalar::{Declared, ScalarVerification};
use wcal_verify::whisker::WhiskerVerification;

/// A report with nothing but the document, and how the session was simulated, where it says so.
pub(crate) fn of_document(
    session: &LoadedSession,
    document: VerifyDocument,
    provenance: Provenance,
) -> ReportInput {
    let stated = session.meta.get("provenance");
    let how = stated.and_then(|p| p.get("simulated_by")?.as_str());
    ReportInput {
        title: title(session),
        simulated_by: how.map(str::to_owned),
        ..ReportInput::new(document, provenance)
    }
}

/// The name that people gave the session: its folder's, of a folder `session` that of the folder it
/// lies in.
fn title(session: &LoadedSession) -> String {
    let whole = session.folder.canonicalize();
    let whole = whole.unwrap_or_else(|_| session.folder.clone());
    let mut names = whole.ancestors().filter_map(|p| p.file_name()?.to_str());
    let name = names.find(|name| *name != "session");
    name.unwrap_or(&session.id).to_owned()
}

/// The report of a whisker session.
pub(crate) fn of_whisker(
    session: &LoadedSession,
    (data, sealed): (&WhiskerData, usize),
    done: &WhiskerVerification,
    accepted_on_request: bool,
    provenance: Provenance,
) -> ReportInput {
    let count = |role: Role| data.rows.iter().filter(|r| r.role == role).count();
    let found = &done.decision.explained().found;
    let after = model_after(&done.document, accepted_on_request);
    ReportInput {
        accepted_on_request,
        facts: vec![
            Fact::new("medium", data.medium.clone()),
            Fact::new(
                "wire",
                format!(
                    "{} mm, E {} GPa, G {} GPa",
                    data.whisker.diameter_mm, data.whisker.youngs_gpa, data.whisker.shear_gpa
                ),
            ),
            Fact::new(
                "readings",
                format!(
                    "{} calibration, {} verification, {} rest, {} held out",
                    count(Role::Calibration),
                    count(Role::Verification),
                    count(Role::Rest),
                    sealed
                ),
            ),
        ],
        residuals: done.assessment.residuals.clone(),
        further_errors: done.decision.left_out().errors.further.clone(),
        gate: gates(
            [found.first_test.p_values(), found.last_test.p_values()],
            after,
        ),
        twin: twin(done),
        evidence: evidence(&found.evidence),
        ..of_document(session, done.document.clone(), provenance)
    }
}

/// The report of a transducer or axis session.
pub(crate) fn of_scalar(
    session: &LoadedSession,
    (data, sealed): (&TransducerData, usize),
    done: &ScalarVerification,
    provenance: Provenance,
) -> ReportInput {
    let (after, declared) = (
        model_after(&done.document, false),
        Declared::from(data.model),
    );
    let (stimulus, response) = (&data.stimulus_unit, &data.response_unit);
    let model = match declared {
        Declared::Axis => "measured = commanded + constant".to_owned(),
        Declared::Polynomial(0) => "response = b0".to_owned(),
        Declared::Polynomial(1) => "response = b0 + b1 stimulus".to_owned(),
        Declared::Polynomial(_) => "response = b0 + b1 stimulus + b2 stimulus^2".to_owned(),
    };
    let units = match declared {
        Declared::Axis => format!("commanded and measured {stimulus}, error {response}"),
        Declared::Polynomial(_) => format!("stimulus {stimulus}, response {response}"),
    };
    let mut facts = vec![
        Fact::new("declared model", model),
        Fact::new(
            "readings",
            format!("{} fitted, {sealed} held out", data.rows.len()),
        ),
    ];
    if !(stimulus == "1" && response == "1") {
        facts.push(Fact::new("units", units));
    }
    for (name, p) in [("declared model", &done.declared), (after, &done.accepted)] {
        if let Some(p) = p {
            let terms = p.coefficients.iter().zip(&p.standard_errors).enumerate();
            let terms: Vec<String> = terms
                .map(|(k, (b, se))| format!("b{k} = {b:.9e} ± {se:.2e}"))
                .collect();
            facts.push(Fact::new(
                format!("coefficients, {name}"),
                format!("{}; residual sd {:.6e}", terms.join(", "), p.residual_sd),
            ));
        }
    }
    let mut gate = done
        .gates
        .map_or(Vec::new(), |p_values| gates(p_values, after));
    for (name, lack) in [
        ("declared model", done.lack_of_fit_before),
        (after, done.lack_of_fit_after),
    ] {
        if let Some(l) = lack {
            gate.push(GateTest {
                name: format!("{name}: lack of fit F"),
                statistic: Some(l.f),
                p_value: l.p_value,
                detail: format!(
                    "against repetitions, {} and {} degrees of freedom",
                    l.dof, l.pure_dof
                ),
            });
        }
    }
    if let Some(s) = &done.spread {
        gate.push(GateTest {
            name: declared.format_text("spread against stimulus"),
            statistic: Some(s.correlation),
            p_value: Some(s.p_value),
            detail: declared.format_text(
                "correlation of the residuals' size with the stimulus, by permutation",
            ),
        });
    }
    if let Some(s) = &done.stationarity {
        gate.push(GateTest {
            name: "steadiness of the period".to_owned(),
            statistic: Some(s.z),
            p_value: None,
            detail: "difference between the halves of the session in standard errors".to_owned(),
        });
    }
    // The laws in the words of the session's kind.
    let mut found = evidence(&done.evidence);
    if declared == Declared::Axis {
        for row in &mut found {
            row.law = row.law.replace("stimulus", "position");
        }
    }
    ReportInput {
        facts,
        residuals: done.residuals.clone(),
        gate,
        evidence: found,
        ..of_document(session, done.document.clone(), provenance)
    }
}

/// The gate's families on the declared model and on the one after.
fn gates(p_values: [[f64; 3]; 2], after: &str) -> Vec<GateTest> {
    let families = [
        (
            "catalogue",
            "smallest p over all signatures, family-wise by simulation",
        ),
        (
            "generic drivers",
            "any covariate, family-wise by simulation",
        ),
        ("serial correlation", "neighbouring readings"),
    ];
    let of_model = |(model, p_values): (&str, [f64; 3])| {
        let test = move |((family, detail), p): ((&str, &str), f64)| GateTest {
            name: format!("{model}: {family}"),
            statistic: None,
            p_value: Some(p),
            detail: detail.to_owned(),
        };
        families
            .into_iter()
            .zip(p_values)
            .map(test)
            .collect::<Vec<_>>()
    };
    ["declared model", after]
        .into_iter()
        .zip(p_values)
        .flat_map(of_model)
        .collect()
}

fn evidence(found: &[RankedHypothesis]) -> Vec<EvidenceRow> {
    let row = |e: &RankedHypothesis| EvidenceRow {
        effects: e.effects.clone(),
        law: e.laws.join(" + "),
        chi2_gain: e.gain,
        degrees_of_freedom: e.parameters,
        log_likelihood_ratio: -0.5 * e.behind,
        p_value: e.p_value,
        survives: e.is_retained(),
    };
    found.iter().map(row).collect()
}

fn twin(done: &WhiskerVerification) -> Vec<TwinTrajectory> {
    done.branches
        .iter()
        .map(|(id, stage_mm, moment_nmm)| TwinTrajectory {
            id: *id,
            stage_mm: stage_mm.clone(),
            moment_nmm: moment_nmm.clone(),
            labels: done
                .labels
                .checks
                .iter()
                .filter(|c| c.trajectory == *id)
                .map(|c| TwinMark {
                    point: c.point,
                    stage_mm: c.stage_mm,
                    moment_nmm: c.label_nmm,
                })
                .collect(),
        })
        .collect()
}
