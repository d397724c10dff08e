//! Contacts of a record, each from all of its readings, averaged over the ways in which it may move
//! ([`crate::regimes`]); what is misstated of the record is so in all of them.

use crate::TrackError;
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::Assumed;
use crate::estimator::Contact;
use crate::known_motion::contact_path::{ContactPath, loaded};
use crate::known_motion::recursive::LEAD;
use crate::known_motion::segmenter::Segmenter;
use crate::known_motion::{
    Episode, EpisodeContact, EpisodeEstimate, MomentField, MotionRow, Settings, estimate_contact,
};
use crate::reading::{Moments, PERCENT, RowMotion};
use crate::regimes::{
    Alternative, ContactEvidence, ContactWeights, MIN_WEIGHT, Misstatement, POINT, Regime, Weighed,
};
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding};
use crate::static_arc::StaticArc;
use crate::track_document::ContactDocument;
use nalgebra::{Matrix2, Vector2, Vector3};
use rayon::prelude::*;
use wcal_core::order_statistics::median;
use wcal_core::stream::Flags;

/// Noise from pose to pose is one draw for poses nearer than this, mm: rows of a dense record are
/// not that many poses. An assumption.
const SAME_POSE_MM: f64 = 1.0;
/// Readings past the end of a contact that are looked at.
const PAST: usize = 2;

/// A contact with its weights.
pub(crate) struct WholeContact {
    /// Its readings, and their numbers.
    pub episode: Episode,
    pub numbers: Vec<usize>,
    /// Readings past its end, which show whether the load was lost at once.
    past: Vec<MotionRow>,
    weights: ContactWeights,
    /// As one at a point, with its weight and what would be misstated; those that may be, the fixed
    /// one first.
    points: Vec<(f64, Misstatement, EpisodeEstimate)>,
    /// As one that slides.
    sliding: SlidingContact,
    /// As the likeliest of the points: how far moments that are larger by 1 % move it, mm.
    point_mm_by_gain: f64,
}

/// A reading of a record along its motion.
pub(crate) struct Known {
    row: MotionRow,
    /// Its number among all readings.
    number: usize,
    piece: u32,
    push: Option<Vector3<f64>>,
    /// Variances of the misfit that readings share, where their own noise is known, (N mm)^2.
    misfit_nmm2: Option<[f64; 2]>,
}

impl Known {
    /// With its moments and motion.
    pub(crate) fn new(number: usize, row: MotionRow, m: &Moments, motion: &RowMotion) -> Self {
        // What of the noise from pose to pose is no noise of a reading.
        let misfit =
            |own: Matrix2<f64>| [0, 1].map(|c| (m.pose_nmm2[(c, c)] - own[(c, c)]).max(0.0));
        Self {
            row,
            number,
            piece: motion.piece,
            push: motion.push,
            misfit_nmm2: m.own_nmm2.map(misfit),
        }
    }
}

/// The contacts of all readings of a record; of a session, whose contacts stay, each piece is a
/// trajectory.
///
/// # Errors
/// Where moments or motion cannot be used.
pub(crate) fn located(
    of: &Assumed,
    mut known: Vec<Known>,
) -> Result<Vec<WholeContact>, TrackError> {
    let (touched, ranges) = if of.prior == POINT {
        known.sort_by_key(|k| k.piece);
        let mut to = 0;
        let range = |of: &[Known]| {
            to += of.len();
            [to - of.len(), to]
        };
        (
            None,
            known
                .chunk_by(|a, b| a.piece == b.piece)
                .map(range)
                .collect(),
        )
    } else {
        split_noise(&mut known, of.wire.stiffness_sd() > 0.0);
        (Some(of.wire.touched()?), ranges(&of.wire.field, &mut known))
    };
    let begun = |range: [usize; 2]| {
        let mut own = WholeContact::new(of, &known, range);
        let evidence = touched.as_ref().and_then(|touched| {
            own.slide(of, touched, Misstatement::NONE);
            own.evidence(of)
        });
        (own, evidence)
    };
    let found: Vec<(WholeContact, Option<ContactEvidence>)> =
        ranges.into_par_iter().map(begun).collect();
    let said = |e: &Option<ContactEvidence>| {
        e.as_ref()
            .map_or_else(Vec::new, ContactEvidence::of_misstatements)
    };
    let said: Vec<Vec<f64>> = found.iter().map(|f| said(&f.1)).collect();
    // Contacts are independent but for what is misstated, which is so in all of them: their
    // logarithms add up.
    let others = |n: usize| {
        let of = |m: usize| {
            said.iter()
                .enumerate()
                .filter(|(k, _)| *k != n)
                .filter_map(|(_, s)| s.get(m))
                .sum()
        };
        (0..said[n].len()).map(of).collect::<Vec<f64>>()
    };
    let weighed = |(n, (mut own, evidence)): (usize, (WholeContact, Option<ContactEvidence>))| {
        own.weights = evidence.map_or(own.weights, |e| e.weights(&others(n)));
        own.locate(of, touched.as_ref())?;
        Ok(own)
    };
    found.into_par_iter().enumerate().map(weighed).collect()
}

