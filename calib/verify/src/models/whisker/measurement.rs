//! The whisker session as a measurement model of the procedure.

use super::admission;
use super::floor::{lack_of_fit, noise_floor};
use super::next::{self, RIVALS};
use super::path::Reading;
use super::physical::PhysicalModel;
use super::predictions::{Predictions, by_labels, predict};
use super::seatings::spread_of_zeros;
use super::stage_clock;
use super::system::WhiskerSystem;
use super::twin_check::{check_labels, labelled_moments};
use crate::levels::{GENERIC, NORMAL_95};
use crate::method::inference;
use crate::method::{
    Fit, Hypothesis, LackOfFit, Noise, SearchResult, Weights, chi_squared_tail,
    noise_for_predictions,
};
use crate::verify::{
    FloorStatement, Folds, HeldOut, Origin, Quantity, SessionModel, SessionText, Witness,
};
use crate::{EffectTerm, MeasurementModel, VerifyError};
use nalgebra::Vector2;
use std::collections::BTreeSet;
use wcal_core::Sealed;
use wcal_core::observation::WhiskerRow;
use wcal_core::verify_document::{
    EffectParameter, NextMeasurement, NoisePart, TwinFault, WitnessTest,
};

/// Change of the channels' shared noise from which the search is made again.
const WHITENING_CHANGED: f64 = 1.1;
/// Change of the stage's clock from which the search is made again, s.
const CLOCK_CHANGED_S: f64 = 2e-4;
/// Ratio of the pictures' scatter to what they state from which the statement is not believed:
/// chance reaches 1.2 with 27 pairs.
const OVERSTATED: f64 = 1.25;
/// No pair is believed to be better than this share of what it states.
const MIN_OWN_SHARE: f64 = 0.2;
/// Share of the whole gain from which one witness decides alone.
const DECIDES: f64 = 0.8;
/// From the optimum of all readings two Gauss-Newton steps reach that of all but one trajectory.
const REFIT_STEPS: usize = 2;

/// Errors that are stated; the contact's where there are pictures.
const QUANTITIES: [Quantity; 3] = [
    Quantity {
        key: "wavelength_rmse_pm",
        unit: "pm",
    },
    Quantity {
        key: "moment_rmse_nmm",
        unit: "N mm",
    },
    Quantity {
        key: "contact_rmse_mm",
        unit: "mm",
    },
];

/// `system` with its pictures weighed by what `fit` leaves of both witnesses; `before` is the
/// system that was fitted.
fn reweight_pictures(system: WhiskerSystem, fit: &Fit, before: &WhiskerSystem) -> WhiskerSystem {
    if before.pictures.is_none() {
        return system;
    }
    // own chi is the scatter over what the shapes state, whatever share counted in the fit.
    let (own, chi) = (before.own_share(), reduced_chi(fit, before.picture_scale));
    let sd = fit.readings_variance().sqrt();
    // Worse than stated, by whatever: everything counts less. Better: only what scatters can be,
    // and one variance holds for all values.
    if own * chi > OVERSTATED {
        system
            .with_own_share(1.0)
            .with_picture_scale(sd / (own * chi))
    } else {
        system
            .with_own_share((own * chi).clamp(MIN_OWN_SHARE, 1.0))
            .with_picture_scale(sd)
    }
}

/// Scatter of the pictures about a fit over what counts of their errors.
fn reduced_chi(fit: &Fit, scale: f64) -> f64 {
    (fit.auxiliary_residual.norm_squared() / (fit.witness_count.max(1) as f64)).sqrt() / scale
}

impl SessionText for WhiskerSystem {
    fn kind(&self) -> &'static str {
        "whisker"
    }

    fn unit(&self) -> String {
        "pm".to_owned()
    }

    fn nuisances(&self) -> &'static str {
        "K, the zero"
    }

    fn notes(&self, found: &SearchResult, accepted: &Hypothesis) -> Vec<String> {
        let mut notes =
            vec!["Moments are in the twin's scale: an error of EI is absorbed by K.".to_owned()];
        notes.extend(note_model_error(found));
        notes.extend(note_unsteady(self));
        notes.extend(note_clock(self));
        notes.extend(note_pairs_left_out(self));
        notes.extend(picture_note(self, found, accepted));
        notes.extend(spread_of_zeros(self, &accepted.fit).map(|b| b.note()));
        notes
    }
}

