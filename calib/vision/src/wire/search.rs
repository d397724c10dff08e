//! The search for the wire of one pair: dark or bright, from the tags' root or one near it, and the
//! test for a second wire.

use crate::picture::Picture;
use crate::rig::Rig;
use crate::stereo::StereoCameras;
use crate::wire::beam::{BEAM, BeamResult, WIDE_BEAM, beam_search};
use crate::wire::ridge::{Evidence, RidgeMap};
use crate::wire::scene::{Scene, expected_strength};
use nalgebra::Isometry3;

/// Evidence per millimetre and picture below which there is no wire: a tenth of the largest score
/// of a place, at three places a mm.
const MIN_EVIDENCE: f64 = 1.2;
/// A second line from the root with this share of the first one's length and of its evidence a
/// millimetre is a wire as well; where the first one covers it, it has no evidence.
const RIVAL_LENGTH_SHARE: f64 = 0.4;
const RIVAL_SHARE: f64 = 0.15;
/// Share of the evidence a millimetre above which a line is searched again with a wider beam.
const SUSPECT_SHARE: f64 = 0.05;
/// Curves kept in the search for a second wire: it needs to be found only, not measured.
const RIVAL_BEAM: usize = 120;
/// Distance from the first wire, in its widths, within which evidence is ignored.
const COVERED_WIDTHS: f64 = 3.0;
/// Share of the nominal length at which a line is the whole wire.
const LONG_SHARE: f64 = 0.9;
/// Evidence that both pictures together can give, a millimetre: two pictures, three places, at most
/// 4 each.
const MAX_EVIDENCE: f64 = 24.0;
/// Share of the evidence along the nominal length at which a line is the wire: one of the other
/// polarity does not beat it.
const CONVINCING_SHARE: f64 = 0.4;
/// Share below which the beam was too narrow, or the wire starts away from the tags' root.
const SOUND_SHARE: f64 = 0.6;
/// Radius of the search for another root, mm.
const ASIDE_MM: f64 = 2.0;
/// Factor by which the evidence of a line from another root must exceed that from the stated one.
const BETTER: f64 = 1.2;

/// A line that was found, its polarity (+1 dark), and the wire's response in both pictures.
struct FoundWire {
    result: BeamResult,
    polarity: f64,
    strength: [f64; 2],
}

struct Search<'a> {
    stereo: &'a StereoCameras,
    rig: &'a Rig,
    left_from_base: &'a Isometry3<f64>,
    maps: &'a [RidgeMap<'a>; 2],
    background: [Vec<f64>; 2],
    beam: usize,
}

impl Search<'_> {
    fn scene(&self, strength: [f64; 2], polarity: f64) -> Scene<'_> {
        let evidence = [0, 1].map(|k| Evidence::new(&self.background[k], strength[k], polarity));
        Scene::new(self.stereo, self.left_from_base, self.maps, evidence)
    }

    /// The likelier of the best dark and the best bright line from a root up to `aside_mm` from the
    /// stated one.
    fn best(&self, aside_mm: f64) -> Option<FoundWire> {
        let whisker = &self.rig.whisker;
        let strengths = [1.0, -1.0].map(|polarity| {
            let expected = expected_strength(
                self.stereo,
                self.left_from_base,
                self.maps,
                whisker,
                polarity,
                aside_mm,
            );
            (polarity, expected)
        });
        // Beside a bright line lie two fainter dark ones: the stronger polarity is the line's own.
        let [dark, bright] = strengths.map(|(_, s)| s[0] + s[1]);
        let order = if dark >= bright { [0, 1] } else { [1, 0] };
        let mut best: Option<FoundWire> = None;
        for (polarity, mut strength) in order.map(|k| strengths[k]) {
            // The second search knows how strong the wire of the first one answers.
            for _ in 0..2 {
                let scene = self.scene(strength, polarity);
                let Some(result) = beam_search(&scene, whisker, self.beam, aside_mm, false) else {
                    break;
                };
                let settled = (0..2).all(|k| (result.strength[k] / strength[k] - 1.0).abs() < 0.2);
                for (s, f) in strength.iter_mut().zip(result.strength) {
                    if f.is_finite() {
                        *s = f;
                    }
                }
                if best.as_ref().is_none_or(|b| result.score > b.result.score) {
                    best = Some(FoundWire {
                        result,
                        polarity,
                        strength,
                    });
                }
                if settled {
                    break;
                }
            }
            if best
                .as_ref()
                .is_some_and(|b| b.result.score > CONVINCING_SHARE * self.max_score())
            {
                break;
            }
        }
        // A groove's edges can displace the wire from the beam: a result that is too short or too
        // faint is searched again with a wider one.
        let poor = |t: &BeamResult| {
            t.length_mm < LONG_SHARE * whisker.length_mm || t.score < SOUND_SHARE * self.max_score()
        };
        if self.beam < WIDE_BEAM
            && let Some(found) = &mut best
            && poor(&found.result)
            && let scene = self.scene(found.strength, found.polarity)
            && let Some(wider) = beam_search(&scene, whisker, WIDE_BEAM, aside_mm, false)
            && wider.score > found.result.score
        {
            found.result = wider;
        }
        best
    }

    /// Evidence that a wire of nominal length can have.
    fn max_score(&self) -> f64 {
        MAX_EVIDENCE * self.rig.whisker.length_mm
    }
}

