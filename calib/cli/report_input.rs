//! Fills the report from what the other crates computed.

use wcal_core::verify_document::VerifyDocument;
use wcal_core::{Provenance, Role, WhiskerData};
use wcal_report::{
    EvidenceRow, Fact, GateTest, NamedError, ReportInput, TwinMark, TwinTrajectory, model_after,
};
use wcal_session::LoadedSession;
use wcal_verify::method::search_result::RankedHypothesis;
use wcal_verify::scalar::{Declared, ScalarData, ScalarVerification};
use wcal_verify::whisker::WhiskerVerification;

fn versions() -> Vec<Fact> {
    vec![Fact::new("wcal", env!("CARGO_PKG_VERSION"))]
}

/// How the session was simulated, where it says so.
fn simulated_by(session: &LoadedSession) -> Option<String> {
    let how = session.meta.get("provenance")?.get("simulated_by")?;
    how.as_str().map(str::to_owned)
}

/// A report with nothing but the document.
pub(crate) fn of_document(
    session: &LoadedSession,
    document: VerifyDocument,
    provenance: Provenance,
) -> ReportInput {
    ReportInput {
        title: session.id.clone(),
        simulated_by: simulated_by(session),
        versions: versions(),
        ..ReportInput::new(document, provenance)
    }
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
        title: session.id.clone(),
        simulated_by: simulated_by(session),
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
        further_errors: (done.decision.left_out().errors.further.iter())
            .map(|(name, error)| NamedError {
                name: name.clone(),
                error: error.clone(),
            })
            .collect(),
        gate: gates(
            [found.first_test.p_values(), found.last_test.p_values()],
            after,
        ),
        twin: twin(done),
        evidence: evidence(&found.evidence),
        versions: versions(),
        ..ReportInput::new(done.document.clone(), provenance)
    }
}

/// The report of a transducer or axis session.
pub(crate) fn of_scalar(
    session: &LoadedSession,
    (data, sealed): (ScalarData<'_>, usize),
    done: &ScalarVerification,
    provenance: Provenance,
) -> ReportInput {
    let rows = data.rows();
    let after = model_after(&done.document, false);
    let (stimulus, response) = data.units();
    let model = match data.declared() {
        Declared::Axis => "measured = commanded + constant".to_owned(),
        Declared::Polynomial(0) => "response = b0".to_owned(),
        Declared::Polynomial(1) => "response = b0 + b1 stimulus".to_owned(),
        Declared::Polynomial(_) => "response = b0 + b1 stimulus + b2 stimulus^2".to_owned(),
    };
    let units = match data.declared() {
        Declared::Axis => format!("commanded and measured {stimulus}, error {response}"),
        Declared::Polynomial(_) => format!("stimulus {stimulus}, response {response}"),
    };
    let mut facts = vec![
        Fact::new("declared model", model),
        Fact::new("units", units),
        Fact::new(
            "readings",
            format!("{} fitted, {} held out", rows.len(), sealed),
        ),
    ];
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
            name: data.declared().format_text("spread against stimulus"),
            statistic: Some(s.correlation),
            p_value: Some(s.p_value),
            detail: data.declared().format_text(
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
    ReportInput {
        title: session.id.clone(),
        simulated_by: simulated_by(session),
        facts,
        residuals: done.residuals.clone(),
        gate,
        evidence: evidence_of(data, &done.evidence),
        versions: versions(),
        ..ReportInput::new(done.document.clone(), provenance)
    }
}

/// Evidence with the laws in the words of the session's kind.
fn evidence_of(data: ScalarData<'_>, found: &[RankedHypothesis]) -> Vec<EvidenceRow> {
    let mut rows = evidence(found);
    if data.declared() == Declared::Axis {
        rows.iter_mut()
            .for_each(|row| row.law = row.law.replace("stimulus", "position"));
    }
    rows
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
        ("serial correlation", "neighbouring readings of a sweep"),
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
