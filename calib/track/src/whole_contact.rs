//! Contacts of a record, each from all of its readings, averaged over the ways in which it may move
//! ([`crate::regimes`]); what is misstated of the record is so in all of them.

use crate::TrackError;
use crate::arc::StaticArc;
use crate::estimator::Contact;
use crate::known_motion::contact_path::{ContactPath, loaded};
use crate::known_motion::recursive::LEAD;
use crate::known_motion::segmenter::Segmenter;
use crate::known_motion::{
    Episode, EpisodeContact, EpisodeEstimate, MomentField, MotionRow, Posterior, Settings,
    estimate_contact, larger,
};
use crate::reading::{Moments, RowMotion, squares};
use crate::regimes::{
    Assumed, ContactEvidence, ContactWeights, MIN_WEIGHT, Misstatement, REGIMES, Regime, Weighed,
};
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding};
use crate::track_document::{ContactDocument, SlidingDocument};
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
    episode: Episode,
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
        let misfit = |own: Matrix2<f64>| (m.pose_nmm2 - own).diagonal().map(|v| v.max(0.0)).into();
        Self {
            row,
            number,
            piece: motion.piece,
            push: motion.push,
            misfit_nmm2: m.own_nmm2.map(misfit),
        }
    }
}

/// The contacts of all readings of a record.
///
/// # Errors
/// Where moments or motion cannot be used.
pub(crate) fn located(
    of: &Assumed,
    mut known: Vec<Known>,
) -> Result<Vec<WholeContact>, TrackError> {
    split_noise(&mut known, of.wire.stiffness_sd() > 0.0);
    let (touched, ranges) = (of.wire.touched()?, ranges(&of.wire.field, &mut known));
    let begun = |range: [usize; 2]| {
        let mut own = WholeContact::new(of, &known, range);
        own.slide(of, &touched, Misstatement::NONE);
        let evidence = own.evidence(of);
        (own, evidence)
    };
    let found: Vec<(WholeContact, Option<ContactEvidence>)> =
        ranges.into_par_iter().map(begun).collect();
    let said = found.iter().map(|(_, e)| e.as_ref());
    let said = said.map(|e| e.map_or_else(Vec::new, ContactEvidence::of_misstatements));
    let said: Vec<Vec<f64>> = said.collect();
    // Contacts are independent but for what is misstated, which is so in all of them: their
    // logarithms add up.
    let others = |n: usize| {
        let others = || (0..said.len()).filter(|k| *k != n);
        let of = |m: usize| others().filter_map(|k| said[k].get(m)).sum();
        (0..said[n].len()).map(of).collect::<Vec<f64>>()
    };
    let weighed = |(n, (mut own, evidence)): (usize, (WholeContact, Option<ContactEvidence>))| {
        own.weights = evidence.map_or(own.weights, |e| e.weights(&others(n)));
        own.locate(of, &touched)?;
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
    let sizes = known.iter().map(|k| squares(&[k.row.moment_nmm]).sqrt());
    let largest_nmm = sizes.fold(1e-9, f64::max);
    let of_pose = |k: usize| {
        let at = known[k].row.moved_mm;
        let near = |other: &&Known| (other.row.moved_mm - at).norm() < 0.5 * SAME_POSE_MM;
        let (before, after) = known.split_at(k);
        let before = before.iter().rev().take_while(near).count();
        (before + after.iter().take_while(near).count()).max(1) as f64
    };
    let poses: Vec<f64> = (0..known.len()).map(of_pose).collect();
    for (known, rows_of_pose) in known.iter_mut().zip(poses) {
        let row = &mut known.row;
        let Some(misfit) = known.misfit_nmm2 else {
            // Whether one reading is loaded does not depend on how many there are.
            let columns = row.shared_nmm.iter().map(|h| Vector2::from(*h));
            let shared: Matrix2<f64> = columns.map(|h| h * h.transpose()).sum();
            row.free_nmm2 = Some(row.noise_nmm2 + shared);
            row.noise_nmm2 *= rows_of_pose;
            continue;
        };
        // The stiffness stays the last.
        let at = row.shared_nmm.len() - usize::from(has_stiffness);
        let gain = |i: usize, m: f64| (0.5 * misfit[i]).sqrt() * m / largest_nmm;
        let [y, z] = row.moment_nmm;
        let columns = [
            [gain(0, y), 0.0],
            [gain(0, z), 0.0],
            [0.0, gain(1, y)],
            [0.0, gain(1, z)],
        ];
        row.shared_nmm.splice(at..at, columns);
    }
}

/// First reading of each contact, the free ones before it that belong to it included, and one past
/// its last.
fn ranges(field: &MomentField, known: &mut [Known]) -> Vec<[usize; 2]> {
    let mut segmenter = Segmenter::new(field);
    let mut segments = Vec::new();
    for known in &mut *known {
        let is_loaded = loaded(&known.row);
        segmenter.push(&mut known.row, known.piece, known.push, is_loaded);
        segments.extend(segmenter.take_ended());
    }
    segmenter.interrupt();
    segments.extend(segmenter.take_ended());
    let mut free = 0;
    let range = |[first, last]: [usize; 2]| {
        // A free reading bounds one onset only: none is taken for two contacts.
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
        let first = &known[from];
        let rows = |of: &[Known]| of.iter().map(|k| k.row.clone()).collect();
        let past = known[to..].iter().take(PAST);
        let past = past.take_while(|k| k.piece == first.piece).count();
        Self {
            episode: Episode {
                rows: rows(&known[from..to]),
                push: first.push,
            },
            numbers: known[from..to].iter().map(|k| k.number).collect(),
            past: rows(&known[to..to + past]),
            weights: ContactWeights::prior(of.prior),
            points: Vec::new(),
            sliding: SlidingContact::nothing(to - from),
            point_mm_by_gain: 0.0,
        }
    }

    /// Follows it as one that slides, where this is misstated.
    fn slide(&mut self, of: &Assumed, touched: &TouchedWire, misstated: Misstatement) {
        let (rows, _) =
            misstated.undone(&[&self.episode.rows[..], &self.past].concat(), &of.settings);
        self.sliding = locate_sliding(touched, &rows);
        self.sliding.places.truncate(self.numbers.len());
    }

    /// What its readings say of how it moves; none where the motion has no direction.
    fn evidence(&self, of: &Assumed) -> Option<ContactEvidence> {
        let (rows, sliding) = (&self.episode.rows, &self.sliding);
        let first = rows.iter().position(loaded).unwrap_or(0);
        let weighed = Weighed {
            of,
            push: ContactPath::new(&of.wire.field, &self.episode)?.push,
            before: first.checked_sub(1).map(|k| rows[k].clone()),
            blocks: sliding.means.at_middles(),
            factors: true,
        };
        Some(weighed.evidence(sliding.ln_evidence, sliding.supported()))
    }

    /// Locates it in each way that its weights allow.
    fn locate(&mut self, of: &Assumed, touched: &TouchedWire) -> Result<(), TrackError> {
        if let Some(misstated) = self.weights.misstated_slide() {
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
        // A motion hardly shows an error of the gain: how far 1 % of it moves the place is stated.
        let moved = located(&larger(rows), 0.0, Misstatement::NONE)?;
        self.point_mm_by_gain = median_mm(&moved, self.point());
        Ok(())
    }

    /// How far moments that are larger by 1 % move it, mm.
    fn mm_by_gain(&self) -> f64 {
        if self.weights.slides() {
            self.sliding.mm_by_gain
        } else {
            self.point_mm_by_gain
        }
    }

    /// The likeliest of the points along the motion as it is stated.
    fn point(&self) -> &EpisodeEstimate {
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
        let (rows, point, sliding) = (&self.episode.rows, self.point(), &self.sliding);
        let certain = self.weights.certain();
        let weights = &self.weights.regimes;
        let own = ContactDocument::new(&point.innovations, rows.len());
        let slides = SlidingDocument {
            log_evidence: sliding.evidence,
            reversed_log_evidence: sliding.reversed_evidence,
            predicted: sliding.predicted,
        };
        let is_at_a_point = weights.at_a_point() > 1.0 - MIN_WEIGHT;
        let regions = point.posterior.as_ref().map(Posterior::regions);
        let is_a_point = weights.of(Regime::Sliding) <= 0.5;
        ContactDocument {
            regions: regions.filter(|_| is_at_a_point),
            from_s: Some(rows[0].t_s),
            to_s: Some(rows[rows.len() - 1].t_s),
            disagreement: own.disagreement.filter(|_| is_a_point),
            contact: Some(certain.map_or("undecided", Regime::name)),
            weights: Some(REGIMES.iter().map(|r| (r.name(), weights.of(*r))).collect()),
            sliding: Some((weights.of(Regime::Sliding) > MIN_WEIGHT).then_some(slides)),
            mm_by_gain_percent: Some(self.mm_by_gain()),
            ..own
        }
    }

    /// As one that slides at a reading: where the path has no place yet, that of the nearest
    /// reading goes with the object.
    fn slid(&self, k: usize) -> Option<EpisodeContact> {
        let (rows, places) = (&self.episode.rows, &self.sliding.places);
        let located = (0..places.len()).filter(|j| places[*j].place_mm.is_some());
        let near = located
            .min_by_key(|j| j.abs_diff(k))
            .filter(|near| *near == k || !self.weights.slides())?;
        // A point of a rigid object goes with it.
        let turn = rows[k].turn * rows[near].turn.inverse();
        Some(EpisodeContact {
            place_mm: places[near]
                .place_mm
                .map(|at| turn * (at - rows[near].moved_mm) + rows[k].moved_mm),
            contact: if near == k { places[k].contact } else { 0.0 },
            ..places[near].clone()
        })
    }

    /// What is stated of a reading.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn stated(&self, k: usize, alone: &mut StaticArc) -> Result<Contact, TrackError> {
        let points = self.points.iter();
        let mut all: Vec<(f64, EpisodeContact)> = points
            .map(|(weight, _, found)| (*weight, found.places[k].clone()))
            .collect();
        let (weight, slid) = (self.weights.sliding(), self.slid(k));
        let row = &self.episode.rows[k];
        if self.weights.slides() && slid.is_none() {
            // Before its first place a contact that slides is not known to be anywhere.
            all.clear();
        } else {
            let slid = slid.filter(|_| weight > MIN_WEIGHT);
            all.extend(slid.map(|slid| (weight, slid)));
            // Moments alone place the contact of a reading that is loaded beyond its noise.
            let weight = self.weights.regimes.of(Regime::Anywhere);
            if weight > MIN_WEIGHT && loaded(row) {
                let sd_nmm = [0, 1].map(|c| row.noise_nmm2[(c, c)].sqrt());
                let (e, arc) = alone.allowed(row.moment_nmm, sd_nmm)?;
                let anywhere = EpisodeContact {
                    place_mm: Some(e.place_mm),
                    covariance_mm2: e.covariance_mm2,
                    contact: 1.0,
                    outlier: false,
                    arc,
                };
                all.push((weight, anywhere));
            }
        }
        let flags = self.flags();
        let belongs = !flags.has(Flags::MOTION_DISAGREES);
        let mut found = Contact::averaged(&all, flags, |_| belongs);
        // Outside of a contact nothing is in doubt.
        if !loaded(row) && found.estimate.is_none_or(|e| e.probability <= 0.5) {
            found.flags = Flags::default();
        }
        Ok(found)
    }

    /// What is said of it, for people.
    pub(crate) fn sentences(&self) -> Vec<String> {
        let weights = &self.weights;
        let disagrees = self.flags().has(Flags::MOTION_DISAGREES);
        let said = match (weights.certain(), weights.misstatement) {
            (Some(Regime::Misstated), Some((m, _))) => format!("{}; marked motion-disagrees in status", m.sentence()),
            _ if disagrees => {
                let said = self.point().innovations.sentence();
                let said = said.unwrap_or_else(|| "the motion says nothing of the moments".to_owned());
                format!("{said}; marked motion-disagrees in status")
            }
            (None, _) if self.flags().has(Flags::UNDECIDED) => "a way in which its point of the object may move could not be looked at, for want of \
                 readings; marked undecided in status".to_owned(),
            (None, _) => "whether its point of the object stays, creeps or slides is not decided; places and regions are those of all".to_owned(),
            (Some(Regime::Sliding), _) if !self.sliding.sure() => "the fit of a sliding contact leaves more than noise, depends on its \
                 start, or the motion turns back: the contact may be lost, and its regions are wide; marked sliding-assumed in status"
                .to_owned(),
            (Some(Regime::Sliding), _) => "it slides over the object".to_owned(),
            _ => String::new(),
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
        [said]
            .into_iter()
            .filter(|said| !said.is_empty())
            .chain(slips)
            .collect()
    }
}
