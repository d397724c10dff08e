//! Contacts of a table along a known motion: its episodes one by one, each from all of its readings, averaged over the ways in which a contact may
//! move ([`crate::regimes`]); no network.

use crate::ContactError;
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, Message};
use crate::known_motion::contact_path::{ContactPath, loaded};
use crate::known_motion::{
    Episode, EpisodeContact, EpisodeEstimate, MotionRow, Posterior, Settings, episodes, estimate_contact,
};
use crate::known_motion_stream::MotionAccuracy;
use crate::reading::Reading;
use crate::regimes::{
    ANY_OBJECT, Alternative, MIN_WEIGHT, Regime, RegimeWeights, SWEPT_OBJECT, anywhere_evidence, averaged,
    creeping_evidence, point_evidence,
};
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding, reversed};
use crate::static_arc::StaticArc;
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::Matrix2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_core::stream::Flags;

/// Noise from pose to pose is one draw for poses nearer than this, mm: rows of a dense record are not that many poses. An assumption.
const SAME_POSE_MM: f64 = 1.0;
/// What the freedom of a surface costs of the evidence of a block, at most.
const SURFACE_COST: f64 = 4.0;
/// Readings past the end of an episode, which show whether the load was lost at once.
const PAST: usize = 2;

/// A contact of the table.
struct TableContact {
    /// Its readings among those whose motion is known: first, and one past the last.
    range: [usize; 2],
    span_s: [f64; 2],
    weights: RegimeWeights,
    /// As one at a point that stays, that creeps, and that stays along the reversed motion; those that may be.
    points: Vec<(Regime, EpisodeEstimate)>,
    /// As one that slides.
    sliding: SlidingContact,
    /// In a sweep over an object, where sliding is the normal case.
    over_object: bool,
}

impl TableContact {
    /// The likelier of the points that stay and creep.
    fn point(&self) -> &EpisodeEstimate {
        let of = |a: &&(Regime, EpisodeEstimate)| self.weights.of(a.0);
        let own = self.points.iter().filter(|p| p.0 != Regime::Reversed);
        &own.max_by(|a, b| of(a).total_cmp(&of(b))).unwrap_or(&self.points[0]).1
    }

    fn slides(&self) -> bool {
        self.weights.of(Regime::Sliding) > 0.5
    }

    /// Whether moments and motion do not belong together.
    fn disagrees(&self) -> bool {
        self.weights.no_motion() > 0.5 || (!self.slides() && self.point().disagrees())
    }

    /// Whether it slides, which is no doubt.
    fn slides_over_object(&self) -> bool {
        self.slides() && self.over_object && self.sliding.sure()
    }

    fn flags(&self) -> Flags {
        match (self.slides(), self.over_object) {
            (true, true) if self.sliding.sure() => Flags::default(),
            (true, true) => Flags::SLIDING_ASSUMED,
            (true, false) => Flags::SLIDING_ASSUMED.with(Flags::MOTION_DISAGREES),
            (false, _) if self.disagrees() => Flags::MOTION_DISAGREES,
            (false, _) => Flags::default(),
        }
    }

    /// As one that slides at a reading: where the path has no place yet, that of the nearest reading goes with the object.
    fn slid(&self, rows: &[MotionRow], k: usize) -> Option<(EpisodeContact, ArcDensity)> {
        let places = &self.sliding.places;
        let located = (0..places.len()).filter(|j| places[*j].place_mm.is_some());
        let near = located.min_by_key(|j| j.abs_diff(k)).filter(|near| *near == k || !self.slides())?;
        let turn = rows[k].turn * rows[near].turn.inverse();
        let place = EpisodeContact {
            place_mm: places[near].place_mm.map(|at| turn * (at - rows[near].moved_mm) + rows[k].moved_mm),
            ..places[near].clone()
        };
        Some((place, self.sliding.arcs[near].clone()))
    }