/// Searches for a dark and for a bright wire; the likelier one with its polarity, +1 dark.
/// `root_free`: the wire is known to start away from the tags' root. `wide`: with wider beams from
/// the start, which cross gaps.
pub(crate) fn find_wire(
    stereo: &StereoCameras,
    rig: &Rig,
    pictures: &[Picture; 2],
    left_from_base: &Isometry3<f64>,
    root_free: bool,
    wide: bool,
) -> Result<(BeamResult, f64), String> {
    let depth = left_from_base.translation.z;
    let width = rig.whisker.diameter_mm * stereo.cameras[0].focal_px[0] / depth;
    // The response to a bar is largest at the scale width / (2 sqrt 3) (Steger 1998, eq. 11); below
    // 1.2 px noise would dominate.
    let scale = (width / 12f64.sqrt()).max(1.2);
    let maps = pictures
        .each_ref()
        .map(|picture| RidgeMap::new(picture, scale));
    let background = maps.each_ref().map(|map| map.background(60_000));
    let search = Search {
        stereo,
        rig,
        left_from_base,
        maps: &maps,
        background,
        beam: if wide { WIDE_BEAM } else { BEAM },
    };
    let score = |f: &Option<FoundWire>| f.as_ref().map_or(0.0, |f| f.result.score);
    let mut best = search.best(0.0);
    if root_free || score(&best) < SOUND_SHARE * search.max_score() {
        let elsewhere = search.best(ASIDE_MM);
        // Of many roots one fits better by chance: unasked, it has to win by a factor.
        let factor = if root_free { 1.0 } else { BETTER };
        if score(&elsewhere) > factor * score(&best) {
            best = elsewhere;
        }
    }
    let FoundWire {
        result: found,
        polarity,
        strength,
    } = best.ok_or("no wire: nothing like a line leaves the root")?;
    if found.score < 2.0 * MIN_EVIDENCE * found.length_mm
        || found.length_mm < 0.3 * rig.whisker.length_mm
    {
        return Err(format!(
            "no wire: the best line from the root is {:.0} mm long with a log likelihood ratio of {:.0}",
            found.length_mm, found.score
        ));
    }
    let scene = search
        .scene(strength, polarity)
        .without(&found.path, COVERED_WIDTHS * width);
    let density = |t: &BeamResult| t.score / t.length_mm;
    let second = |beam| beam_search(&scene, &rig.whisker, beam, 0.0, true);
    // A narrow beam first: hardly anything passes it where there is one wire.
    let suspect = second(RIVAL_BEAM).is_some_and(|t| density(&t) > SUSPECT_SHARE * density(&found));
    if suspect
        && let Some(rival) = second(WIDE_BEAM)
        && density(&rival) > RIVAL_SHARE * density(&found)
        && rival.length_mm > RIVAL_LENGTH_SHARE * found.length_mm
    {
        return Err(format!(
            "two wires leave the root: {:.0} mm and {:.0} mm long, log likelihood ratios {:.0} and {:.0}",
            found.length_mm, rival.length_mm, found.score, rival.score
        ));
    }
    Ok((found, polarity))
}