/// Noise of the readings, and the misfit of the calibration's law that they share.
///
/// Where the readings' own noise is known, the misfit S is an error that is none at the free wire
/// and grows with the moment, a matrix of gains of which nothing is known but its size:
/// `e_i = sum_j g_ij m_j / |m|_max`, `g_ij ~ N(0, S_ii / 2)`. Where it is not, rows of one pose
/// have one noise from pose to pose, and each counts for its share.
fn split_noise(known: &mut [Known], has_stiffness: bool) {
    // An error of the law is a smooth function of the moment: to first order a gain, largest at the
    // largest load.
    let size = |k: &Known| k.row.moment_nmm[0].hypot(k.row.moment_nmm[1]);
    let largest_nmm = known.iter().map(size).fold(1e-9, f64::max);
    let poses: Vec<f64> = (0..known.len()).map(|k| same_pose(known, k)).collect();
    for (
        Known {
            row, misfit_nmm2, ..
        },
        n,
    ) in known.iter_mut().zip(poses)
    {
        let Some(misfit) = misfit_nmm2 else {
            // Whether one reading is loaded does not depend on how many there are.
            let shared = row
                .shared_nmm
                .iter()
                .map(|h| Vector2::from(*h) * Vector2::from(*h).transpose());
            row.free_nmm2 = Some(row.noise_nmm2 + shared.sum::<Matrix2<f64>>());
            row.noise_nmm2 *= n;
            continue;
        };
        for (i, m) in [0, 1]
            .into_iter()
            .flat_map(|i| row.moment_nmm.map(|m| (i, m)))
        {
            let mut column = [0.0; 2];
            column[i] = (0.5 * misfit[i]).sqrt() * m / largest_nmm;
            // The stiffness stays the last.
            row.shared_nmm
                .insert(row.shared_nmm.len() - usize::from(has_stiffness), column);
        }
    }
}

/// Rows around one that are of its pose.
fn same_pose(known: &[Known], k: usize) -> f64 {
    let near =
        |other: &&Known| (other.row.moved_mm - known[k].row.moved_mm).norm() < 0.5 * SAME_POSE_MM;
    let (before, after) = known.split_at(k);
    (before.iter().rev().take_while(near).count() + after.iter().take_while(near).count()).max(1)
        as f64
}

/// First reading of each contact, the free ones before it that belong to it included, and one past
/// its last.
fn ranges(field: &MomentField, known: &mut [Known]) -> Vec<[usize; 2]> {
    let mut segmenter = Segmenter::new(field);
    let mut segments = Vec::new();
    for Known {
        row, piece, push, ..
    } in &mut *known
    {
        let is_loaded = loaded(row);
        segmenter.push(row, *piece, *push, is_loaded);
        segments.extend(segmenter.take_ended());
    }
    segmenter.interrupt();
    segments.extend(segmenter.take_ended());
    let mut free = 0;
    let range = |[first, last]: [usize; 2]| {
        let from = std::mem::replace(&mut free, last + 1).max(first.saturating_sub(LEAD));
        let same = |k: &usize| known[*k].piece == known[first].piece;
        [
            (from..first).rev().take_while(same).last().unwrap_or(first),
            last + 1,
        ]
    };
    segments.into_iter().map(range).collect()
}

/// How far two estimates are from each other, median over the readings, mm.
fn median_mm(a: &EpisodeEstimate, b: &EpisodeEstimate) -> f64 {
    let both = a.places.iter().zip(&b.places);
    median(both.filter_map(|(a, b)| Some((a.place_mm? - b.place_mm?).norm()))).unwrap_or(0.0)
}

