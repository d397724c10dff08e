//! `verify` for kind "whisker": admission of the data, the procedure, and what reports and
//! calibration need of it.

use super::measurement::PicturePairs;
use super::rod_parameters::RodParameters;
use super::system::WhiskerSystem;
use super::twin_check::{LabelReport, check_labels};
use crate::VerifyError;
use crate::verify::{Assessment, Decision, Verified as Loop, VerifyRequest, Witness, verify};
use wcal_core::observation::{WhiskerData, WhiskerRow};
use wcal_core::verify_document::VerifyDocument;
use wcal_core::{InputFile, Sealed};

/// Trajectory, stage positions (mm) and moments (N mm) of the rod's branch.
pub type Branch = (u32, Vec<f64>, Vec<[f64; 2]>);

/// Everything that `verify` found.
pub struct WhiskerVerification {
    /// verify.json.
    pub document: VerifyDocument,
    /// What was decided on the open readings: model, calibration, search.
    pub decision: Decision<WhiskerSystem>,
    /// What the sealed readings say of it, and every reading under both models.
    pub assessment: Assessment<WhiskerSystem>,
    /// Twin check.
    pub labels: LabelReport,
    /// Rod branch along each trajectory: (identifier, stage positions, moments).
    pub branches: Vec<Branch>,
}

/// A session's result, or why its data cannot be used.
pub enum Verified {
    /// The procedure ran.
    Done(Box<WhiskerVerification>),
    /// The data were refused; the document says why.
    Refused(Box<VerifyDocument>),
}

/// Verifies a whisker session.
///
/// # Errors
/// Where the wire's description cannot be used or the declared model has no solution at the poses.
pub fn verify_whisker(
    session: &str,
    data: &WhiskerData,
    sealed: Sealed<WhiskerRow>,
    inputs: &[InputFile],
    witnesses: &[&dyn Witness<WhiskerSystem>],
    request: &VerifyRequest,
) -> Result<Verified, VerifyError> {
    let refused = |reason: String| {
        let mut document = VerifyDocument::refused(session, "whisker", reason, request.search.seed);
        document.inputs = inputs.to_vec();
        Ok(Verified::Refused(Box::new(document)))
    };
    let model = WhiskerSystem::new(data, &[])?;
    let witnesses: Vec<&dyn Witness<WhiskerSystem>> = witnesses
        .iter()
        .copied()
        .chain([&PicturePairs as &dyn Witness<WhiskerSystem>])
        .collect();
    let v = match verify(model, sealed, &witnesses, request).map_err(|e| e.of_session(session))? {
        Loop::Done(v) => v,
        Loop::Refused(reason) => return refused(reason),
    };
    let document = VerifyDocument {
        session: session.to_owned(),
        inputs: inputs.to_vec(),
        ..v.document()
    };
    let open = v.decision.model();
    Ok(Verified::Done(Box::new(WhiskerVerification {
        document,
        labels: check_labels(data, &open.path, &open.rod_tables),
        branches: branches(open),
        decision: v.decision,
        assessment: v.assessment,
    })))
}

/// The rod's branch along each trajectory, as far as the readings reach.
fn branches(system: &WhiskerSystem) -> Vec<Branch> {
    let Some(tables) = system.rod_tables.tables(&RodParameters::default()) else {
        return Vec::new();
    };
    system
        .data
        .trajectories
        .iter()
        .zip(tables.iter())
        .zip(&system.path.reach_mm)
        .filter(|(_, reach)| **reach > 0.0)
        .map(|((t, table), reach)| {
            let xs: Vec<f64> = (0..=60).map(|k| reach * f64::from(k) / 60.0).collect();
            let kept: Vec<(f64, [f64; 2])> = xs
                .iter()
                .filter_map(|x| Some((*x, table.moment(*x)?)))
                .collect();
            (
                t.id,
                kept.iter().map(|k| k.0).collect(),
                kept.iter().map(|k| k.1).collect(),
            )
        })
        .collect()
}
