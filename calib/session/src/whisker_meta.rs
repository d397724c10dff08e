//! `[whisker]`, `[moments]`, `[fbg]` and `[[trajectory]]` of a whisker session.

use crate::document::{sections, unit_vector};
use crate::error::{InputError, SessionError};
use crate::row::Row;
use crate::table::read_own;
use crate::warning::SessionWarning;
use nalgebra::Vector3;
use serde::Deserialize;
use std::path::Path;
use wcal_core::observation::RestShape;
use wcal_core::ranges::{self, OutOfRange, Range};
use wcal_core::{FbgSpec, InputFile, MomentAxes, Purpose, Trajectory, WhiskerSpec};

/// Wavelengths that interrogators of this kind can read, nm.
pub(crate) const WAVELENGTH_NM: (f64, f64) = (1400.0, 1700.0);

/// Root of a rest shape may lie this far from the base frame's origin, mm.
const ROOT_TOLERANCE_MM: f64 = 0.05;

/// Numbers that a session may state beside those of `[whisker]`.
pub(crate) const SESSION_RANGES: &[Range] = &[
    Range::real("trajectory.origin_mm", -1e5, 1e5),
    Range::real("trajectory.nominal_arclength_mm", 0.0, 2000.0),
    Range::real("fbg.nominal_nm", WAVELENGTH_NM.0, WAVELENGTH_NM.1),
    Range::real("fbg.reference_nominal_nm", WAVELENGTH_NM.0, WAVELENGTH_NM.1),
    Range::real("temperature_pm_per_degc", -1e4, 1e4),
    Range::real("reference_temperature_pm_per_degc", -1e4, 1e4),
];

/// `[whisker]`: the shape by lengths or as points.
#[derive(Deserialize)]
pub(crate) struct WhiskerSection {
    diameter_mm: f64,
    youngs_gpa: f64,
    shear_gpa: f64,
    density_kg_m3: Option<f64>,
    length_mm: Option<f64>,
    straight_mm: Option<f64>,
    arc_radius_mm: Option<f64>,
    rest_shape: Option<Vec<[f64; 3]>>,
    gravity_direction: Option<[f64; 3]>,
}

/// `[moments]`.
#[derive(Default, Deserialize)]
pub(crate) struct MomentSection {
    axes: Option<[[f64; 3]; 2]>,
    sign: Option<f64>,
}

/// An entry of `[[trajectory]]`.
#[derive(Deserialize)]
pub(crate) struct TrajectorySection {
    id: u32,
    origin_mm: [f64; 3],
    direction: [f64; 3],
    nominal_arclength_mm: Option<f64>,
}

/// Holds the tables `[whisker]`, `[moments]` and `[fbg]` of a rig, which a recorded session takes
/// over as they are, against what a session may state; messages call the rig's file `file`.
///
/// # Errors
/// The first key that no session could be read with.
pub fn check_wire(
    file: &str,
    whisker: &toml::Table,
    moments: Option<&toml::Table>,
    fbg: &toml::Table,
) -> Result<(), SessionError> {
    #[derive(Deserialize)]
    struct Wire {
        whisker: WhiskerSection,
        #[serde(default)]
        moments: MomentSection,
        #[serde(rename = "fbg")]
        _fbg: FbgSpec,
    }
    let mut tables = toml::Table::new();
    tables.insert("whisker".to_owned(), whisker.clone().into());
    tables.extend(moments.map(|m| ("moments".to_owned(), m.clone().into())));
    tables.insert("fbg".to_owned(), fbg.clone().into());
    ranges::check(&tables, &[SESSION_RANGES]).map_err(|e| InputError::range(file, e))?;
    let wire: Wire = sections(file, &tables, &mut Vec::new())?;
    wire.moments.axes(file)?;
    wire.whisker.spec(file, None, &mut Vec::new())?;
    Ok(())
}

