//! Contacts of a table along a known motion: its episodes one by one, each from all of its readings, averaged over the ways in which a contact may
//! move ([`crate::regimes`]); no network.

use crate::ContactError;
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, Estimator, Findings};
use crate::known_motion::contact_path::{ContactPath, loaded};
use crate::known_motion::{
    Episode, EpisodeContact, EpisodeEstimate, MomentField, MotionRow, Posterior, Settings, episodes,
    estimate_contact,
};
use crate::reading::{MotionAccuracy, PERCENT, Reading};
use crate::regimes::{
    ANY_OBJECT, Alternative, ContactEvidence, ContactWeights, GAIN, MIN_WEIGHT, Misstatement, Regime,
    RegimeWeights, SWEPT_OBJECT, Weighed,
};
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding};
use crate::static_arc::StaticArc;
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::Matrix2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_core::stream::Flags;

/// Noise from pose to pose is one draw for poses nearer than this, mm: rows of a dense record are not that many poses. An assumption.
const SAME_POSE_MM: f64 = 1.0;
/// Readings past the end of an episode, which show whether the load was lost at once.
const PAST: usize = 2;

/// A contact of the table.
struct TableContact {
    /// Its readings among those whose motion is known: first, and one past the last.
    range: [usize; 2],
    span_s: [f64; 2],
    weights: ContactWeights,
    /// As one at a point, with its weight and what would be misstated; those that may be, the fixed one first.
    points: Vec<(f64, Misstatement, EpisodeEstimate)>,
    /// As one that slides.
    sliding: SlidingContact,
    /// As the likeliest of the points: how far moments that are larger by 1 % move it, mm.
    point_mm_by_gain: f64,
}

impl TableContact {
    /// How far moments that are larger by 1 % move it, mm.
    fn mm_by_gain(&self) -> f64 {
        if self.weights.slides() { self.sliding.mm_by_gain } else { self.point_mm_by_gain }
    }

    /// The likeliest of the points along the motion as it is stated.
    fn point(&self) -> &EpisodeEstimate {
        let own = self.points.iter().filter(|p| p.1 == Misstatement::NONE);
        &own.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or(&self.points[0]).2
    }

    fn flags(&self) -> Flags {
        self.weights.flags(self.point().disagrees(), self.sliding.sure())
    }

    /// As one that slides at a reading: where the path has no place yet, that of the nearest reading goes with the object.
    fn slid(&self, rows: &[MotionRow], k: usize) -> Option<(EpisodeContact, ArcDensity)> {
        let places = &self.sliding.places;
        let located = (0..places.len()).filter(|j| places[*j].place_mm.is_some());
        let near =
            located.min_by_key(|j| j.abs_diff(k)).filter(|near| *near == k || !self.weights.slides())?;
        // A point of a rigid object goes with it.
        let turn = rows[k].turn * rows[near].turn.inverse();
        let place = EpisodeContact {
            place_mm: places[near].place_mm.map(|at| turn * (at - rows[near].moved_mm) + rows[k].moved_mm),
            ..places[near].clone()
        };
        Some((place, self.sliding.arcs[near].clone()))
    }

    /// What is stated of a reading.
    fn stated(&self, rows: &[MotionRow], k: usize, alone: &mut StaticArc) -> Result<Contact, ContactError> {
        let mut all = Vec::new();
        for (weight, _, found) in &self.points {
            let arc = found.posterior.as_ref().map(Posterior::arc).unwrap_or_default();
            all.push(Alternative { weight: *weight, place: found.places[k].clone(), arc });
        }
        let weight = self.weights.sliding();
        let slid = self.slid(rows, k);
        // Before its first place a contact that slides is not known to be anywhere.
        if self.weights.slides() && slid.is_none() {
            return Ok(Contact { flags: self.flags(), ..Contact::default() });
        }
        all.extend(slid.filter(|_| weight > MIN_WEIGHT).map(|(place, arc)| Alternative {
            weight,
            place,
            arc,
        }));
        let weight = self.weights.regimes.of(Regime::Anywhere);
        if weight > MIN_WEIGHT && loaded(&rows[k]) {
            let sd_nmm = [0, 1].map(|c| rows[k].noise_nmm2[(c, c)].sqrt());
            let (estimate, arc) = alone.allowed(rows[k].moment_nmm, sd_nmm)?;
            let place = EpisodeContact {
                place_mm: Some(estimate.place_mm),
                covariance_mm2: estimate.covariance_mm2,
                contact: 1.0,
                outlier: false,
            };
            all.push(Alternative { weight, place, arc });
        }
        let belongs = !self.flags().has(Flags::MOTION_DISAGREES);
        Ok(Contact::averaged(&all, self.flags(), |_| belongs))
    }
}

