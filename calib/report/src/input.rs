//! What a report is made of: plain data that other crates computed.
//!
//! Everything is public; an empty list means "not part of this run" and the section says so.

use wcal_core::verify_document::{HeldOutError, Verdict, VerifyDocument};
use wcal_core::{Provenance, ResidualRecord};

/// Everything that the page of one session shows.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportInput {
    /// Heading of the page; at first the session's identifier.
    pub title: String,
    /// What the session shows, for an overview.
    pub about: String,
    /// How the data was simulated, where that is known. Whether they are is for `verify.simulated`
    /// to say: the page carries a SIMULATED badge there.
    pub simulated_by: Option<String>,
    /// The explanation was accepted on request, although the data leave others open.
    pub accepted_on_request: bool,
    /// Name and value of what the reader should know of the session: wire, medium, rows by role,
    /// devices.
    pub facts: Vec<Fact>,
    /// Result of `verify`.
    pub verify: VerifyDocument,
    /// Every reading with its residuals, in time order.
    pub residuals: Vec<ResidualRecord>,
    /// Further held-out errors in addition to `verify.before` and `verify.after`: the black-box
    /// rival, other splits, repaired labels.
    pub further_errors: Vec<(String, HeldOutError)>,
    /// Tests of the omnibus gate.
    pub gate: Vec<GateTest>,
    /// Twin check, one entry a trajectory.
    pub twin: Vec<TwinTrajectory>,
    /// Explanations that were refitted, best first.
    pub evidence: Vec<EvidenceRow>,
    /// Program, command, seed and files by hash.
    pub provenance: Provenance,
}

impl ReportInput {
    /// A report of `verify` alone; fill the other fields as far as they are known.
    pub fn new(verify: VerifyDocument, provenance: Provenance) -> Self {
        Self {
            title: verify.session.clone(),
            about: String::new(),
            simulated_by: None,
            accepted_on_request: false,
            facts: Vec::new(),
            verify,
            residuals: Vec::new(),
            further_errors: Vec::new(),
            gate: Vec::new(),
            twin: Vec::new(),
            evidence: Vec::new(),
            provenance,
        }
    }

    /// See [`model_after`].
    pub fn model_after(&self) -> &'static str {
        model_after(&self.verify, self.accepted_on_request)
    }

    /// Unit of the response as the residual records give it; empty for kinds that name their unit
    /// themselves.
    pub(crate) fn response_unit(&self) -> &str {
        let own = self.verify.kind == "transducer";
        self.residuals
            .first()
            .filter(|_| own)
            .map_or("", |r| r.unit.as_str())
    }
}

/// What the errors "after" are those of. Nothing is called accepted that was not.
pub fn model_after(verify: &VerifyDocument, accepted_on_request: bool) -> &'static str {
    match verify.verdict {
        Verdict::Adequate | Verdict::UnknownEffect if verify.effects.is_empty() => {
            "declared model, nothing added"
        }
        Verdict::Ambiguous | Verdict::UnknownEffect if !accepted_on_request => {
            "best explanation, not accepted"
        }
        _ => "accepted model",
    }
}

/// A name and what is said of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fact {
    /// Name.
    pub name: String,
    /// Value with its unit, ready to print.
    pub value: String,
}

impl Fact {
    /// Pairs a name with a printable value.
    pub fn new(name: impl Into<String>, value: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            value: value.into(),
        }
    }
}

/// One test of the omnibus gate.
#[derive(Debug, Clone, PartialEq)]
pub struct GateTest {
    /// Test, e.g. `lack of fit F`.
    pub name: String,
    /// Statistic, dimensionless.
    pub statistic: Option<f64>,
    /// p-value.
    pub p_value: Option<f64>,
    /// Remark, e.g. degrees of freedom.
    pub detail: String,
}

/// Names of the two moments.
pub(crate) const MOMENT_NAMES: [&str; 2] = ["moment 1", "moment 2"];

/// Twin check along one trajectory.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TwinTrajectory {
    /// Trajectory as in the points table.
    pub id: u32,
    /// Stage positions in order, mm.
    pub stage_mm: Vec<f64>,
    /// Moments of the rod followed from first touch, at those positions, N mm.
    pub moment_nmm: Vec<[f64; 2]>,
    /// Labels of the outside twin.
    pub labels: Vec<TwinMark>,
}

/// One label of the outside twin.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinMark {
    /// Point number.
    pub point: i64,
    /// Stage position, mm.
    pub stage_mm: f64,
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
}

/// One explanation: a set of effects that was refitted through the full model.
#[derive(Debug, Clone, PartialEq)]
pub struct EvidenceRow {
    /// Effects; empty: the declared model alone.
    pub effects: Vec<String>,
    /// Law, e.g. `position lags by b after a reversal`.
    pub law: String,
    /// Chi-square gained over the declared model.
    pub chi2_gain: f64,
    /// Parameters that it spends.
    pub degrees_of_freedom: usize,
    /// ln(likelihood / likelihood of the best), zero for the best, else negative.
    pub log_likelihood_ratio: f64,
    /// Bootstrap p-value of that ratio.
    pub p_value: f64,
    /// Not rejected.
    pub survives: bool,
}
