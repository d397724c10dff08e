//! Contacts of a table along a known motion: its episodes one by one, each from all of its readings ([`estimate_contact`]); no network.

use crate::ContactError;
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, Message};
use crate::fixed_or_sliding::fixed_or_sliding;
use crate::known_motion::{
    Episode, EpisodeEstimate, MomentField, MotionRow, Posterior, Region, Settings, episodes, estimate_contact,
};
use crate::known_motion_stream::{CREEP_SD, MotionAccuracy};
use crate::reading::Reading;
use crate::sliding::SlidingContact;
use crate::sliding_episodes::sliding_contacts;
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::Matrix2;
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_core::WhiskerSpec;
use wcal_core::stream::Flags;

/// Noise from pose to pose is one draw for poses nearer than this, mm: rows of a dense record are not that many poses. An assumption.
const SAME_POSE_MM: f64 = 1.0;

/// A contact of the table.
struct TableContact {
    /// Its readings among those whose motion is known: first, and one past the last.
    range: [usize; 2],
    span_s: [f64; 2],
    found: EpisodeEstimate,
    /// The contact as one that slides.
    sliding: SlidingContact,
    /// In a sweep over an object, where sliding is the normal case and nothing has to support it but the fit.
    over_object: bool,
}

impl TableContact {
    /// As one that slides, where no fixed point explains the moments and the motion supports it.
    fn slides(&self) -> Option<&SlidingContact> {
        let supported = self.sliding.supported() || (self.over_object && self.sliding.sure());
        (self.found.disagrees() && supported).then_some(&self.sliding)
    }

    /// Whether a fixed point and a contact that slides both explain the moments.
    fn undecided(&self) -> bool {
        !self.found.disagrees() && self.sliding.sure()
    }
}