/// The estimator of a table.
pub struct KnownMotionTable {
    wire: CalibratedWire,
    touched: TouchedWire,
    accuracy: MotionAccuracy,
    /// In a sweep over an object a contact slides by its nature and is no doubt; elsewhere a wrong motion or calibration is as likely.
    prior: RegimeWeights,
    /// Readings whose motion is known, the piece of the motion that each is in, and its number among all.
    rows: Vec<MotionRow>,
    pieces: Vec<u32>,
    index: Vec<usize>,
    readings: usize,
    lost: BTreeMap<&'static str, u64>,
    /// Which readings have no motion.
    without: Vec<usize>,
    /// By row: variances of the misfit that readings share, where their own noise is known, (N mm)^2.
    misfit_nmm2: Vec<Option<[f64; 2]>>,
    contacts: Vec<TableContact>,
}

impl KnownMotionTable {
    /// Of a whisker's wire.
    ///
    /// # Errors
    /// Where it cannot be bent.
    pub fn new(
        wire: CalibratedWire,
        accuracy: MotionAccuracy,
        over_object: bool,
    ) -> Result<Self, ContactError> {
        Ok(Self {
            touched: wire.touched()?,
            wire,
            accuracy,
            prior: if over_object { SWEPT_OBJECT } else { ANY_OBJECT },
            rows: Vec::new(),
            pieces: Vec::new(),
            index: Vec::new(),
            readings: 0,
            lost: BTreeMap::new(),
            without: Vec::new(),
            misfit_nmm2: Vec::new(),
            contacts: Vec::new(),
        })
    }

    /// Noise of the readings, and the misfit of the calibration's law that they share.
    ///
    /// Where the readings' own noise is known, the misfit S is an error that is none at the free wire and grows with the moment, a matrix of
    /// gains of which nothing is known but its size: `e_i = sum_j g_ij m_j / |m|_max`, `g_ij ~ N(0, S_ii / 2)`. Where it is not, rows of one
    /// pose have one noise from pose to pose, and each counts for its share.
    fn split_noise(&mut self) {
        // An error of the law is a smooth function of the moment: to first order a gain, largest at the largest load.
        let size = |r: &MotionRow| r.moment_nmm[0].hypot(r.moment_nmm[1]);
        let largest_nmm = self.rows.iter().map(size).fold(1e-9, f64::max);
        let poses: Vec<f64> = (0..self.rows.len()).map(|k| same_pose(&self.rows, k)).collect();
        for ((row, misfit), n) in self.rows.iter_mut().zip(&self.misfit_nmm2).zip(poses) {
            let Some(misfit) = misfit else {
                row.noise_nmm2 *= n;
                continue;
            };
            for (i, m) in [0, 1].into_iter().flat_map(|i| row.moment_nmm.map(|m| (i, m))) {
                let mut column = [0.0; 2];
                column[i] = (0.5 * misfit[i]).sqrt() * m / largest_nmm;
                // The stiffness stays the last.
                let at = row.shared_nmm.len() - usize::from(self.wire.stiffness_sd() > 0.0);
                row.shared_nmm.insert(at, column);
            }
        }
    }

    /// As one that slides, and what its readings say of how it moves; none where the motion has no direction.
    fn evidence(&self, [from, to]: [usize; 2]) -> (SlidingContact, Option<ContactEvidence>) {
        let (field, rows) = (&self.wire.field, &self.rows[from..to]);
        let settings = self.wire.settings(&self.accuracy);
        let sliding = self.slid([from, to], Misstatement::NONE);
        let episode = Episode { rows: rows.to_vec(), push: None };
        let evidence = ContactPath::new(field, &episode).map(|path| {
            let first = rows.iter().position(loaded).unwrap_or(0);
            let before = first.checked_sub(1).map(|k| rows[k].clone());
            let blocks = sliding.means.at_middles();
            let weighed = Weighed { field, settings, push: path.push, before, blocks, factors: true };
            weighed.evidence(self.prior, sliding.ln_evidence, sliding.sure())
        });
        (sliding, evidence)
    }

