//! What speaks against tracking with a calibration and a model.

use crate::TrackError;
use crate::network::NetworkEstimator;
use crate::zero::{WHITE, ZERO};
use std::path::{Path, PathBuf};
use wcal_calibration::{
    CalibrationModel, TrustIssue, WhiskerCalibration, of_whisker, read_unsealed, standing,
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
        self.0
            .iter()
            .map(TrustIssue::code)
            .collect::<Vec<_>>()
            .join("|")
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

/// Filters that know the noise of the moments that come through a calibration.
pub fn filters_for(filters: FilterBank, model: &CalibrationModel) -> FilterBank {
    let noise_nmm = model
        .whisker()
        .map_or(0.0, WhiskerCalibration::noise_sd_nmm);
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
        let own = self
            .file
            .whisker
            .as_ref()
            .or(self.card.as_ref().map(|card| &card.whisker));
        frame_of(&self.file, own.ok_or_else(|| self.nameless())?, &self.place)
    }

    /// The whisker in that frame: the model's, else the calibration's.
    ///
    /// # Errors
    /// Where neither says.
    pub fn whisker(&self) -> Result<WhiskerSpec, TrackError> {
        match (&self.card, &self.file.whisker) {
            (Some(card), _) => Ok(card.whisker.clone()),
            (None, Some(whisker)) => Ok(self.frame()?.whisker(whisker)),
            (None, None) => Err(self.nameless()),
        }
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
        let own = self
            .file
            .whisker
            .as_ref()
            .map(|w| Ok::<_, TrackError>(self.frame()?.whisker(w)));
        let other = own
            .transpose()?
            .filter(|w| w.difference(&card.whisker).is_some());
        let other = other
            .map(|w| StaticInverse::new(&w, InverseGrid::coarse()))
            .transpose()?;
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
        let (file, mut issues) = calibration_issues(place)?;
        // In the frame of the wire: a network knows one orientation.
        let own = file
            .whisker
            .as_ref()
            .map(|w| Ok::<_, TrackError>(frame_of(&file, w, place)?.whisker(w)));
        let own = own.transpose()?;
        let differs = own
            .as_ref()
            .zip(card.as_ref())
            .and_then(|(w, c)| w.difference(&c.whisker));
        issues.extend(differs.map(TrustIssue::OtherWhisker));
        let doubts = TrustIssues(issues);
        let (name, place) = (name.to_owned(), place.to_owned());
        Ok(Self {
            name,
            place,
            file,
            card,
            tracker: None,
            doubts,
        })
    }

    /// Judges the whisker of a session beside that of the calibration.
    pub fn check_session(&mut self, whisker: &WhiskerSpec) {
        let differs = self
            .file
            .whisker
            .as_ref()
            .and_then(|w| w.difference(whisker));
        self.doubts.0.extend(differs.map(TrustIssue::OtherSession));
    }

    /// Judges the time between readings (s) by those that the network was trained with.
    pub fn check_step(&mut self, step_s: Option<f64>) {
        let Some(card) = &self.card else { return };
        let trained_s = trained_steps_s(card.training.time_factor);
        let [low, high] = trained_s;
        if let Some(found_s) = step_s.filter(|s| !(low..=high).contains(s)) {
            self.doubts
                .0
                .push(TrustIssue::SampleRate { trained_s, found_s });
        }
    }
}

/// The frame of a wire by what its calibration says of the session; older ones have moments about y
/// and z.
fn frame_of(
    file: &CalibrationFile<CalibrationModel>,
    whisker: &WhiskerSpec,
    place: &Path,
) -> Result<WireFrame, TrackError> {
    let axes = file
        .frame
        .as_ref()
        .map_or_else(MomentAxes::default, CalibrationFrame::moments);
    WireFrame::new(whisker, &axes).map_err(|e: OutOfRange| {
        let what = format!("{}: frame.{}", place.display(), e.key);
        TrackError::value(what, e.expected, e.found)
    })
}

/// A whisker's calibration, and what speaks against it by itself.
///
/// # Errors
/// Where the file cannot be read, or was changed so that its content means nothing any more.
fn calibration_issues(
    place: &Path,
) -> Result<(CalibrationFile<CalibrationModel>, Vec<TrustIssue>), TrackError> {
    let (file, changed) = read_unsealed(place)?;
    of_whisker(place, &file)?;
    let mut issues: Vec<TrustIssue> = changed.into_iter().collect();
    issues.extend(standing(&file, jiff::Timestamp::now())?);
    if file.verification == VerificationStatus::Unverified {
        issues.push(TrustIssue::NeverVerified);
    }
    Ok((file, issues))
}
