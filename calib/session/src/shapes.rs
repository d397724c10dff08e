//! `[files] shapes`: what the cameras saw of the session's poses (`shapes.json`), each pair with
//! its row of the points table.
//!
//! A pair that cannot be used with the wavelengths is omitted by name and the rest is used. All are
//! omitted where the file belongs to another session, or to other cameras or another rig than the
//! session states, or where its shared covariance is none. Only a file that is no shapes.json is an
//! error.

use crate::error::{InputError, SessionError, quote};
use nalgebra::Matrix3;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use wcal_core::files::{MAX_DOCUMENT_BYTES, read_within};
use wcal_core::observation::{PairLeftOut, SessionShapes, WhiskerRow};
use wcal_core::provenance::sha256_hex;
use wcal_core::shapes_document::{
    ErrorColumn, GrooveDocument, PairDocument, PairErrors, SHAPES_FORMAT, ShapesSource,
    SharedParameter,
};
use wcal_core::{InputFile, Purpose, Role, format};

/// Most pairs: a session has some hundred poses.
const MAX_PAIRS: usize = 20_000;
/// Most errors that pairs share: the parameters of two cameras, of tags and light are some fifty.
const MAX_SHARED: usize = 200;
/// Most own errors of a pair.
const MAX_OWN: usize = 500;
/// Longest list of stations of a pair.
const MAX_STATIONS: usize = 2000;
/// Largest length that is believed, mm, and largest effect of an error in its unit.
const MAX_MM: f64 = 1e4;
/// Largest derivative: a radian moves a point of the scene by its distance, a pixel by far less.
const MAX_DERIVATIVE: f64 = 1e7;
/// Relative size of a negative eigenvalue that is rounding.
const ROUNDING: f64 = 1e-6;

/// shapes.json, each pair read by itself so that a damaged one does not take the others with it.
#[derive(Deserialize)]
struct Shapes {
    format: String,
    pairs: Vec<ReadPair>,
    #[serde(default)]
    shared_parameters: Vec<SharedParameter>,
    #[serde(default)]
    shared_covariance: Vec<Vec<Option<f64>>>,
    #[serde(default)]
    source: ShapesSource,
}

/// A pair, or its name and why it cannot be read.
struct ReadPair(Result<PairDocument, PairLeftOut>);

impl<'de> Deserialize<'de> for ReadPair {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        let name = value["name"]
            .as_str()
            .unwrap_or("a pair without name")
            .to_owned();
        let pair = PairDocument::deserialize(value);
        Ok(Self(pair.map_err(|e| PairLeftOut {
            name,
            why: format!("it cannot be read: {e}"),
        })))
    }
}

/// Pairs that are left out, by reason.
pub(crate) fn in_words(left_out: &[PairLeftOut]) -> String {
    let mut by_reason: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for pair in left_out {
        by_reason.entry(&pair.why).or_default().push(&pair.name);
    }
    let each: Vec<String> = by_reason
        .iter()
        .map(|(why, names)| format!("{} ({why})", names.join(", ")))
        .collect();
    format!(
        "{} pair(s) of pictures left out: {}",
        left_out.len(),
        each.join("; ")
    )
}

