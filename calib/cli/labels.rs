//! Moment labels of a session's readings.

use anyhow::bail;
use clap::ValueEnum;
use wcal_core::WhiskerData;
use wcal_verify::whisker::WhiskerSystem;
use wcal_verify::whisker::twin_check::label_nmm;

/// Where the moments of the readings come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LabelSource {
    /// wcal's own rod at the session's poses
    Rod,
    /// twin.csv of an outside simulator
    Twin,
}

/// Moments of `WhiskerData::rows`, entry by entry.
#[derive(Debug, Clone, PartialEq)]
pub struct MomentLabels {
    /// Name for documents, e.g. `twin.csv`.
    pub source: String,
    /// N mm; none where the source has no label for the row.
    pub moments_nmm: Vec<Option<[f64; 2]>>,
}

/// Labels for every row of the points table; a rest row is zero where the source does not list it.
///
/// # Errors
/// Where the source is not there.
pub fn moment_labels(data: &WhiskerData, source: LabelSource) -> anyhow::Result<MomentLabels> {
    match source {
        LabelSource::Twin => {
            if data.twin.is_empty() {
                bail!(
                    "labels from twin.csv: expected [files] twin in session.toml, found none; try --labels rod"
                );
            }
            let moments_nmm = data.rows.iter().map(|row| label_nmm(data, row)).collect();
            Ok(MomentLabels {
                source: "twin.csv".into(),
                moments_nmm,
            })
        }
        LabelSource::Rod => {
            let system = WhiskerSystem::new(data, &[])?;
            let Some((_, base)) = system.moments(&[]) else {
                bail!(
                    "labels from the rod: expected an equilibrium at every pose, found none on some trajectory"
                );
            };
            let mut moments_nmm = vec![None; data.rows.len()];
            for (m, &row) in base.iter().zip(&system.path.rows) {
                moments_nmm[row] = Some(*m);
            }
            Ok(MomentLabels {
                source: "rod".into(),
                moments_nmm,
            })
        }
    }
}