impl WholeContact {
    fn new(of: &Assumed, known: &[Known], [from, to]: [usize; 2]) -> Self {
        let (first, n) = (&known[from], to - from);
        let past = known[to..]
            .iter()
            .take(PAST)
            .take_while(|k| k.piece == first.piece);
        let past = past.map(|k| k.row.clone()).collect();
        let (rows, numbers) = known[from..to]
            .iter()
            .map(|k| (k.row.clone(), k.number))
            .unzip();
        let (episode, sliding) = (
            Episode {
                rows,
                push: first.push,
            },
            SlidingContact::nothing(n),
        );
        let (weights, points) = (ContactWeights::prior(of.prior), Vec::new());
        Self {
            episode,
            numbers,
            past,
            weights,
            points,
            sliding,
            point_mm_by_gain: 0.0,
        }
    }

    /// Follows it as one that slides, where this is misstated.
    fn slide(&mut self, of: &Assumed, touched: &TouchedWire, misstated: Misstatement) {
        let (rows, _) =
            misstated.undone(&[&self.episode.rows[..], &self.past].concat(), &of.settings);
        self.sliding = locate_sliding(touched, &rows);
        self.sliding.places.truncate(self.numbers.len());
        self.sliding.arcs.truncate(self.numbers.len());
    }

    /// What its readings say of how it moves; none where the motion has no direction.
    fn evidence(&self, of: &Assumed) -> Option<ContactEvidence> {
        let (field, rows, sliding) = (&of.wire.field, &self.episode.rows, &self.sliding);
        let push = ContactPath::new(field, &self.episode)?.push;
        let first = rows.iter().position(loaded).unwrap_or(0);
        let before = first.checked_sub(1).map(|k| rows[k].clone());
        let (settings, blocks) = (of.settings, sliding.means.at_middles());
        let weighed = Weighed {
            field,
            settings,
            push,
            before,
            blocks,
            factors: true,
        };
        Some(weighed.evidence(of.prior, sliding.ln_evidence, sliding.supported()))
    }

    /// Locates it in each way that its weights allow.
    fn locate(&mut self, of: &Assumed, touched: Option<&TouchedWire>) -> Result<(), TrackError> {
        if let Some((touched, misstated)) = touched.zip(self.weights.misstated_slide()) {
            self.slide(of, touched, misstated);
        }
        let Episode { rows, push } = &self.episode;
        let located = |rows: &[MotionRow], creep_sd: f64, misstated: Misstatement| {
            let (rows, settings) = misstated.undone(rows, &of.settings);
            let episode = Episode { rows, push: *push };
            estimate_contact(
                &of.wire.field,
                &episode,
                &Settings {
                    creep_sd,
                    ..settings
                },
            )
        };
        for (n, (weight, creep_sd, misstated)) in self.weights.points().into_iter().enumerate() {
            // The fixed point's innovations are looked at whatever its weight.
            if n == 0 || weight > MIN_WEIGHT {
                self.points
                    .push((weight, misstated, located(rows, creep_sd, misstated)?));
            }
        }
        if touched.is_some() {
            let larger = |r: &MotionRow| MotionRow {
                moment_nmm: r.moment_nmm.map(|m| m * PERCENT),
                ..r.clone()
            };
            let larger: Vec<MotionRow> = rows.iter().map(larger).collect();
            let moved = located(&larger, 0.0, Misstatement::NONE)?;
            self.point_mm_by_gain = median_mm(&moved, self.point());
        }
        Ok(())
    }

    /// How far moments that are larger by 1 % move it, mm.
    pub(crate) fn mm_by_gain(&self) -> f64 {
        if self.weights.slides() {
            self.sliding.mm_by_gain
        } else {
            self.point_mm_by_gain
        }
    }

    /// The likeliest of the points along the motion as it is stated.
    pub(crate) fn point(&self) -> &EpisodeEstimate {
        let own = self.points.iter().filter(|p| p.1 == Misstatement::NONE);
        &own.max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or(&self.points[0])
            .2
    }

    /// What stays in doubt.
    pub(crate) fn flags(&self) -> Flags {
        self.weights
            .flags(self.point().disagrees(), self.sliding.sure())
    }

    /// For track.json.
    pub(crate) fn document(&self) -> ContactDocument {
        let rows = &self.episode.rows;
        let span_s = [rows[0].t_s, rows[rows.len() - 1].t_s];
        let found = ContactDocument::of_table(
            self.point(),
            &self.weights,
            &self.sliding,
            span_s,
            rows.len(),
        );
        ContactDocument {
            mm_by_gain_percent: Some(self.mm_by_gain()),
            ..found
        }
    }

