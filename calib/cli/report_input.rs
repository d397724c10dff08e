//! Fills the report from what the other crates computed.

use wcal_core::verify_document::VerifyDocument;
use wcal_core::{Provenance, Role, WhiskerData};
use wcal_report::{
    EvidenceRow, Explanation, Fact, GateTest, Isolability, NamedError, ReportInput, RodBranch, TwinMark,
    TwinTrajectory,
};
use wcal_session::LoadedSession;
use wcal_trace::verify::WhiskerVerification;

fn versions() -> Vec<Fact> {
    vec![Fact::new("wcal", env!("CARGO_PKG_VERSION"))]
}

/// A report with nothing but the document.
pub fn of_document(session: &LoadedSession, document: VerifyDocument, provenance: Provenance) -> ReportInput {
    ReportInput { title: session.id.clone(), versions: versions(), ..ReportInput::new(document, provenance) }
}

/// The report of a whisker session.
pub fn of_whisker(
    session: &LoadedSession,
    data: &WhiskerData,
    done: &WhiskerVerification,
    provenance: Provenance,
) -> ReportInput {
    let count = |role: Role| data.rows.iter().chain(&data.holdout).filter(|r| r.role == role).count();
    let gate = |name: &str, p: f64, detail: &str| GateTest {
        name: name.to_owned(),
        statistic: None,
        p_value: Some(p),
        detail: detail.to_owned(),
    };
    let found = &done.found;
    ReportInput {
        title: session.id.clone(),
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
                    count(Role::Holdout)
                ),
            ),
        ],
        residuals: done.residuals.clone(),
        further_errors: done
            .further
            .iter()
            .map(|(name, error)| NamedError { name: name.clone(), error: error.clone() })
            .collect(),
        gate: vec![
            gate(
                "declared model, catalogue",
                found.first_gate.p_catalogue,
                "smallest p over all signatures, family-wise by simulation",
            ),
            gate(
                "declared model, generic drivers",
                found.first_gate.p_drivers,
                "any covariate, family-wise by simulation",
            ),
            gate(
                "declared model, serial correlation",
                found.first_gate.p_serial,
                "neighbouring readings of a sweep",
            ),
            gate("accepted model, catalogue", found.last_gate.p_catalogue, "as above"),
            gate("accepted model, generic drivers", found.last_gate.p_drivers, "as above"),
            gate("accepted model, serial correlation", found.last_gate.p_serial, "as above"),
        ],
        twin: twin(done),
        evidence: evidence(done),
        isolability: (done.isolability.0.len() > 1)
            .then(|| Isolability { names: done.isolability.0.clone(), cosine: done.isolability.1.clone() }),
        explanations: found
            .evidence
            .iter()
            .map(|e| Explanation {
                effects: e.effects.clone(),
                log_likelihood_ratio: -0.5 * e.behind,
                p_value: None,
                survives: e.behind <= wcal_trace::engine::search::BEHIND_LIMIT,
            })
            .collect(),
        versions: versions(),
        ..ReportInput::new(done.document.clone(), provenance)
    }
}

fn evidence(done: &WhiskerVerification) -> Vec<EvidenceRow> {
    let best = &done.found.evidence;
    best.iter()
        .map(|e| EvidenceRow {
            id: e.effects.join(" + "),
            law: e.laws.join(" + "),
            parameters: Vec::new(),
            chi2_gain: Some(e.gain),
            degrees_of_freedom: e.parameters,
            p_adjusted: None,
            log_likelihood_ratio: Some(-0.5 * e.behind),
            status: if e.behind <= 0.0 {
                "best".into()
            } else if e.behind <= wcal_trace::engine::search::BEHIND_LIMIT {
                "survives".into()
            } else {
                "rejected".into()
            },
            why: String::new(),
        })
        .collect()
}

fn twin(done: &WhiskerVerification) -> Vec<TwinTrajectory> {
    done.branches
        .iter()
        .map(|(id, stage_mm, moment_nmm)| TwinTrajectory {
            id: *id,
            branches: vec![RodBranch {
                name: "rod, followed from first touch".to_owned(),
                stage_mm: stage_mm.clone(),
                moment_nmm: moment_nmm.clone(),
            }],
            labels: done
                .labels
                .checks
                .iter()
                .filter(|c| c.trajectory == *id)
                .map(|c| TwinMark {
                    point: c.point,
                    stage_mm: c.stage_mm,
                    moment_nmm: c.label_nmm,
                    fault: c.fault.map(str::to_owned),
                })
                .collect(),
            snaps_mm: Vec::new(),
        })
        .collect()
}