impl SessionModel for WhiskerSystem {
    type Row = WhiskerRow;
    type Predictions = Predictions;
    type Calibration = PhysicalModel;

    fn origin(&self, reading: usize) -> Origin {
        let row = self.row(reading);
        Origin {
            source: row.source.clone(),
            line: row.line,
            point: row.point,
            role: row.role,
        }
    }

    fn parameters(&self, h: &Hypothesis, effect: usize) -> Vec<EffectParameter> {
        inference::parameters(self, h, effect)
    }

    fn refusal(&self, sealed: &Sealed<WhiskerRow>) -> Option<String> {
        admission::refusal(self, sealed)
    }

    fn twin_faults(&self) -> Vec<TwinFault> {
        check_labels(&self.data, &self.path, &self.rod_tables).faults
    }

    fn prepared(self, declared: &dyn Fn(&Self) -> Option<Hypothesis>) -> Option<Self> {
        let base = declared(&self)?;
        let system = self.whitened(&base.fit);
        let set_s = stage_clock::estimate_alignment(&system, &base, false);
        let system = system.with_stage_clock(set_s);
        if system.pictures.is_none() {
            return Some(system);
        }
        let base = declared(&system)?;
        Some(reweight_pictures(system.clone(), &base.fit, &system))
    }

    /// An effect that was not declared hides how much noise the channels share, and how good the
    /// pictures are beside it.
    fn renewed(&self, accepted: &Hypothesis, _settled: bool, _seed: u64) -> Option<Self> {
        let fit = &accepted.fit;
        let again = reweight_pictures(self.clone().whitened(fit), fit, self);
        // A lag in motion and a stage clock that is set wrong are one: a lag takes up both.
        let is_lag = |t: &EffectTerm| self.catalogue[t.effect].id == "time-lag";
        let lagged = fit.terms.iter().any(is_lag);
        let set_s = stage_clock::estimate_alignment(&again, accepted, lagged);
        let again = again.with_stage_clock(set_s);
        let moved = (set_s - self.stage_clock_s).abs() > CLOCK_CHANGED_S;
        let parts = |s: &Self| [s.whitening.determinant(), s.picture_scale, s.own_share()];
        let mut changes = parts(&again).into_iter().zip(parts(self));
        let changed = changes.any(|(a, b)| (a / b).max(b / a) > WHITENING_CHANGED);
        (moved || changed).then_some(again)
    }

    fn without(&self, refuted: &[String]) -> Self {
        self.clone().without_effects(refuted)
    }

    fn lack_of_fit(&self, h: &Hypothesis) -> Option<LackOfFit> {
        lack_of_fit(self, h)
    }

    fn floor(&self, h: &Hypothesis, noise: &Noise, left: bool) -> FloorStatement {
        noise_floor(self, h, noise, left)
    }

    fn next_measurement(
        &self,
        best: &Hypothesis,
        rivals: &[&Hypothesis],
    ) -> Option<NextMeasurement> {
        // Only what the poses are chosen against is promised to be separated.
        let nearest = &rivals[..rivals.len().min(RIVALS)];
        let effects = |h: &Hypothesis| h.term_ids(self.catalogue()).join(" with ");
        let names = std::iter::once(best)
            .chain(nearest.iter().copied())
            .map(effects)
            .collect();
        next::next_measurement(self, best, nearest, names)
    }

    fn with_holdout(&self, unsealed: &[WhiskerRow]) -> Result<Self, VerifyError> {
        Ok(Self::new(&self.data, unsealed)?.with_whitening_of(self))
    }