/// The estimator of a table.
pub struct KnownMotionTable {
    field: MomentField,
    whisker: WhiskerSpec,
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
    /// Of a whisker whose wire has the moments of `field`.
    pub fn new(
        field: MomentField,
        whisker: &WhiskerSpec,
        accuracy: MotionAccuracy,
        over_object: bool,
    ) -> Self {
        Self {
            field,
            whisker: whisker.clone(),
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
        }
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
                row.shared_nmm.push(column);
            }
        }
    }

    /// Contacts of the readings so far.
    fn estimate_contact(&mut self) -> Result<(), ContactError> {
        self.split_noise();
        let ranges = episodes(&self.field, &mut self.rows, &self.pieces);
        let settings =
            Settings { clock_sd_s: self.accuracy.clock_sd_s, creep_sd: CREEP_SD, ..Settings::default() };
        let one = |[from, to]: &[usize; 2]| {
            let episode = Episode { rows: self.rows[*from..*to].to_vec(), push: None };
            estimate_contact(&self.field, &episode, &settings)
        };
        let found = ranges.par_iter().map(one).collect::<Result<Vec<EpisodeEstimate>, ContactError>>()?;
        let sliding = sliding_contacts(&self.whisker, &self.rows, &ranges)?;
        let over_object = self.over_object;
        let contact = |((range, found), sliding): (([usize; 2], EpisodeEstimate), SlidingContact)| {
            let span_s = [self.rows[range[0]].t_s, self.rows[range[1] - 1].t_s];
            TableContact { range, span_s, found, sliding, over_object }
        };
        self.contacts = ranges.into_iter().zip(found).zip(sliding).map(contact).collect();
        Ok(())
    }

    /// What is stated of the readings of a contact, by their numbers among all.
    fn stated(&self, number: usize, contact: &TableContact) -> Vec<(usize, Contact)> {
        let regions = contact.found.posterior.as_ref().map_or_else(Vec::new, Posterior::regions);
        let [from, to] = contact.range;
        let at = |k: usize| {
            if contact.undecided() {
                let both = fixed_or_sliding(k, &contact.found.places, &regions, &contact.sliding);
                return Contact { number: Some(number as u64), ..both };
            }
            let (place, regions, flags): (_, &[Region], _) = match contact.slides() {
                Some(s) if self.over_object => {
                    let flags = if s.sure() { Flags::default() } else { Flags::SLIDING_ASSUMED };
                    (&s.places[k], &s.regions[k], flags)
                }
                Some(s) => {
                    (&s.places[k], &s.regions[k], Flags::SLIDING_ASSUMED.with(Flags::MOTION_DISAGREES))
                }
                None => {
                    let disagrees = contact.found.disagrees();
                    let flags = if disagrees { Flags::MOTION_DISAGREES } else { Flags::default() };
                    (&contact.found.places[k], &regions, flags)
                }
            };
            let on_object = flags != Flags::MOTION_DISAGREES;
            let (estimate, regions) = (ContactEstimate::of_place(place), regions.to_vec());
            Contact { estimate, flags, regions, several: None, number: Some(number as u64), on_object }
        };
        (0..to - from).map(|k| (self.index[from + k], at(k))).collect()
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
        let numbered = || self.contacts.iter().enumerate();
        let assumed = numbered().filter(|_| !self.over_object);
        all.extend(assumed.filter_map(|(n, c)| Some((n, c.slides()?))).map(|(n, s)| {
            format!(
                "contact {n}: no fixed point of the object explains the moments, a contact that slides does (log likelihood ratio {:.0} to the \
                 reversed motion), as it does where motion or calibration are wrong; marked sliding-assumed in status",
                s.evidence - s.reversed_evidence
            )
        }));
        all.extend(numbered().filter(|(_, c)| c.undecided()).map(|(n, _)| {
            format!(
                "contact {n}: a fixed point of the object and a contact that slides both explain the moments; places and regions are those of both"
            )
        }));
        let slips = numbered().filter_map(|(n, c)| Some((n, c.range[0], c.slides()?)));
        all.extend(slips.flat_map(|(n, from, s)| s.slips.iter().map(move |k| (n, from + k))).map(
            |(n, k)| {
                format!(
                    "contact {n}: it slips to another place of the object before {:.2} s",
                    self.rows[k].t_s
                )
            },
        ));
        let unsure = numbered().filter(|(_, c)| self.over_object && c.slides().is_some_and(|s| !s.sure()));
        all.extend(unsure.map(|(n, _)| {
            format!(
                "contact {n}: the fit of a sliding contact leaves more than noise, or the motion turns back: the contact may be lost, and its \
                 regions are wide; marked sliding-assumed in status"
            )
        }));
        let fixed = numbered().filter(|(_, c)| c.slides().is_none());
        all.extend(fixed.filter_map(|(n, c)| {
            Some(format!(
                "contact {n}: {}; marked motion-disagrees in status",
                c.found.innovations.sentence()?
            ))
        }));
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
        let columns = |nmm2: &Matrix2<f64>| -> Vec<[f64; 2]> {
            let root = nmm2.cholesky().map_or_else(Matrix2::zeros, |c| c.l());
            root.column_iter().map(|c| [c[0], c[1]]).collect()
        };
        let mut shared_nmm = m.shared_nmm.clone();
        shared_nmm.extend(columns(&m.zero_nmm2));
        self.misfit_nmm2.push(m.own_nmm2.map(|own| misfit(&m.pose_nmm2, &own)));
        self.rows.push(MotionRow {
            t_s: reading.t_s,
            moment_nmm: m.moment_nmm,
            noise_nmm2: m.own_nmm2.unwrap_or(m.pose_nmm2),
            free_nmm2: m.own_nmm2.map(|own| own + m.zero_nmm2),
            shared_displacement_mm: Vec::new(),
            shared_nmm,
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
        self.estimate_contact()?;
        let mut all = vec![Contact::default(); self.readings];
        for (n, contact) in self.contacts.iter().enumerate() {
            for (k, stated) in self.stated(n, contact) {
                all[k] = stated;
            }
        }
        for k in &self.without {
            all[*k].flags = all[*k].flags.with(Flags::MOTION_LOST);
        }
        Ok(all)
    }

    fn findings(&self) -> Findings {
        let contact = |c: &TableContact| {
            ContactDocument::of_table(
                &c.found,
                c.span_s,
                c.range[1] - c.range[0],
                &c.sliding,
                (c.slides().is_some(), c.undecided()),
            )
        };
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            contacts: Some(self.contacts.iter().map(contact).collect()),
            lost_rows: Some(self.lost.clone()),
            ..EstimatorDocument::default()
        };
        // A sweep over an object slides by its nature.
        let explained = |c: &TableContact| self.over_object && c.slides().is_some_and(SlidingContact::sure);
        let doubt = self.contacts.iter().any(|c| c.found.disagrees() && !explained(c));
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