/// Reads the shapes and gives each usable pair to its row. `expected`: what the session says of the
/// cameras and the rig that they must come from; empty where it does not say.
///
/// # Errors
/// Where the file cannot be read or is no shapes.json.
pub(crate) fn read(
    path: &Path,
    name: &str,
    expected: &ShapesSource,
    rows: &mut [WhiskerRow],
    purpose: Purpose,
) -> Result<(SessionShapes, InputFile), SessionError> {
    let bytes = read_within(path, MAX_DOCUMENT_BYTES).map_err(SessionError::reading)?;
    let document = parsed(name, &bytes)?;
    // JSON has no NaN: a null becomes one, which the check of the covariance refuses.
    let covariance: Vec<Vec<f64>> = document
        .shared_covariance
        .iter()
        .map(|row| row.iter().map(|v| v.unwrap_or(f64::NAN)).collect())
        .collect();
    let all = foreign(&document.source, expected)
        .or_else(|| no_covariance(&covariance, document.shared_parameters.len()));
    let by_point: BTreeMap<i64, usize> = rows
        .iter()
        .enumerate()
        .map(|(k, row)| (row.point, k))
        .collect();
    let (shared, mut left_out) = (document.shared_parameters.len(), Vec::new());
    for pair in document.pairs {
        let pair = match pair.0 {
            Ok(pair) => pair,
            Err(damaged) => {
                left_out.push(damaged);
                continue;
            }
        };
        let place = pair.point.and_then(|point| by_point.get(&point).copied());
        // At rest the wire is free: such a pair says nothing of a contact, and nothing is wrong
        // with it.
        if all.is_none() && place.is_some_and(|k| rows[k].role == Role::Rest) {
            continue;
        }
        let misplaced = || match (place, pair.point) {
            (Some(k), _) if rows[k].pair.is_none() => None,
            (Some(_), _) => Some("another pair has its point already".to_owned()),
            (None, Some(point)) => Some(format!("its point {point} is not in the points table")),
            (None, None) => Some("it names no point of the session".to_owned()),
        };
        let why = all.clone().or_else(|| unusable(&pair, shared));
        match (why.or_else(misplaced), place) {
            (None, Some(k)) => rows[k].pair = Some(Arc::new(pair)),
            (why, _) => left_out.push(PairLeftOut {
                name: pair.name,
                why: why.unwrap_or_default(),
            }),
        }
    }
    let shapes = SessionShapes {
        file: name.to_owned(),
        parameters: document.shared_parameters,
        covariance: if all.is_none() {
            covariance
        } else {
            Vec::new()
        },
        left_out,
    };
    let input = InputFile {
        path: name.to_owned(),
        sha256: sha256_hex(&bytes),
        purpose,
    };
    Ok((shapes, input))
}

/// The document, its numbers not yet judged.
fn parsed(name: &str, bytes: &[u8]) -> Result<Shapes, InputError> {
    let document: Shapes = serde_json::from_slice(bytes).map_err(|e| {
        InputError::new(name, "shapes.json as stereo-shape writes it", e.to_string()).at(e.line())
    })?;
    if let Err(why) = format::expect(SHAPES_FORMAT, Some(&document.format)) {
        return Err(
            InputError::new(name, "shapes.json of this version", why.to_string()).field("format"),
        );
    }
    if document.pairs.len() > MAX_PAIRS {
        let found = document.pairs.len().to_string();
        return Err(
            InputError::new(name, format!("at most {MAX_PAIRS} pairs"), found).field("pairs"),
        );
    }
    Ok(document)
}

/// Why none of the pairs belongs to this session; none where they may.
fn foreign(source: &ShapesSource, expected: &ShapesSource) -> Option<String> {
    // Pictures of another session show the wire in other poses.
    if let (Some(other), Some(own)) = (&source.session, &expected.session)
        && other != own
    {
        return Some(format!(
            "the pictures are those of session {}, not of {}",
            quote(other),
            quote(own)
        ));
    }
    // Another calibration or rig has other errors than those that are stated beside the shapes.
    let made = [
        (
            "another calibration of the cameras",
            &source.cameras_sha256,
            &expected.cameras_sha256,
        ),
        ("another rig", &source.rig_sha256, &expected.rig_sha256),
    ];
    made.into_iter()
        .find(|(_, stated, wanted)| !stated.is_empty() && !wanted.is_empty() && stated != wanted)
        .map(|(what, ..)| format!("the shapes were made with {what} than the session states"))
}

/// Why the covariance of the shared errors is none; none where it is one.
fn no_covariance(covariance: &[Vec<f64>], shared: usize) -> Option<String> {
    let square = covariance.len() == shared && covariance.iter().all(|row| row.len() == shared);
    if shared > MAX_SHARED || !square {
        let rows = covariance.len();
        return Some(format!(
            "shared_covariance has {rows} rows for {shared} parameters, {MAX_SHARED} at most"
        ));
    }
    if shared == 0 {
        return None;
    }
    let wrong = wcal_core::covariance::check(covariance, shared).err();
    wrong.map(|why| format!("shared_covariance is no covariance: {why}"))
}