    fn sealed(&self) -> &[bool] {
        &self.sealed
    }

    fn scored(&self) -> &[bool] {
        &self.scored
    }

    fn predict(&self, h: &Hypothesis, reading_sd: &[f64]) -> Option<Predictions> {
        predict(self, h, reading_sd)
    }

    fn quantities(&self) -> &'static [Quantity] {
        if self.pictures.is_some() {
            &QUANTITIES
        } else {
            &QUANTITIES[..2]
        }
    }

    fn errors(&self, predictions: &Predictions, reading: usize) -> HeldOut {
        let (r, p) = (&self.path.readings[reading], &predictions[reading]);
        let moment = Vector2::from(p.moment_nmm) - Vector2::from(p.pose_moment_nmm);
        // Two errors of one reading: in the sensor's unit from the pose, in moments from the
        // wavelengths.
        let wavelength = Vector2::from(r.shift_pm) - Vector2::from(p.shift_pm);
        let inside = |c: usize| moment[c].abs() <= NORMAL_95 * p.moment_sd_nmm[c];
        let of = |v: Vector2<f64>| v.as_slice().to_vec();
        let mut errors = vec![of(wavelength), of(moment)];
        let mut stated_sd = vec![p.shift_sd_pm.to_vec(), p.moment_sd_nmm.to_vec()];
        if self.pictures.is_some() {
            errors.push(p.contact_error_mm.into_iter().collect());
            stated_sd.push(p.contact_error_mm.iter().map(|_| f64::NAN).collect());
        }
        HeldOut {
            group: r.group,
            errors,
            stated_sd,
            inside95: vec![inside(0), inside(1)],
        }
    }

    fn folds(&self, _accepted: &Hypothesis) -> Folds {
        let readings = &self.path.readings;
        let loaded = readings.iter().filter(|r| !r.rest);
        let groups: BTreeSet<u32> = loaded.map(|r| r.group).collect();
        // Readings at rest belong to no trajectory: they stay in every fit and hold the zero.
        let fold = |r: &Reading| (!r.rest).then(|| groups.range(..r.group).count());
        Folds {
            split: "loto",
            words: "leave-one-trajectory-out".to_owned(),
            fold: readings.iter().map(fold).collect(),
            refit_steps: REFIT_STEPS,
        }
    }

    fn prediction_noise(&self, accepted: &Hypothesis, seed: u64) -> Option<Noise> {
        noise_for_predictions(self, accepted, seed)
    }

    fn calibration(
        &self,
        _base: &Hypothesis,
        accepted: &Hypothesis,
        noise: &Noise,
        floor_sd: f64,
    ) -> PhysicalModel {
        PhysicalModel::new(self, accepted, floor_sd).with_noise(self, noise)
    }

    fn predict_by_labels(&self, weights: &Weights) -> Option<Predictions> {
        by_labels(self, &labelled_moments(&self.data, &self.path)?, weights)
    }

    fn channels(
        &self,
        before: &Predictions,
        after: &Predictions,
        reading: usize,
    ) -> Vec<(String, [f64; 3])> {
        let [before, after] = [before, after].map(|p| p[reading].shift_pm);
        let measured = self.path.readings[reading].shift_pm;
        let channel = |c: usize| {
            let name = format!("fbg_{}", c + 1);
            (name, [measured[c], before[c], after[c]])
        };
        (0..2).map(channel).collect()
    }

    fn seating_repeatability(&self, accepted: &Hypothesis) -> Option<NoisePart> {
        spread_of_zeros(self, &accepted.fit).map(|b| b.session)
    }
}

/// Pairs of pictures, which join the fit: what they say of an explanation is in its sum of squares
/// already, and they refute none by themselves.
pub(super) struct PicturePairs;