impl WhiskerSection {
    /// The wire; `shape_file` is the table of its shape where that is not in the section.
    pub(crate) fn spec(
        self,
        file: &str,
        shape_file: Option<(&str, Vec<Vector3<f64>>)>,
        warnings: &mut Vec<SessionWarning>,
    ) -> Result<WhiskerSpec, InputError> {
        let of = |key: &str| format!("whisker.{key}");
        let inline = self
            .rest_shape
            .map(|points| (file, points.into_iter().map(Vector3::from).collect()));
        // Where the shape comes from, which is what a message about it names.
        let shape = inline.or(shape_file);
        let shape_place = shape.as_ref().map(|(place, _)| *place);
        let rest_shape = match shape {
            Some((place, points)) => {
                check_polyline(place, &points)?;
                let polyline_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
                if let Some(declared_mm) = self
                    .length_mm
                    .filter(|l| (l - polyline_mm).abs() > 0.01 * polyline_mm)
                {
                    let text = format!(
                        "the rest shape is {polyline_mm:.3} mm long, length_mm says {declared_mm}"
                    );
                    warnings.push(SessionWarning::other(place, text));
                }
                RestShape::Polyline(points)
            }
            None => {
                let needed = |key: &str, value: Option<f64>| {
                    let nothing = || {
                        InputError::new(file, "a number, or a rest_shape", "nothing").field(of(key))
                    };
                    value.ok_or_else(nothing)
                };
                let length_mm = needed("length_mm", self.length_mm)?;
                let straight_mm = needed("straight_mm", self.straight_mm)?;
                // A wholly straight wire has no arc; any radius describes it.
                let no_arc = (straight_mm >= length_mm).then_some(length_mm);
                let arc_radius_mm = needed("arc_radius_mm", self.arc_radius_mm.or(no_arc))?;
                RestShape::StraightArc {
                    straight_mm,
                    arc_radius_mm,
                    length_mm,
                }
            }
        };
        let gravity = self
            .gravity_direction
            .map(|v| unit_vector(file, &of("gravity_direction"), v));
        let whisker = WhiskerSpec {
            diameter_mm: self.diameter_mm,
            youngs_gpa: self.youngs_gpa,
            shear_gpa: self.shear_gpa,
            density_kg_m3: self.density_kg_m3,
            rest_shape,
            gravity_direction: gravity.transpose()?,
        };
        // The shape's keys may stand in a table of their own; the last part is the name in the
        // file.
        let wrong = |e: OutOfRange| match shape_place
            .filter(|place| *place != file && e.key.starts_with("rest_shape"))
        {
            Some(place) => InputError::new(place, e.expected, e.found).field(e.key),
            None => {
                let key = of(e.key.rsplit('.').next().unwrap_or_default());
                InputError::new(file, e.expected, e.found)
                    .field(key)
                    .hint("check the unit in the key's name")
            }
        };
        whisker.check().map_err(wrong)?;
        Ok(whisker)
    }
}

/// Points of the table of a rest shape.
pub(crate) fn read_polyline(
    folder: &Path,
    name: &str,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<Vector3<f64>>, InputFile), SessionError> {
    let table = read_own(&folder.join(name), name)?;
    table.others(&["x_mm", "y_mm", "z_mm"], &[])?;
    let point = |row: Row<'_>| {
        Ok(Vector3::new(
            row.required("x_mm")?,
            row.required("y_mm")?,
            row.required("z_mm")?,
        ))
    };
    let points = Row::all(&table)
        .map(point)
        .collect::<Result<_, InputError>>()?;
    warnings.extend(table.warning());
    Ok((points, table.input(Purpose::Description)))
}

fn check_polyline(file: &str, points: &[Vector3<f64>]) -> Result<(), InputError> {
    let error =
        |expected: &str, found: String| InputError::new(file, expected, found).field("rest_shape");
    if points.len() < 2 {
        return Err(error("at least two points", format!("{}", points.len())));
    }
    // Moments are about the origin: a root elsewhere would have other levers.
    if points[0].norm() > ROOT_TOLERANCE_MM {
        let p = points[0];
        let found = format!("({}, {}, {})", p.x, p.y, p.z);
        return Err(error(
            "the root at (0, 0, 0), the origin of the base frame",
            found,
        ));
    }
    match points.windows(2).position(|w| (w[1] - w[0]).norm() < 1e-9) {
        Some(index) => Err(error(
            "points that differ from their neighbours",
            format!("point {} twice", index + 1),
        )),
        None => Ok(()),
    }
}

impl MomentSection {
    /// The moment components.
    pub(crate) fn axes(&self, file: &str) -> Result<MomentAxes, InputError> {
        let mut moments = MomentAxes::default();
        if let Some([first, second]) = self.axes {
            moments.axes = [
                unit_vector(file, "moments.axes", first)?,
                unit_vector(file, "moments.axes", second)?,
            ];
            let cosine = moments.axes[0].dot(&moments.axes[1]);
            // Two axes on one line hold one moment twice, and the other not at all.
            if cosine.abs() > 0.99 {
                let found = format!("parallel ones (cosine {cosine:.4})");
                return Err(
                    InputError::new(file, "two different directions", found).field("moments.axes")
                );
            }
        }
        moments.sign = self.sign.unwrap_or(moments.sign);
        if moments.sign.abs() != 1.0 {
            let found = moments.sign.to_string();
            return Err(InputError::new(file, "1 or -1", found).field("moments.sign"));
        }
        Ok(moments)
    }
}

/// The paths of the groove.
pub(crate) fn trajectories(
    file: &str,
    sections: Vec<TrajectorySection>,
) -> Result<Vec<Trajectory>, InputError> {
    let mut out: Vec<Trajectory> = Vec::new();
    for (k, section) in sections.into_iter().enumerate() {
        let TrajectorySection {
            id,
            origin_mm,
            direction,
            nominal_arclength_mm,
        } = section;
        let of = |key: &str| format!("trajectory #{}.{key}", k + 1);
        if out.iter().any(|t| t.id == id) {
            let found = format!("trajectory {id} again");
            return Err(InputError::new(file, "every trajectory once", found).field(of("id")));
        }
        let direction = unit_vector(file, &of("direction"), direction)?;
        out.push(Trajectory {
            id,
            origin_mm: origin_mm.into(),
            direction,
            nominal_arclength_mm,
        });
    }
    Ok(out)
}