    /// As one that slides at a reading: where the path has no place yet, that of the nearest
    /// reading goes with the object.
    fn slid(&self, k: usize) -> Option<(EpisodeContact, ArcDensity)> {
        let (rows, places) = (&self.episode.rows, &self.sliding.places);
        let located = (0..places.len()).filter(|j| places[*j].place_mm.is_some());
        let near = located
            .min_by_key(|j| j.abs_diff(k))
            .filter(|near| *near == k || !self.weights.slides())?;
        // A point of a rigid object goes with it.
        let turn = rows[k].turn * rows[near].turn.inverse();
        let place = EpisodeContact {
            place_mm: places[near]
                .place_mm
                .map(|at| turn * (at - rows[near].moved_mm) + rows[k].moved_mm),
            contact: if near == k { places[k].contact } else { 0.0 },
            ..places[near].clone()
        };
        Some((place, self.sliding.arcs[near].clone()))
    }

    /// What is stated of a reading.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn stated(&self, k: usize, alone: &mut StaticArc) -> Result<Contact, TrackError> {
        let of_point = |(weight, _, found): &(f64, Misstatement, EpisodeEstimate)| Alternative {
            weight: *weight,
            place: found.places[k].clone(),
            arc: found.arcs[k].clone(),
        };
        let mut all: Vec<Alternative> = self.points.iter().map(of_point).collect();
        let (weight, slid) = (self.weights.sliding(), self.slid(k));
        let row = &self.episode.rows[k];
        // Before its first place a contact that slides is not known to be anywhere.
        if self.weights.slides() && slid.is_none() {
            let flags = if loaded(row) {
                self.flags()
            } else {
                Flags::default()
            };
            return Ok(Contact {
                flags,
                ..Contact::default()
            });
        }
        all.extend(
            slid.filter(|_| weight > MIN_WEIGHT)
                .map(|slid| Alternative::from((weight, slid))),
        );
        let weight = self.weights.regimes.of(Regime::Anywhere);
        if weight > MIN_WEIGHT && loaded(row) {
            let sd_nmm = [0, 1].map(|c| row.noise_nmm2[(c, c)].sqrt());
            let (e, arc) = alone.allowed(row.moment_nmm, sd_nmm)?;
            let (place_mm, covariance_mm2) = (Some(e.place_mm), e.covariance_mm2);
            let place = EpisodeContact {
                place_mm,
                covariance_mm2,
                contact: 1.0,
                outlier: false,
            };
            all.push(Alternative { weight, place, arc });
        }
        let belongs = !self.flags().has(Flags::MOTION_DISAGREES);
        let found = Contact::averaged(&all, self.flags(), |_| belongs);
        // Outside of a contact nothing is in doubt.
        let held = loaded(row) || found.estimate.is_some_and(|e| e.probability > 0.5);
        Ok(if held {
            found
        } else {
            Contact {
                flags: Flags::default(),
                ..found
            }
        })
    }

    /// What is said of it, for people.
    pub(crate) fn sentences(&self) -> Vec<String> {
        let weights = &self.weights;
        let said = match (weights.certain(), weights.misstatement) {
            (Some(Regime::Misstated), Some((m, _))) => Some(format!("{}; marked motion-disagrees in status", m.sentence())),
            _ if self.flags().has(Flags::MOTION_DISAGREES) => {
                let said = self.point().innovations.sentence();
                let said = said.unwrap_or_else(|| "the motion says nothing of the moments".to_owned());
                Some(format!("{said}; marked motion-disagrees in status"))
            }
            (None, _) if self.flags().has(Flags::UNDECIDED) => Some("a way in which its point of the object may move could not be looked at, for want of \
                 readings; marked undecided in status".to_owned()),
            (None, _) => Some("whether its point of the object stays, creeps or slides is not decided; places and regions are those of all".to_owned()),
            (Some(Regime::Sliding), _) if !self.sliding.sure() => Some("the fit of a sliding contact leaves more than noise, depends on its \
                 start, or the motion turns back: the contact may be lost, and its regions are wide; marked sliding-assumed in status"
                .to_owned()),
            (Some(Regime::Sliding), _) => Some("it slides over the object".to_owned()),
            _ => None,
        };
        let slips = self
            .sliding
            .slips
            .iter()
            .filter(|_| weights.slides())
            .map(|k| {
                format!(
                    "it slips to another place of the object before {:.2} s",
                    self.episode.rows[*k].t_s
                )
            });
        said.into_iter().chain(slips).collect()
    }
}
