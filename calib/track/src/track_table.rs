//! `track.csv`.

use crate::TrackError;
use crate::arc_posterior::Region;
use crate::estimator::Contact;
use crate::reading::Reading;
use crate::track_document::TrackDocument;
use nalgebra::{Matrix3, Vector3};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use wcal_core::stream::Flags;
use wcal_network::NetworkError;

const COLUMNS: &str = "point,t_s,moment_1_nmm,moment_2_nmm,outside_valid_region,calibration_doubtful,contact_probability,\
     contact_x_mm,contact_y_mm,contact_z_mm,var_xx_mm2,var_yy_mm2,var_zz_mm2,cov_xy_mm2,cov_xz_mm2,cov_yz_mm2,\
     whisker,status,doubts,moment_1_sd_nmm,moment_2_sd_nmm,base_speed_mm_s,world_x_mm,world_y_mm,world_z_mm,world_var_xx_mm2,\
     world_var_yy_mm2,world_var_zz_mm2,world_cov_xy_mm2,world_cov_xz_mm2,world_cov_yz_mm2,segment,arclength_regions95,\
     several_probability,object_distance_mm,assumes";

/// A row of a track: a reading and its contact, base frame.
#[derive(Debug, Clone)]
pub struct TrackRow {
    /// Whisker.
    pub whisker: String,
    /// Codes of doubts.
    pub doubts: String,
    /// The reading.
    pub reading: Reading,
    /// The contact, with what was wrong with the reading among its flags and the number of its
    /// contact interval.
    pub contact: Contact,
    /// Distance of the contact from an object whose place is known, positive outside, mm.
    pub object_mm: Option<f64>,
    /// What the contact's regions assume.
    pub assumes: String,
}

/// Cells of numbers with so many digits, or as many empty ones.
fn cells<const N: usize>(values: Option<[f64; N]>, digits: usize) -> String {
    let cell = |value| format!(",{value:.digits$}");
    values.map_or_else(|| ",".repeat(N), |v| v.map(cell).concat())
}

/// Cells of a place, mm, and of its covariance, mm^2.
fn place_cells(place: Option<(Vector3<f64>, Matrix3<f64>)>) -> String {
    let entries = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    let spread = place.map(|(_, covariance)| entries.map(|at| covariance[at]));
    cells(place.map(|(at, _)| at.into()), 4) + &cells(spread, 8)
}

impl TrackRow {
    /// Place of the contact in the world, mm, with its covariance, mm^2.
    pub(crate) fn world(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (e, base) = self.contact.estimate.zip(self.reading.base)?;
        Some(base.to_world(&e.place_mm, &e.covariance_mm2))
    }

    /// The row as a line of `track.csv`; cells without a value are empty.
    pub fn line(&self) -> String {
        let (reading, contact) = (&self.reading, &self.contact);
        let (moments, estimate) = (reading.moments.as_ref(), contact.estimate);
        let outside = moments.map(|m| u8::from(!m.valid).to_string());
        let piece = |r: &Region| format!("{:.2}-{:.2}@{:.3}", r.from_mm, r.to_mm, r.probability);
        let regions: Vec<String> = contact.regions.iter().map(piece).collect();
        let segment = contact.number.map(|n| n.to_string()).unwrap_or_default();
        [
            // Microseconds: an absolute clock leaves no more digits.
            format!("{},{}", reading.point, (reading.t_s * 1e6).round() / 1e6),
            cells(moments.map(|m| m.moment_nmm), 6),
            format!(
                ",{},{}",
                outside.unwrap_or_default(),
                u8::from(!self.doubts.is_empty())
            ),
            cells(estimate.map(|e| [e.probability]), 4),
            place_cells(estimate.map(|e| (e.place_mm, e.covariance_mm2))),
            format!(",{},{},{}", self.whisker, contact.flags.text(), self.doubts),
            cells(moments.map(|m| m.sd_nmm), 6),
            cells(reading.base_mm_s.map(|v| [v]), 4),
            place_cells(self.world()),
            format!(",{segment},{}", regions.join("|")),
            cells(contact.several.map(|p| [p]), 4),
            cells(self.object_mm.map(|d| [d]), 4),
            format!(",{}\n", self.assumes),
        ]
        .concat()
    }
}

/// The files of a track, written as rows come.
pub struct TrackFiles {
    rows: BufWriter<File>,
    out: PathBuf,
    watch: Box<dyn FnMut(&TrackRow)>,
}

impl TrackFiles {
    /// Opens the table.
    ///
    /// # Errors
    /// Where it cannot be made.
    pub fn create(out: &Path) -> Result<Self, TrackError> {
        let file = File::create(out).map_err(TrackError::file("creating", out))?;
        let mut rows = BufWriter::new(file);
        writeln!(rows, "{COLUMNS}").map_err(TrackError::file("writing", out))?;
        Ok(Self {
            rows,
            out: out.to_owned(),
            watch: Box::new(|_| {}),
        })
    }

    /// Every row that is written is shown to `watch`, too.
    pub fn watch(&mut self, watch: impl FnMut(&TrackRow) + 'static) {
        self.watch = Box::new(watch);
    }

    /// Writes a row.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn row(&mut self, row: &TrackRow) -> Result<(), TrackError> {
        (self.watch)(row);
        let written = self.rows.write_all(row.line().as_bytes());
        written.map_err(TrackError::file("writing", &self.out))
    }

    /// Adds a flag to the status of all rows of a whisker that were written.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn flag(&mut self, whisker: &str, flag: Flags) -> Result<(), TrackError> {
        self.flush()?;
        let out = &self.out;
        let bytes = wcal_core::files::read(out).map_err(NetworkError::from)?;
        let text = String::from_utf8_lossy(&bytes);
        let [name, status] = ["whisker", "status"].map(|name| {
            COLUMNS
                .split(',')
                .position(|column| column == name)
                .unwrap_or(0)
        });
        let flagged = |line: &str| {
            let mut cells: Vec<&str> = line.split(',').collect();
            let both = format!("{}|{}", cells[status], flag.text());
            if cells[name] == whisker {
                cells[status] = both.strip_prefix("ok|").unwrap_or(&both);
            }
            cells.join(",") + "\n"
        };
        let (header, rows) = text.split_once('\n').unwrap_or_default();
        let text = format!("{header}\n") + &rows.lines().map(flagged).collect::<String>();
        wcal_core::files::write_atomic(out, text.as_bytes())
            .map_err(TrackError::file("writing", out))?;
        let file = File::options().append(true).open(out);
        self.rows = BufWriter::new(file.map_err(TrackError::file("opening", out))?);
        Ok(())
    }

    /// Brings everything so far into the files.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn flush(&mut self) -> Result<(), TrackError> {
        self.rows
            .flush()
            .map_err(TrackError::file("writing", &self.out))
    }

    /// Writes the summary beside the table, and gives its text.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn finish(mut self, document: &TrackDocument) -> Result<String, TrackError> {
        self.flush()?;
        let path = companion(&self.out, ".json");
        let text =
            serde_json::to_string_pretty(document).map_err(TrackError::file("writing", &path))?;
        wcal_core::files::write_atomic(&path, text.as_bytes())
            .map_err(TrackError::file("writing", &path))?;
        Ok(text)
    }
}

/// `track.csv` -> `track` + ending.
pub fn companion(out: &Path, ending: &str) -> PathBuf {
    let stem = out
        .file_stem()
        .map(|s| s.to_string_lossy().into_owned())
        .unwrap_or_default();
    out.with_file_name(format!("{stem}{ending}"))
}
