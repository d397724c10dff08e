//! Pairs whose pictures show two poses: a curve through both has another length than the wire, and
//! misses the groove.

use crate::median::median_and_sd;
use wcal_core::shapes_document::PairDocument;

/// Standard deviations of a length beyond which a wire does not have it.
const BEYOND_SD: f64 = 6.0;
/// Differences of length that all pairs may have, as a share: the wire's end in other light.
const LENGTH_SHARE: f64 = 1e-3;
/// Sd of a length beyond which the wire's end was not seen, mm.
const END_UNSEEN_MM: f64 = 0.3;
/// Pairs of one length that outvote a single one whose groove is not seen.
const OTHERS: usize = 3;

/// Pairs that show another length than the others, where their groove, if it is seen, does not hold
/// the wire: index and reason.
pub(crate) fn pairs_of_other_poses(pairs: &[PairDocument]) -> Vec<(usize, String)> {
    let seen = |p: &&PairDocument| p.status == "ok" && p.length_sd_mm < END_UNSEEN_MM;
    let mut found = Vec::new();
    for (k, pair) in pairs.iter().enumerate().filter(|(_, p)| seen(p)) {
        let others: Vec<f64> = pairs
            .iter()
            .enumerate()
            .filter(|(j, p)| *j != k && seen(p))
            .map(|(_, p)| p.length_mm)
            .collect();
        // The pair that is tested has no part in what it is tested against.
        let [typical, spread] = median_and_sd(&others);
        let off = (pair.length_mm - typical).abs();
        let limit = (BEYOND_SD * pair.length_sd_mm.hypot(spread)).max(LENGTH_SHARE * typical);
        // A length that differs from one other alone is not that of this pair for sure; neither is
        // one that the groove confirms.
        let contradicted = match &pair.groove {
            Some(g) => !matches!(g.contact.as_str(), "vertex" | "double"),
            None => others.len() >= OTHERS,
        };
        if off > limit && contradicted {
            let groove = pair.groove.as_ref().map_or_else(String::new, |g| {
                format!(
                    ", and passes the groove's vertex at {:.2} mm",
                    g.distance_from_vertex_mm
                )
            });
            found.push((
                k,
                format!(
                    "the wire would be {:.2} mm long, {typical:.2} mm in the other pairs{groove}: pictures not taken together, or of another pose",
                    pair.length_mm
                ),
            ));
        }
    }
    found
}
