//! Paper-like sessions (27 approach-only poses) with effects of a given size and pictures of every
//! pose (SIMULATED).

use wcal_core::SessionData;
use wcal_core::verify_document::Verdict;
use wcal_plant::shapes::{Cameras, Fault, shapes_json};
use wcal_plant::{CaseKind, Design, Effect, Kind, Request, draw};
use wcal_verify::verify::VerifyRequest;
use wcal_verify::whisker::{Verified, verify_whisker};

/// A groove that sits 0.1 mm off.
pub(crate) fn offset() -> Effect {
    Effect {
        kind: Kind::OffsetGroove,
        amplitude: 0.1,
        shape: vec![0.0, 0.6, 0.8],
    }
}

/// A root that turns by 2 mrad/(N mm).
pub(crate) fn compliance() -> Effect {
    Effect {
        kind: Kind::ComplianceIsotropic,
        amplitude: 2e-3,
        shape: Vec::new(),
    }
}

/// Both.
pub(crate) fn both() -> Vec<Effect> {
    vec![offset(), compliance()]
}

/// A board that is half a per cent larger than stated.
pub(crate) const BOARD: Fault = Fault::BoardScale(5e-3);

/// As good as `stereo-shape` was measured on the plant's pictures: wire 0.011 mm, groove 0.012 mm.
const CAMERAS: Cameras = Cameras {
    own_mm: 0.012,
    shift_mm: 0.01,
    turn_rad: 2e-4,
    scale: 1e-4,
    stated: 1.0,
};

/// What acts in a session.
pub(crate) struct Draw {
    pub effects: Vec<Effect>,
    pub fault: Fault,
    pub pictures: bool,
    /// What the pairs state of their own noise, as a share of what it is.
    pub stated: f64,
    pub seed: u64,
}

/// What the program says of it.
#[derive(Debug, Clone)]
#[allow(
    dead_code,
    reason = "the debug text of a failed test shows every field"
)]
pub(crate) struct Answer {
    pub verdict: Verdict,
    pub effects: Vec<String>,
    pub witness: String,
    pub contact_before_mm: f64,
    pub contact_after_mm: f64,
    pub contact_floor_mm: f64,
    pub reason: String,
}

impl Answer {
    pub(crate) fn names_only(&self, id: &str) -> bool {
        self.verdict == Verdict::Effect && self.effects == [id]
    }

    pub(crate) fn names_both(&self, ids: [&str; 2]) -> bool {
        let all = ids.iter().all(|id| self.effects.iter().any(|e| e == id));
        self.verdict == Verdict::Effect && self.effects.len() == 2 && all
    }
}

/// Draws, writes, loads and verifies.
pub(crate) fn answer(order: &Draw) -> Answer {
    let request = Request {
        seed: order.seed,
        design: Design::Paper,
        want: CaseKind::Null,
        target_sigma: 0.0,
        rivals: false,
    };
    let (case, shown) = draw(&request).unwrap().under(&order.effects).unwrap();
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("case");
    case.write(&folder).unwrap();
    if order.pictures {
        let shapes = shapes_json(
            "case",
            &shown,
            &Cameras {
                stated: order.stated,
                ..CAMERAS
            },
            order.fault,
            order.seed,
        );
        std::fs::write(
            folder.join("shapes.json"),
            serde_json::to_vec(&shapes).unwrap(),
        )
        .unwrap();
        let toml = std::fs::read_to_string(folder.join("session.toml")).unwrap();
        let toml = toml.replace("[files]\n", "[files]\nshapes = \"shapes.json\"\n");
        std::fs::write(folder.join("session.toml"), toml).unwrap();
    }
    let session = wcal_session::load(&folder).unwrap();
    assert!(session.warnings.is_empty(), "{:?}", session.warnings);
    let SessionData::Whisker(data) = &session.data else {
        panic!("kind")
    };
    let (request, sealed) = (VerifyRequest::default(), session.sealed.whisker());
    let done = verify_whisker("case", data, sealed, &session.inputs, &[], &request).unwrap();
    let Verified::Done(done) = done else {
        panic!("refused")
    };
    let d = done.document;
    let contact = |e: &Option<wcal_core::verify_document::HeldOutError>| {
        e.as_ref()
            .and_then(|e| e.rmse.get("contact_rmse_mm"))
            .copied()
            .unwrap_or(f64::NAN)
    };
    Answer {
        verdict: d.verdict,
        effects: d.effects.iter().map(|e| e.id.clone()).collect(),
        witness: d
            .notes
            .iter()
            .find(|n| n.starts_with("Pictures: "))
            .cloned()
            .unwrap_or_default(),
        contact_before_mm: contact(&d.before),
        contact_after_mm: contact(&d.after),
        contact_floor_mm: d.noise_floor.contact_mm.unwrap_or(f64::NAN),
        reason: d.reason,
    }
}