impl Witness<WhiskerSystem> for PicturePairs {
    fn test(
        &self,
        system: &WhiskerSystem,
        h: &Hypothesis,
    ) -> Result<Option<WitnessTest>, VerifyError> {
        let Some(pictures) = system.pictures() else {
            return Ok(None);
        };
        // In units of what the shapes state, whatever share of it counts now.
        let chi = system.own_share() * reduced_chi(&h.fit, system.picture_scale);
        let dof = h.fit.witness_count as f64;
        let sentence = format!(
            "Pictures: {} pairs count beside the wavelengths; they scatter about the model {chi:.2} times as far as the shapes state.",
            pictures.count()
        );
        Ok(chi_squared_tail(chi * chi * dof, dof).map(|p| WitnessTest {
            witness: "pictures".to_owned(),
            statistic: chi * chi * dof,
            dof,
            p,
            magnitude: chi,
            unit: "1".to_owned(),
            sentence,
            ..WitnessTest::default()
        }))
    }
}

/// What the pictures say of the accepted model, and which of both decided for its effects: by the
/// falls of the misfit of wavelengths and pictures, in variances.
fn picture_note(
    system: &WhiskerSystem,
    found: &SearchResult,
    accepted: &Hypothesis,
) -> Option<String> {
    let said = PicturePairs.test(system, accepted).ok()??.sentence;
    let (base, fit) = (&found.base.fit, &accepted.fit);
    if fit.terms.is_empty() {
        return Some(said);
    }
    // Each fall over its own variance, so that both can be compared.
    let wavelengths =
        (base.residual.norm_squared() - fit.residual.norm_squared()) / fit.readings_variance();
    let pictures = (base.auxiliary_residual.norm_squared() - fit.auxiliary_residual.norm_squared())
        / system.picture_scale.powi(2);
    let share = pictures.max(0.0) / (wavelengths.max(0.0) + pictures.max(0.0)).max(1e-300);
    let by = match share {
        s if s >= DECIDES => "pictures",
        s if s <= 1.0 - DECIDES => "wavelengths",
        _ => "both witnesses",
    };
    Some(format!(
        "{said} The accepted effects lower the misfit by {wavelengths:.0} variances in the wavelengths and {pictures:.0} in the pictures: {by} decided."
    ))
}

/// Pairs that do not count, and why.
fn note_pairs_left_out(system: &WhiskerSystem) -> Vec<String> {
    let Some(shapes) = &system.data.shapes else {
        return Vec::new();
    };
    let none = "Pictures: none of the pairs counts beside the wavelengths.".to_owned();
    let none = system.pictures.is_none().then_some(none);
    let further = system.pictures().map_or(&[][..], |p| &p.left_out);
    let each = shapes.left_out.iter().chain(further);
    none.into_iter()
        .chain(each.map(|p| format!("Pair {} does not count: {}.", p.name, p.why)))
        .collect()
}

/// The residual, where it is not beyond the model's own error.
fn note_model_error(found: &SearchResult) -> Option<String> {
    let test = &found.last_test;
    let driver = test
        .covariates
        .first()
        .filter(|_| test.within_model_error && test.p_covariates() < GENERIC)?;
    Some(format!(
        "Within model error: what remains follows {} ({}) and is {:.1} % of the misfit.",
        driver.covariate,
        driver.shape,
        100.0 * driver.gain / found.best.fit.ssr
    ))
}

/// Readings in motion that do not count.
fn note_unsteady(system: &WhiskerSystem) -> Option<String> {
    let count = system.path.readings.iter().filter(|r| r.unsteady).count();
    (count > 0).then(|| {
        format!(
            "{count} readings in motion do not count: the stage's speed was not that of its stroke there (a ramp, or an answer that came late), so \
             its position is not known well enough."
        )
    })
}

/// By how much the stage's clock was set.
fn note_clock(system: &WhiskerSystem) -> Option<String> {
    let set_s = system.stage_clock_s;
    (set_s != 0.0).then(|| {
        format!(
            "The stage's clock is set by {:.2} ms against the interrogator's, within the {:.1} ms that stamps of its answers leave open.",
            1e3 * set_s,
            1e3 * stage_clock::CLOCK_SD_S
        )
    })
}