    /// What is stated of a reading.
    fn stated(
        &self,
        rows: &[MotionRow],
        k: usize,
        alone: Option<&mut StaticArc>,
    ) -> Result<Contact, ContactError> {
        let mut all = Vec::new();
        for (regime, found) in &self.points {
            let arc = found.posterior.as_ref().map(Posterior::arc).unwrap_or_default();
            let weight = self.weights.of(*regime);
            all.push(Alternative { weight, place: found.places[k].clone(), arc });
        }
        let weight = self.weights.of(Regime::Sliding);
        if let Some((place, arc)) = self.slid(rows, k).filter(|_| weight > MIN_WEIGHT) {
            all.push(Alternative { weight, place, arc });
        }
        if let Some(alone) = alone.filter(|_| loaded(&rows[k])) {
            let sd_nmm = [0, 1].map(|c| rows[k].noise_nmm2[(c, c)].sqrt());
            let (estimate, arc) = alone.allowed(rows[k].moment_nmm, sd_nmm)?;
            let place = EpisodeContact {
                place_mm: Some(estimate.place_mm),
                covariance_mm2: estimate.covariance_mm2,
                contact: 1.0,
                outlier: false,
            };
            all.push(Alternative { weight: self.weights.of(Regime::Anywhere), place, arc });
        }
        // Before its first place a contact that slides is not known to be anywhere.
        if self.slides() && self.slid(rows, k).is_none() {
            return Ok(Contact { flags: self.flags(), ..Contact::default() });
        }
        let (flags, on_object) = (self.flags(), !self.disagrees());
        let Some((place, arc)) = averaged(&all) else {
            return Ok(Contact { flags, on_object, ..Contact::default() });
        };
        let (estimate, regions) = (ContactEstimate::of_place(&place), arc.regions());
        Ok(Contact { estimate, flags, regions, on_object, ..Contact::default() })
    }
}

/// The estimator of a table.
pub struct KnownMotionTable {
    wire: CalibratedWire,
    touched: TouchedWire,
    accuracy: MotionAccuracy,
    /// Whether the table is of a sweep over an object: there a contact slides by its nature and is no doubt; elsewhere a wrong motion or
    /// calibration is as likely.
    over_object: bool,
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
            over_object,
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

    /// The contact of an episode.
    fn contact(&self, range: [usize; 2]) -> Result<TableContact, ContactError> {
        let [from, to] = range;
        let field = &self.wire.field;
        let settings = |creep_sd| Settings {
            clock_sd_s: self.accuracy.clock_sd_s,
            creep_sd,
            stiffness_sd: self.wire.stiffness_sd(),
            ..Settings::default()
        };
        let episode = |regime: Regime| {
            let rows = &self.rows[from..to];
            let rows = if regime == Regime::Reversed { reversed(rows) } else { rows.to_vec() };
            Episode { rows, push: None }
        };
        let mut sliding = locate_sliding(&self.touched, &self.rows[from..(to + PAST).min(self.rows.len())]);
        sliding.places.truncate(to - from);
        sliding.arcs.truncate(to - from);
        let first = self.rows[from..to].iter().position(loaded).unwrap_or(0);
        let before = first.checked_sub(1).map(|k| from + k);
        let means = sliding.means.at_middles();
        let point = |regime: Regime, creep_sd: f64| {
            let (episode, settings) = (episode(regime), settings(creep_sd));
            let push = ContactPath::new(field, &episode)?.push;
            let mirrored = |rows: &[MotionRow]| match regime {
                Regime::Reversed => reversed(rows),
                _ => rows.to_vec(),
            };
            let before = before.map(|k| mirrored(&self.rows[k..=k]).remove(0));
            Some(point_evidence(field, &settings, push, before.as_ref(), &mirrored(&means)))
        };
        let point = |regime, creep_sd| point(regime, creep_sd).unwrap_or(f64::NEG_INFINITY);
        let [slides, slides_reversed] = sliding.ln_evidence;
        let fixed = point(Regime::Fixed, 0.0);
        let (creeping, creep_sd) = creeping_evidence(|sd| point(Regime::Creeping, sd));
        // A point is a small surface: along the reversed motion it explains no more than one, but for what the surface's freedom costs.
        let most = slides_reversed + SURFACE_COST * sliding.means.len() as f64;
        let still = match slides.max(fixed).max(creeping) > most {
            true => f64::NEG_INFINITY,
            false => point(Regime::Reversed, 0.0),
        };
        let prior = if self.over_object { SWEPT_OBJECT } else { ANY_OBJECT };
        let evidence = [fixed, creeping, slides, still.max(slides_reversed), anywhere_evidence(&means)];
        let weights = match (prior.after(&evidence), sliding.sure()) {
            (weights, true) => weights.moving_alike(),
            (weights, false) => weights,
        };
        let at_reversed_point = still >= slides_reversed;
        let likelier = match weights.of(Regime::Fixed) >= weights.of(Regime::Creeping) {
            true => Regime::Fixed,
            false => Regime::Creeping,
        };
        let may_be = |regime: &Regime| {
            let is_point = *regime != Regime::Reversed || at_reversed_point;
            *regime == likelier || (is_point && weights.of(*regime) > MIN_WEIGHT)
        };
        let of = |regime: Regime| {
            let creep_sd = if regime == Regime::Creeping { creep_sd } else { 0.0 };
            let (episode, settings) = (episode(regime), settings(creep_sd));
            Ok((regime, estimate_contact(field, &episode, &settings)?))
        };
        let all = [Regime::Fixed, Regime::Creeping, Regime::Reversed].into_iter().filter(may_be);
        Ok(TableContact {
            range,
            span_s: [self.rows[from].t_s, self.rows[to - 1].t_s],
            weights,
            points: all.map(of).collect::<Result<_, ContactError>>()?,
            sliding,
            over_object: self.over_object,
        })
    }