    /// As one that slides, where this is misstated.
    fn slid(&self, [from, to]: [usize; 2], misstated: Misstatement) -> SlidingContact {
        let past = self.pieces[to..].iter().take(PAST).take_while(|p| **p == self.pieces[from]).count();
        let (rows, _) = misstated.undone(&self.rows[from..to + past], &self.wire.settings(&self.accuracy));
        let mut sliding = locate_sliding(&self.touched, &rows);
        sliding.places.truncate(to - from);
        sliding.arcs.truncate(to - from);
        sliding
    }

    /// The contact of an episode with its weights.
    fn contact(
        &self,
        range: [usize; 2],
        sliding: SlidingContact,
        weights: ContactWeights,
    ) -> Result<TableContact, ContactError> {
        let (field, rows) = (&self.wire.field, &self.rows[range[0]..range[1]]);
        let settings = self.wire.settings(&self.accuracy);
        let mut points = Vec::new();
        for (n, (weight, creep_sd, misstated)) in weights.points().into_iter().enumerate() {
            // The fixed point's innovations are looked at whatever its weight.
            if n == 0 || weight > MIN_WEIGHT {
                let (rows, settings) = misstated.undone(rows, &settings);
                let episode = Episode { rows, push: None };
                let found = estimate_contact(field, &episode, &Settings { creep_sd, ..settings })?;
                points.push((weight, misstated, found));
            }
        }
        let span_s = [rows[0].t_s, rows[rows.len() - 1].t_s];
        let mut own = TableContact { range, span_s, weights, points, sliding, point_mm_by_gain: 0.0 };
        own.point_mm_by_gain = mm_by_gain(field, rows, own.point(), &settings)?;
        Ok(own)
    }

    /// The contacts of all episodes: what is misstated is so in all of them.
    fn contacts(&self, ranges: Vec<[usize; 2]>) -> Result<Vec<TableContact>, ContactError> {
        let found: Vec<_> = ranges.into_par_iter().map(|range| (range, self.evidence(range))).collect();
        let said: Vec<Vec<f64>> = found
            .iter()
            .map(|(_, (_, evidence))| {
                evidence.as_ref().map_or_else(Vec::new, ContactEvidence::of_misstatements)
            })
            .collect();
        let others = |n: usize| {
            // Contacts are independent but for what is misstated: their logarithms add up.
            let of = |m: usize| {
                said.iter().enumerate().filter(|(k, _)| *k != n).filter_map(|(_, s)| s.get(m)).sum()
            };
            (0..said[n].len()).map(of).collect::<Vec<f64>>()
        };
        let contact =
            |(n, (range, (sliding, evidence))): (usize, (_, (SlidingContact, Option<ContactEvidence>)))| {
                let weights =
                    evidence.map_or_else(|| ContactWeights::prior(self.prior), |e| e.weights(&others(n)));
                let sliding = match weights.misstated_slide() {
                    Some(misstated) => self.slid(range, misstated),
                    None => sliding,
                };
                self.contact(range, sliding, weights)
            };
        found.into_par_iter().enumerate().map(contact).collect()
    }

    fn messages(&self) -> Vec<String> {
        let mut all = Vec::new();
        let lost: u64 = self.lost.values().sum();
        if lost > 0 {
            let why: Vec<String> = self.lost.iter().map(|(name, n)| format!("{name} {n}")).collect();
            all.push(format!(
                "the motion of {lost} of {} readings is not known ({}); marked motion-lost in status",
                self.readings,
                why.join(", ")
            ));
        }
        for (n, c) in self.contacts.iter().enumerate() {
            let said = match (c.weights.regimes.certain(), c.weights.misstatement) {
                (None, _) => "it is not told whether its point of the object stays, creeps or slides; places and regions are those of all".to_owned(),
                (Some(Regime::Misstated), Some((m, _))) => format!("{}; marked motion-disagrees in status", m.sentence()),
                (Some(Regime::Sliding), _) if !c.sliding.sure() => "the fit of a sliding contact leaves more than noise, or the motion turns \
                     back: the contact may be lost, and its regions are wide; marked sliding-assumed in status"
                    .to_owned(),
                (Some(Regime::Sliding), _) => "it slides over the object".to_owned(),
                _ if c.flags().has(Flags::MOTION_DISAGREES) => match c.point().innovations.sentence() {
                    Some(said) => format!("{said}; marked motion-disagrees in status"),
                    None => "the motion says nothing of the moments; marked motion-disagrees in status".to_owned(),
                },
                _ => continue,
            };
            all.push(format!("contact {n}: {said}"));
        }
        for (n, c) in self.contacts.iter().enumerate().filter(|(_, c)| c.weights.slides()) {
            all.extend(c.sliding.slips.iter().map(|k| {
                let t_s = self.rows[c.range[0] + k].t_s;
                format!("contact {n}: it slips to another place of the object before {t_s:.2} s")
            }));
        }
        let by_gain = self.contacts.iter().map(TableContact::mm_by_gain).fold(0.0, f64::max);
        if by_gain > 0.0 {
            all.push(format!("{GAIN}; 1 % of gain moves a contact by up to {by_gain:.2} mm"));
        }
        if self.contacts.is_empty() {
            all.push(
                "no contact: no reading is loaded beyond its noise where the motion is known".to_owned(),
            );
        }
        all
    }
}