/// Why a pair cannot be used with the wavelengths; none where it can.
fn unusable(pair: &PairDocument, shared: usize) -> Option<String> {
    if pair.status != "ok" {
        let why = match pair.why.as_str() {
            "" => "stereo-shape rejected it",
            why => why,
        };
        return Some(why.to_owned());
    }
    let Some(groove) = &pair.groove else {
        return Some("the rig tag is not seen".to_owned());
    };
    // Only in the vertex is the groove's place that of the wire.
    let contact = match groove.contact.as_str() {
        "" | "vertex" => None,
        "none" => Some("the wire does not touch the groove".to_owned()),
        other => Some(format!(
            "the wire is not in the groove's vertex (contact {})",
            quote(other)
        )),
    };
    let errors = || {
        pair.errors
            .as_ref()
            .and_then(|e| inconsistent(pair, e, shared))
    };
    contact.or_else(|| wrong_numbers(groove)).or_else(errors)
}

/// A coordinate or a standard deviation that can be true.
fn sensible(v: &f64) -> bool {
    v.abs() <= MAX_MM
}

/// What is wrong with the groove's numbers; none where nothing is.
fn wrong_numbers(groove: &GrooveDocument) -> Option<String> {
    let places = groove
        .position_mm
        .iter()
        .chain(&groove.axis)
        .chain([&groove.contact_arclength_mm]);
    if !places.into_iter().all(sensible) {
        return Some("its groove is no place".to_owned());
    }
    let sds = groove.sd_mm.iter().chain([&groove.contact_arclength_sd_mm]);
    if !sds.into_iter().all(|sd| sensible(sd) && *sd > 0.0) {
        return Some("a standard deviation of its groove is not positive".to_owned());
    }
    let covariance = Matrix3::from(groove.covariance_mm2?);
    let numbers = covariance.iter().all(sensible);
    let symmetric = (covariance - covariance.transpose()).amax() <= ROUNDING * covariance.amax();
    let positive = numbers && symmetric && covariance.cholesky().is_some();
    (!positive).then(|| "the covariance of its groove is not positive definite".to_owned())
}

/// What does not fit in a pair's errors; none where all does.
fn inconsistent(pair: &PairDocument, errors: &PairErrors, shared: usize) -> Option<String> {
    let stations = errors.stations.len();
    let arcs = errors.stations_mm.iter();
    if stations > MAX_STATIONS || arcs.len() != stations || !errors.stations_mm.iter().all(sensible)
    {
        return Some(format!(
            "it has {} arc lengths for {stations} stations",
            errors.stations_mm.len()
        ));
    }
    if let Some(k) = errors
        .stations
        .iter()
        .find(|k| **k >= pair.centreline_mm.len())
    {
        return Some(format!(
            "its station {k} is not on a centre line of {} points",
            pair.centreline_mm.len()
        ));
    }
    if !pair.centreline_mm.iter().flatten().all(sensible) {
        return Some("its centre line is no line".to_owned());
    }
    if errors.shared.len() != shared || errors.own.len() > MAX_OWN {
        let (own, of) = (errors.own.len(), errors.shared.len());
        return Some(format!(
            "it has {own} own errors and {of} derivatives for {shared} shared parameters"
        ));
    }
    let whole = |c: &ErrorColumn, most: f64| {
        let lengths = c.centreline_mm.is_empty() || c.centreline_mm.len() == stations;
        let mut numbers = c
            .centreline_mm
            .iter()
            .flatten()
            .chain(&c.groove_mm)
            .chain([&c.contact_arclength_mm]);
        lengths && numbers.all(|v| v.abs() <= most)
    };
    let own = errors.own.iter().all(|c| whole(c, MAX_MM));
    let derivatives = errors.shared.iter().all(|c| whole(c, MAX_DERIVATIVE));
    let floor = sensible(&errors.floor_mm) && errors.floor_mm >= 0.0;
    (!(own && derivatives && floor))
        .then(|| "an error of it does not cover the stations, or is no number".to_owned())
}