    fn messages(&self) -> Vec<Message> {
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
            let said = match (c.weights.certain(), self.over_object) {
                (None, _) => "it is not told whether its point of the object stays, creeps or slides; places and regions are those of all".to_owned(),
                (Some(Regime::Sliding), false) => "no fixed point of the object explains the moments, a contact that slides does, as it does where \
                     motion or calibration are wrong; marked sliding-assumed in status"
                    .to_owned(),
                (Some(Regime::Sliding), true) if !c.sliding.sure() => "the fit of a sliding contact leaves more than noise, or the motion turns \
                     back: the contact may be lost, and its regions are wide; marked sliding-assumed in status"
                    .to_owned(),
                (Some(Regime::Reversed), _) => "moments and motion disagree: with its sign reversed the motion explains them; marked motion-disagrees in status".to_owned(),
                _ if !c.slides() && c.disagrees() => match c.point().innovations.sentence() {
                    Some(said) => format!("{said}; marked motion-disagrees in status"),
                    None => "the motion says nothing of the moments; marked motion-disagrees in status".to_owned(),
                },
                _ => continue,
            };
            all.push(format!("contact {n}: {said}"));
        }
        for (n, c) in self.contacts.iter().enumerate().filter(|(_, c)| c.slides()) {
            all.extend(c.sliding.slips.iter().map(|k| {
                let t_s = self.rows[c.range[0] + k].t_s;
                format!("contact {n}: it slips to another place of the object before {t_s:.2} s")
            }));
        }
        if self.contacts.is_empty() {
            all.push(
                "no contact: no reading is loaded beyond its noise where the motion is known".to_owned(),
            );
        }
        all.into_iter().map(Message::note).collect()
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
        let (Some(m), Ok(motion)) = (&reading.moments, &reading.motion) else { return Ok(Vec::new()) };
        self.misfit_nmm2.push(m.own_nmm2.map(|own| misfit(&m.pose_nmm2, &own)));
        self.rows.push(MotionRow {
            t_s: reading.t_s,
            moment_nmm: m.moment_nmm,
            noise_nmm2: m.own_nmm2.unwrap_or(m.pose_nmm2),
            free_nmm2: m.own_nmm2.map(|own| own + m.zero_nmm2),
            shared_displacement_mm: Vec::new(),
            shared_nmm: self.wire.shared_columns(m),
            moved_mm: motion.moved_mm,
            turn: motion.turn,
            velocity_mm_s: motion.velocity_mm_s,
            moved_sd_mm: self.accuracy.moved_sd_mm,
            free: false,
            contact_segment: 0,
        });
        self.pieces.push(motion.piece);
        self.index.push(number);
        Ok(Vec::new())
    }

    fn finish(&mut self) -> Result<Vec<Contact>, ContactError> {
        self.split_noise();
        let ranges = episodes(&self.wire.field, &mut self.rows, &self.pieces);
        let contacts = ranges.into_par_iter().map(|range| self.contact(range));
        self.contacts = contacts.collect::<Result<_, ContactError>>()?;
        let mut all = vec![Contact::default(); self.readings];
        let mut alone = StaticArc::new(self.wire.clone());
        for (n, contact) in self.contacts.iter().enumerate() {
            let [from, to] = contact.range;
            let anywhere = contact.weights.of(Regime::Anywhere) > MIN_WEIGHT;
            for k in 0..to - from {
                let alone = anywhere.then_some(&mut alone);
                let stated = contact.stated(&self.rows[from..to], k, alone)?;
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
            ContactDocument::of_table(c.point(), &c.weights, &c.sliding, c.span_s, readings)
        };
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            contacts: Some(self.contacts.iter().map(contact).collect()),
            lost_rows: Some(self.lost.clone()),
            ..EstimatorDocument::default()
        };
        let doubtful = |c: &TableContact| !c.slides_over_object() && (c.slides() || c.disagrees());
        let doubt = self.contacts.iter().any(doubtful);
        let lost = !self.lost.is_empty();
        Findings { document, messages: self.messages(), lost, doubt, ..Findings::default() }
    }
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
