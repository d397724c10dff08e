//! Spread by class of object: the class is often known (tools, food, ...), and the calibration of the stated spread differs by class.
//!
//! A class's factor is shrunk toward the common one in the logarithm: `log f = (n log f_own + n0 log f_common) / (n + n0)`, n the class's
//! held-out objects, n0 = 2 (as an empirical Bayes estimate with a prior worth n0 objects: B. Efron, C. Morris, JASA 70 (1975) 311).

use crate::error::TrackError;
use crate::evaluate::held_out_regions;
use crate::score::{CHI2_90, EstimateError, calibrating_factor};
use crate::sweep_series::SweepSeries;
use crate::tracker::Tracker;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Classes of objects: object to class.
pub type ObjectClasses = BTreeMap<String, String>;

/// Factors on the stated standard deviations for a class.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ClassSpread {
    /// Held-out objects of the class.
    pub objects: usize,
    /// Base's speed not known, and known.
    pub sd_factors: [f64; 2],
}

/// Weight of the common factor, in objects: a class with this many objects has the geometric mean of both factors.
const PRIOR_OBJECTS: f64 = 2.0;

/// Factors by class from the regions of held-out series (base's speed not known, and known): logarithms of a class's own factor and of the
/// common one, weighted by numbers of objects.
#[must_use]
pub fn spread_by_class(
    regions: &[Vec<(String, EstimateError)>; 2],
    common: [f64; 2],
    classes: &ObjectClasses,
) -> BTreeMap<String, ClassSpread> {
    let names: BTreeSet<&String> = classes.values().collect();
    let spread = |class: &String| {
        let own = |known: usize| regions[known].iter().filter(|r| classes.get(&r.0) == Some(class));
        let objects = own(0).map(|r| &r.0).collect::<BTreeSet<_>>().len();
        let factor = |known: usize| {
            let own: Vec<EstimateError> = own(known).map(|r| r.1).collect();
            shrunk(calibrating_factor(&own), common[known], objects)
        };
        ClassSpread { objects, sd_factors: [factor(0), factor(1)] }
    };
    names.into_iter().map(|class| (class.clone(), spread(class))).collect()
}

/// A class's own factor and the common one, by the number of objects that the first comes from.
fn shrunk(own: f64, common: f64, objects: usize) -> f64 {
    common * (own / common).powf(objects as f64 / (objects as f64 + PRIOR_OBJECTS))
}

/// Factors of a class.
///
/// # Errors
/// Names the classes that the model has.
pub fn of_class(all: &BTreeMap<String, ClassSpread>, class: &str) -> Result<[f64; 2], TrackError> {
    let known: Vec<&str> = all.keys().map(String::as_str).collect();
    let expected = if known.is_empty() { "a model with classes".to_owned() } else { known.join(", ") };
    all.get(class).map(|c| c.sd_factors).ok_or_else(|| TrackError::value("object class", expected, class))
}

/// Share of true contacts in the stated 90 % regions over objects of a class.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ClassCoverage {
    /// Class.
    pub class: String,
    /// Objects and instants with contact.
    pub objects: usize,
    /// Instants with contact.
    pub instants: usize,
    /// With the common factor: base's speed not known, and known.
    pub common: [f64; 2],
    /// With the class's own.
    pub by_class: [f64; 2],
}

/// Coverage over series that were not trained on, class by class; `common` are the factors that the tracker states regions with.
#[must_use]
pub fn coverage_by_class(
    tracker: &Tracker,
    all_series: &[SweepSeries],
    classes: &ObjectClasses,
    spreads: &BTreeMap<String, ClassSpread>,
    common: [f64; 2],
) -> Vec<ClassCoverage> {
    let regions = [false, true].map(|known| held_out_regions(tracker, all_series, known));
    let mut found = Vec::new();
    for (class, spread) in spreads {
        let of_class = |object: &str| classes.get(object) == Some(class);
        let objects: BTreeSet<&str> =
            all_series.iter().map(|c| c.object.as_str()).filter(|o| of_class(o)).collect();
        let own = [0, 1].map(|known| -> Vec<f64> {
            let own = regions[known].iter().filter(|r| of_class(&r.0));
            own.filter_map(|r| r.1.mahalanobis2).collect()
        });
        if own[0].is_empty() {
            continue;
        }
        let share = |known: usize, widened: f64| {
            let inside = own[known].iter().filter(|m| **m <= CHI2_90 * widened.powi(2)).count();
            inside as f64 / own[known].len() as f64
        };
        let widened = |known: usize| spread.sd_factors[known] / common[known];
        found.push(ClassCoverage {
            class: class.clone(),
            objects: objects.len(),
            instants: own[0].len(),
            common: [share(0, 1.0), share(1, 1.0)],
            by_class: [share(0, widened(0)), share(1, widened(1))],
        });
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_without_objects_has_the_common_factor_and_one_with_many_its_own() {
        assert_eq!(shrunk(1.0, 0.7, 0), 0.7);
        assert!((shrunk(2.0, 0.5, 2) - 1.0).abs() < 1e-12);
        assert!((shrunk(2.0, 0.5, 1000) - 2.0).abs() < 0.01);
        let all = BTreeMap::from([("tool".to_owned(), ClassSpread { objects: 3, sd_factors: [1.0, 2.0] })]);
        assert_eq!(of_class(&all, "tool").unwrap(), [1.0, 2.0]);
        let error = of_class(&all, "food").unwrap_err().to_string();
        assert!(error.contains("tool") && error.contains("food"), "{error}");
        assert!(of_class(&BTreeMap::new(), "food").unwrap_err().to_string().contains("with classes"));
    }
}
