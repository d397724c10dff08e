//! The posterior Cramer-Rao bounds of an evaluation's tables (`wcal_track::sweep_bound`), and errors compared with them.

use super::document::mean;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use wcal_sim::SweepPlan;
use wcal_track::evaluate::{BoundsByObject, ErrorAndBound, ObjectScores};
use wcal_track::filter::BayesSettings;
use wcal_track::sweep_bound::transition::TransitionDensities;
use wcal_track::sweep_bound::{SweepContacts, SweepKnowledge};
use wcal_track::{StaticInverse, SweepSeries};

/// Series by object.
pub type SeriesByObject = BTreeMap<String, Vec<SweepSeries>>;

/// The true contacts of a table's sweeps, and how they slide.
pub struct TableBounds<'a> {
    contacts: BTreeMap<&'a str, Vec<SweepContacts<'a>>>,
    densities: Option<TransitionDensities>,
}

impl<'a> TableBounds<'a> {
    /// Of sweeps with true moments.
    pub fn new(inverse: &StaticInverse, sets: impl IntoIterator<Item = &'a SeriesByObject>) -> Self {
        let of = |all: &'a Vec<SweepSeries>| -> Vec<SweepContacts<'a>> {
            all.par_iter().map(|s| SweepContacts::new(inverse, s)).collect()
        };
        let contacts: BTreeMap<&str, Vec<SweepContacts<'_>>> =
            sets.into_iter().flatten().map(|(name, all)| (name.as_str(), of(all))).collect();
        let densities = TransitionDensities::of_sweeps(contacts.values().flatten());
        Self { contacts, densities }
    }

    /// Bounds by what is known of moments and motion of an object's sweep; none where the sweeps slide too little for their densities.
    pub fn by(&self, knowledge: &(dyn Fn(&str, usize) -> SweepKnowledge + Sync)) -> Option<BoundsByObject> {
        let densities = self.densities.as_ref()?;
        let of = |(name, all): (&&str, &Vec<SweepContacts<'_>>)| {
            let one = |(k, c): (usize, &SweepContacts<'_>)| c.bound(densities, &knowledge(name, k));
            ((*name).to_owned(), all.par_iter().enumerate().map(one).collect())
        };
        Some(self.contacts.iter().map(of).collect())
    }

    /// Bounds of moments as the rod engine makes them, with the base's speed known or not.
    pub fn simulated(&self, plan: &SweepPlan, speed_known: bool) -> Option<BoundsByObject> {
        let knowledge =
            SweepKnowledge::of_noise(BayesSettings::default().noise_nmm, unknown_speed(plan, speed_known));
        self.by(&|_, _| knowledge.clone())
    }

    /// The densities, for evaluation.json.
    pub fn densities(&self) -> Value {
        json!(self.densities)
    }
}

/// What is known of a base whose speed is not given.
pub fn unknown_speed(plan: &SweepPlan, speed_known: bool) -> Option<([f64; 2], f64)> {
    (!speed_known).then_some((plan.speed_mm_s, plan.acceleration_mm_s2))
}

/// Errors compared with their bounds, means over objects of the RMS; null where there are no bounds.
pub fn over_bound(rows: &[ObjectScores]) -> Value {
    let bounded: Vec<ObjectScores> = rows.iter().filter(|o| o.bound.is_some()).cloned().collect();
    if bounded.is_empty() {
        return Value::Null;
    }
    let of = |value: fn(&ErrorAndBound) -> f64| mean(&bounded, |o| o.bound.as_ref().map_or(f64::NAN, value));
    let (surface, surface_bound) = (of(|b| b.surface_mm), of(|b| b.surface_bound_mm));
    let (contact, contact_bound) = (of(|b| b.contact_mm), of(|b| b.contact_bound_mm));
    let (median, bound_median) = (of(|b| b.contact_median_mm), of(|b| b.contact_bound_median_mm));
    json!({
        "surface_mm": surface, "surface_bound_mm": surface_bound, "surface_error_over_bound": surface / surface_bound,
        "contact_mm": contact, "contact_bound_mm": contact_bound, "contact_error_over_bound": contact / contact_bound,
        "contact_median_mm": median, "contact_bound_median_mm": bound_median,
        "regular_share": of(|b| b.regular_share),
        "samples": bounded.iter().filter_map(|o| o.bound).map(|b| b.samples).sum::<usize>(),
    })
}

/// `bound 0.21 / 1.40 mm, error / bound 1.6 / 1.2; medians 0.41 of 0.20 mm`: surface and true contact; `-` without a bound.
pub fn over_bound_text(of: &Value) -> String {
    let number = |key: &str| of[key].as_f64();
    let bounds = ["surface_bound_mm", "contact_bound_mm"].map(number);
    let ratios = ["surface_error_over_bound", "contact_error_over_bound"].map(number);
    let medians = ["contact_median_mm", "contact_bound_median_mm"].map(number);
    match (bounds, ratios, medians) {
        ([Some(surface), Some(contact)], [Some(a), Some(b)], [Some(median), Some(least)]) => format!(
            "bound {surface:.2} / {contact:.2} mm, error / bound {a:.1} / {b:.1}; medians {median:.2} of {least:.2} mm"
        ),
        _ => "-".to_owned(),
    }
}
