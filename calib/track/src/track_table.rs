//! `track.csv`.

use crate::TrackError;
use crate::arc_posterior::Region;
use crate::estimator::ContactEstimate;
use crate::track_document::TrackDocument;
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use wcal_core::stream::{Flags, StreamMoments};
use wcal_network::stream::BasePose;

const COLUMNS: &str = "point,t_s,moment_1_nmm,moment_2_nmm,outside_valid_region,calibration_doubtful,contact_probability,\
     contact_x_mm,contact_y_mm,contact_z_mm,var_xx_mm2,var_yy_mm2,var_zz_mm2,cov_xy_mm2,cov_xz_mm2,cov_yz_mm2,\
     whisker,status,doubts,moment_1_sd_nmm,moment_2_sd_nmm,base_speed_mm_s,world_x_mm,world_y_mm,world_z_mm,world_var_xx_mm2,\
     world_var_yy_mm2,world_var_zz_mm2,world_cov_xy_mm2,world_cov_xz_mm2,world_cov_yz_mm2,segment,arclength_regions95,\
     several_probability,object_distance_mm,assumes";

/// A row of a track.
#[derive(Debug, Clone)]
pub struct TrackRow {
    /// Number of the reading or of the scan.
    pub point: i64,
    /// Time of validity, s.
    pub t_s: f64,
    /// Whisker.
    pub whisker: String,
    /// Flags.
    pub flags: Flags,
    /// Codes of doubts.
    pub doubts: String,
    /// Moments.
    pub moments: Option<StreamMoments>,
    /// The contact.
    pub estimate: Option<ContactEstimate>,
    /// Speed of the base along +z, mm/s.
    pub base_mm_s: Option<f64>,
    /// Pose of the base.
    pub base: Option<BasePose>,
    /// Contact interval that the row belongs to.
    pub segment: Option<u64>,
    /// 95 % region of highest density over the arc length.
    pub regions: Vec<Region>,
    /// Probability of several contacts where there is contact.
    pub several: Option<f64>,
    /// Distance of the contact from an object whose place is known, positive outside, mm.
    pub object_mm: Option<f64>,
    /// What the contact's regions assume.
    pub assumes: String,
}

/// Appends numbers, or as many empty cells.
fn cells(out: &mut String, values: Option<&[f64]>, count: usize, digits: usize) {
    for k in 0..count {
        out.push(',');
        if let Some(values) = values {
            let _ = write!(out, "{:.digits$}", values[k]);
        }
    }
}

fn spread(c: &Matrix3<f64>) -> [f64; 6] {
    [
        c[(0, 0)],
        c[(1, 1)],
        c[(2, 2)],
        c[(0, 1)],
        c[(0, 2)],
        c[(1, 2)],
    ]
}

impl TrackRow {
    fn place(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        self.estimate.map(|e| (e.place_mm, e.covariance_mm2))
    }

    /// The row as a line of `track.csv`; cells without a value are empty.
    pub fn line(&self) -> String {
        // Microseconds: an absolute clock leaves no more digits.
        let mut out = format!("{},{}", self.point, (self.t_s * 1e6).round() / 1e6);
        cells(
            &mut out,
            self.moments.as_ref().map(|m| &m.moment_nmm[..]),
            2,
            6,
        );
        let outside = self
            .moments
            .map_or_else(String::new, |m| u8::from(!m.valid).to_string());
        let _ = write!(out, ",{outside},{}", u8::from(!self.doubts.is_empty()));
        let place = self.place();
        cells(
            &mut out,
            self.estimate
                .map(|e| [e.probability])
                .as_ref()
                .map(|v| &v[..]),
            1,
            4,
        );
        cells(&mut out, place.as_ref().map(|p| p.0.as_slice()), 3, 4);
        cells(
            &mut out,
            place
                .as_ref()
                .map(|p| spread(&p.1))
                .as_ref()
                .map(|v| &v[..]),
            6,
            8,
        );
        let _ = write!(
            out,
            ",{},{},{}",
            self.whisker,
            self.flags.text(),
            self.doubts
        );
        cells(&mut out, self.moments.as_ref().map(|m| &m.sd_nmm[..]), 2, 6);
        cells(
            &mut out,
            self.base_mm_s.map(|v| [v]).as_ref().map(|v| &v[..]),
            1,
            4,
        );
        let world = self.world();
        cells(&mut out, world.as_ref().map(|p| p.0.as_slice()), 3, 4);
        cells(
            &mut out,
            world
                .as_ref()
                .map(|p| spread(&p.1))
                .as_ref()
                .map(|v| &v[..]),
            6,
            8,
        );
        let segment = self.segment.map_or_else(String::new, |n| n.to_string());
        let piece = |r: &Region| format!("{:.2}-{:.2}@{:.3}", r.from_mm, r.to_mm, r.probability);
        let regions = self.regions.iter().map(piece).collect::<Vec<_>>().join("|");
        let _ = write!(out, ",{segment},{regions}");
        cells(
            &mut out,
            self.several.map(|p| [p]).as_ref().map(|v| &v[..]),
            1,
            4,
        );
        cells(
            &mut out,
            self.object_mm.map(|d| [d]).as_ref().map(|v| &v[..]),
            1,
            4,
        );
        let _ = writeln!(out, ",{}", self.assumes);
        out
    }

    fn world(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let ((point, covariance), base) = self.place().zip(self.base)?;
        Some(base.to_world(&point, &covariance))
    }
}

/// The files of a track, written as rows come.
#[derive(Debug)]
pub struct TrackFiles {
    rows: BufWriter<File>,
    out: PathBuf,
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
        })
    }

    /// Writes a row.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn row(&mut self, row: &TrackRow) -> Result<(), TrackError> {
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
        let bytes = wcal_core::files::read(out).map_err(TrackError::file("reading", out))?;
        let text = String::from_utf8_lossy(&bytes);
        let at = |name: &str| {
            COLUMNS
                .split(',')
                .position(|column| column == name)
                .unwrap_or_default()
        };
        let (name, status) = (at("whisker"), at("status"));
        let flagged = |line: &str| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if cells[name] == whisker {
                let before = Some(&cells[status])
                    .filter(|s| *s != "ok")
                    .map(|s| format!("{s}|"));
                cells[status] = before.unwrap_or_default() + &flag.text();
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
