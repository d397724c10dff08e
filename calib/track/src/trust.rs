//! What speaks against tracking with a calibration and a model.

use crate::TrackError;
use crate::network::NetworkEstimator;
use crate::whisker_track::WhiskerFacts;
use crate::zero::{WHITE, ZERO};
use std::path::{Path, PathBuf};
use wcal_calibration::{
    CalibrationModel, TrustIssue, WhiskerCalibration, of_whisker, read_unsealed, trust_issues,
};
use wcal_core::observation::MomentAxes;
use wcal_core::ranges::OutOfRange;
use wcal_core::{CalibrationFile, CalibrationFrame, VerificationStatus, WhiskerSpec, WireFrame};
use wcal_network::filter::FilterBank;
use wcal_network::model_file::Card;
use wcal_network::tracker::trained_steps_s;
use wcal_network::{InverseGrid, StaticInverse, Tracker};

/// What speaks against a calibration and a model, each with a short code for the rows and a
/// sentence for people.
#[derive(Debug, Clone, Default)]
pub struct TrustIssues(Vec<TrustIssue>);

impl TrustIssues {
    /// Codes with `|` between them.
    pub fn codes(&self) -> String {
        let codes: Vec<_> = self.0.iter().map(TrustIssue::code).collect();
        codes.join("|")
    }

    /// Sentences.
    pub fn messages(&self) -> Vec<String> {
        self.0.iter().map(ToString::to_string).collect()
    }
}

/// A whisker's calibration and model, judged before the model itself is loaded.
pub struct WhiskerModel<'a> {
    /// Name in the rig.
    pub name: String,
    /// Where the calibration lies.
    pub place: PathBuf,
    /// Calibration.
    pub file: CalibrationFile<CalibrationModel>,
    /// Card of the network; none where the motion is known.
    card: Option<Card>,
    /// The network, once it is loaded.
    pub tracker: Option<&'a Tracker>,
    /// What speaks against them.
    pub doubts: TrustIssues,
}

impl From<&WhiskerModel<'_>> for WhiskerFacts {
    fn from(model: &WhiskerModel<'_>) -> Self {
        Self {
            name: model.name.clone(),
            doubt_codes: model.doubts.codes(),
            doubts: model.doubts.messages(),
            calibration_sha256: model.file.content_sha256.clone(),
        }
    }
}

/// Filters that know the noise of the moments that come through a calibration.
pub fn filters_for(filters: FilterBank, model: &CalibrationModel) -> FilterBank {
    let noise_nmm = model
        .whisker()
        .map_or(0.0, WhiskerCalibration::noise_sd_nmm);
    // Within a record one share of the noise from pose to pose is white, another is the zero's.
    filters.with_measurement_noise(WHITE * noise_nmm, ZERO * noise_nmm)
}

impl<'a> WhiskerModel<'a> {
    /// Its calibration from wavelengths to moments.
    ///
    /// # Errors
    /// Where it is of another kind of session.
    pub fn calibration(&self) -> Result<&dyn WhiskerCalibration, TrackError> {
        Ok(of_whisker(&self.place, &self.file)?)
    }

    /// The frame of the wire.
    ///
    /// # Errors
    /// Where the moments are not across the wire's root.
    pub fn frame(&self) -> Result<WireFrame, TrackError> {
        let of_card = self.card.as_ref().map(|card| &card.whisker);
        let own = self.file.whisker.as_ref().or(of_card);
        let own = own.ok_or_else(|| self.nameless())?;
        // Older ones have moments about y and z.
        let seen = self.file.frame.as_ref();
        let axes = seen.map_or_else(MomentAxes::default, CalibrationFrame::moments);
        WireFrame::new(own, &axes).map_err(|e: OutOfRange| {
            let what = format!("{}: frame.{}", self.place.display(), e.key);
            TrackError::value(what, e.expected, e.found)
        })
    }

    /// The calibration's whisker in that frame, where it says which: a network knows one
    /// orientation.
    fn own_whisker(&self) -> Result<Option<WhiskerSpec>, TrackError> {
        let own = self.file.whisker.as_ref();
        own.map(|w| Ok(self.frame()?.whisker(w))).transpose()
    }

    /// The whisker in that frame: the model's, else the calibration's.
    ///
    /// # Errors
    /// Where neither says.
    pub fn whisker(&self) -> Result<WhiskerSpec, TrackError> {
        let of_card = self.card.as_ref().map(|card| card.whisker.clone());
        of_card
            .map_or_else(|| self.own_whisker(), |whisker| Ok(Some(whisker)))?
            .ok_or_else(|| self.nameless())
    }

    fn nameless(&self) -> TrackError {
        let place = self.place.display().to_string();
        TrackError::value(
            place,
            "a calibration that says of which whisker it is",
            "an older one",
        )
    }

    /// Its network, with filters that know the calibration's noise; none without one.
    ///
    /// # Errors
    /// Where the wire is another than the network's and cannot be bent.
    pub fn estimator(&self, vouched: bool) -> Result<Option<NetworkEstimator<'_>>, TrackError> {
        let Some((tracker, card)) = self.tracker.zip(self.card.as_ref()) else {
            return Ok(None);
        };
        let own = self.own_whisker()?;
        let other = own.filter(|w| w.difference(&card.whisker).is_some());
        let other = other.map(|w| StaticInverse::new(&w, InverseGrid::coarse()));
        let other = other.transpose()?;
        let filters = filters_for(tracker.filters, &self.file.model);
        Ok(Some(NetworkEstimator::new(
            (tracker, card),
            filters,
            vouched,
            other,
        )))
    }

    /// Whether its contacts come from a network.
    pub fn by_network(&self) -> bool {
        self.card.is_some()
    }

    /// Reads a calibration and judges it by itself and beside the model, where contacts come from
    /// one.
    ///
    /// # Errors
    /// Where the calibration cannot be read, or was changed so that its content means nothing any
    /// more.
    pub fn read(name: &str, place: &Path, card: Option<Card>) -> Result<Self, TrackError> {
        let (file, changed) = read_unsealed(place)?;
        of_whisker(place, &file)?;
        let mut issues: Vec<TrustIssue> = changed.into_iter().collect();
        issues.extend(trust_issues(&file, jiff::Timestamp::now())?);
        if file.verification == VerificationStatus::Unverified {
            issues.push(TrustIssue::NeverVerified);
        }
        let mut own = Self {
            name: name.to_owned(),
            place: place.to_owned(),
            file,
            card,
            tracker: None,
            doubts: TrustIssues(issues),
        };
        let both = own.own_whisker()?.zip(own.card.as_ref());
        let differs = both.and_then(|(whisker, card)| whisker.difference(&card.whisker));
        own.doubts.0.extend(differs.map(TrustIssue::OtherWhisker));
        Ok(own)
    }

    /// Judges the whisker of a session beside that of the calibration.
    pub fn check_session(&mut self, whisker: &WhiskerSpec) {
        let own = self.file.whisker.as_ref();
        let differs = own.and_then(|w| w.difference(whisker));
        self.doubts.0.extend(differs.map(TrustIssue::OtherSession));
    }

    /// Judges the time between readings (s) by those that the network was trained with.
    pub fn check_step(&mut self, step_s: Option<f64>) {
        let Some(card) = &self.card else { return };
        let trained_s = trained_steps_s(card.training.time_factor);
        let [low, high] = trained_s;
        if let Some(found_s) = step_s.filter(|s| !(low..=high).contains(s)) {
            let issue = TrustIssue::SampleRate { trained_s, found_s };
            self.doubts.0.push(issue);
        }
    }
}