impl Estimator for KnownMotionTable {
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, ContactError> {
        let number = self.readings;
        self.readings += 1;
        if let Err(why) = reading.motion {
            *self.lost.entry(why.name()).or_default() += 1;
            self.without.push(number);
        }
        let Some((row, (m, motion))) =
            self.wire.row(reading, &self.accuracy).zip(reading.moments.as_ref().zip(reading.motion.ok()))
        else {
            return Ok(Vec::new());
        };
        self.misfit_nmm2.push(m.own_nmm2.map(|own| misfit(&m.pose_nmm2, &own)));
        self.rows.push(row);
        self.pieces.push(motion.piece);
        self.index.push(number);
        Ok(Vec::new())
    }

    fn finish(&mut self) -> Result<Vec<Contact>, ContactError> {
        self.split_noise();
        let ranges = episodes(&self.wire.field, &mut self.rows, &self.pieces);
        self.contacts = self.contacts(ranges)?;
        let mut all = vec![Contact::default(); self.readings];
        let mut alone = StaticArc::new(self.wire.clone());
        for (n, contact) in self.contacts.iter().enumerate() {
            let [from, to] = contact.range;
            for k in 0..to - from {
                let stated = contact.stated(&self.rows[from..to], k, &mut alone)?;
                all[self.index[from + k]] = Contact { number: Some(n as u64), ..stated };
            }
        }
        for k in &self.without {
            all[*k].flags = all[*k].flags.with(Flags::MOTION_LOST);
        }
        Ok(all)
    }

    fn findings(&self) -> Findings {
        let contact = |c: &TableContact| {
            let readings = c.range[1] - c.range[0];
            let found =
                ContactDocument::of_table(c.point(), &c.weights.regimes, &c.sliding, c.span_s, readings);
            ContactDocument { mm_by_gain_percent: Some(c.mm_by_gain()), ..found }
        };
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            contacts: Some(self.contacts.iter().map(contact).collect()),
            lost_rows: Some(self.lost.clone()),
            ..EstimatorDocument::default()
        };
        let doubt = self.contacts.iter().any(|c| !c.flags().none());
        let lost = !self.lost.is_empty();
        Findings { document, messages: self.messages(), lost, doubt, ..Findings::default() }
    }
}

/// How far moments that are larger by 1 % move a contact at a point, median over its readings, mm.
fn mm_by_gain(
    field: &MomentField,
    rows: &[MotionRow],
    point: &EpisodeEstimate,
    settings: &Settings,
) -> Result<f64, ContactError> {
    let larger = |r: &MotionRow| MotionRow { moment_nmm: r.moment_nmm.map(|m| m * PERCENT), ..r.clone() };
    let episode = Episode { rows: rows.iter().map(larger).collect(), push: None };
    let moved = estimate_contact(field, &episode, settings)?;
    let both = moved.places.iter().zip(&point.places);
    let mut all: Vec<f64> = both.filter_map(|(a, b)| Some((a.place_mm? - b.place_mm?).norm())).collect();
    all.sort_by(f64::total_cmp);
    Ok(all.get(all.len() / 2).copied().unwrap_or(0.0))
}

/// What of the noise from pose to pose is no noise of a reading, (N mm)^2.
fn misfit(pose_nmm2: &Matrix2<f64>, own_nmm2: &Matrix2<f64>) -> [f64; 2] {
    [0, 1].map(|c| (pose_nmm2[(c, c)] - own_nmm2[(c, c)]).max(0.0))
}

/// Rows around one that are of its pose.
fn same_pose(rows: &[MotionRow], k: usize) -> f64 {
    let near = |r: &&MotionRow| (r.moved_mm - rows[k].moved_mm).norm() < 0.5 * SAME_POSE_MM;
    let (before, after) = rows.split_at(k);
    (before.iter().rev().take_while(near).count() + after.iter().take_while(near).count()).max(1) as f64
}
