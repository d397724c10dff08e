//! `[whisker]`, `[moments]`, `[fbg]` and `[[trajectory]]` of a whisker session.

use crate::document::Section;
use crate::error::{InputError, SessionError};
use crate::table::Table;
use crate::warning::{SessionWarning, WarningKind};
use nalgebra::Vector3;
use std::path::Path;
use wcal_core::observation::RestShape;
use wcal_core::ranges::{OutOfRange, Range};
use wcal_core::{FbgSpec, InputFile, MomentAxes, Trajectory, WhiskerSpec};

/// Wavelengths that interrogators of this kind can read, nm.
pub(crate) const WAVELENGTH_NM: (f64, f64) = (1400.0, 1700.0);

/// Root of a rest shape may lie this far from the base frame's origin, mm.
const ROOT_TOLERANCE_MM: f64 = 0.05;

/// Numbers that a session may state beside those of `[whisker]`.
pub(crate) const SESSION_RANGES: &[Range] = &[
    Range::real("trajectory.origin_mm", -1e5, 1e5),
    Range::real("temperature_pm_per_degc", -1e4, 1e4),
    Range::real("reference_temperature_pm_per_degc", -1e4, 1e4),
];

/// What `session.toml` says of a whisker.
pub(crate) struct WhiskerMeta {
    pub(crate) whisker: WhiskerSpec,
    pub(crate) moments: MomentAxes,
    pub(crate) fbg: FbgSpec,
    pub(crate) trajectories: Vec<Trajectory>,
    pub(crate) inputs: Vec<InputFile>,
}

/// Reads and checks every whisker key; `shape_file` is `[files] rest_shape`.
pub(crate) fn read(
    root: &Section<'_>,
    folder: &Path,
    shape_file: Option<&str>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<WhiskerMeta, SessionError> {
    let mut inputs = Vec::new();
    let (whisker, moments, fbg) = wire(root, folder, shape_file, &mut inputs, warnings)?;
    let trajectories = trajectories(root, warnings)?;
    Ok(WhiskerMeta { whisker, moments, fbg, trajectories, inputs })
}

/// Holds the tables `[whisker]`, `[moments]` and `[fbg]` of a rig, which a recorded session takes over as they are, against what a
/// session may state; messages call the rig's file `file`.
///
/// # Errors
/// The first key that no session could be read with.
pub fn check_wire(
    file: &str,
    whisker: &toml::Table,
    moments: Option<&toml::Table>,
    fbg: &toml::Table,
) -> Result<(), SessionError> {
    let mut tables = toml::Table::new();
    tables.insert("whisker".to_owned(), whisker.clone().into());
    tables.extend(moments.map(|m| ("moments".to_owned(), m.clone().into())));
    tables.insert("fbg".to_owned(), fbg.clone().into());
    let root = Section::root(file, &tables);
    wire(&root, Path::new(""), None, &mut Vec::new(), &mut Vec::new()).map(drop)
}

/// The wire, its moments and its gratings.
fn wire(
    root: &Section<'_>,
    folder: &Path,
    shape_file: Option<&str>,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(WhiskerSpec, MomentAxes, FbgSpec), SessionError> {
    let section = root.section("whisker")?;
    let section = section.ok_or_else(|| root.error("whisker", "a table [whisker]", "nothing"))?;
    let whisker = spec(&section, folder, shape_file, inputs, warnings)?;
    warn_unknown(&section, warnings);
    let moments = match root.section("moments")? {
        Some(section) => {
            let moments = moment_axes(&section)?;
            warn_unknown(&section, warnings);
            moments
        }
        None => MomentAxes::default(),
    };
    let fbg = match root.section("fbg")? {
        Some(section) => {
            let fbg = gratings(&section)?;
            warn_unknown(&section, warnings);
            fbg
        }
        None => FbgSpec::default(),
    };
    Ok((whisker, moments, fbg))
}

pub(crate) fn warn_unknown(section: &Section<'_>, warnings: &mut Vec<SessionWarning>) {
    let of = |key: String| SessionWarning::new("session.toml", WarningKind::UnknownKey(key));
    warnings.extend(section.unknown_keys().into_iter().map(of));
}

fn spec(
    section: &Section<'_>,
    folder: &Path,
    shape_file: Option<&str>,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<WhiskerSpec, SessionError> {
    let length_mm = section.number("length_mm")?;
    let straight_mm = section.number("straight_mm")?;
    let arc_radius_mm = section.number("arc_radius_mm")?;
    let inline = section.vectors("rest_shape")?;
    // Where the shape comes from, which is what a message about it names.
    let shape_file = shape_file.filter(|_| inline.is_none());
    let polyline = match (inline, shape_file) {
        (Some(points), _) => Some(points),
        (None, Some(name)) => Some(read_polyline(folder, name, inputs, warnings)?),
        (None, None) => None,
    };
    let rest_shape = match polyline {
        Some(points) => {
            let file = shape_file.unwrap_or_else(|| section.file());
            check_polyline(file, &points)?;
            let polyline_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
            if let Some(declared_mm) = length_mm.filter(|l| (l - polyline_mm).abs() > 0.01 * polyline_mm) {
                let kind = WarningKind::RestShapeLength { polyline_mm, declared_mm };
                warnings.push(SessionWarning::new(file, kind));
            }
            RestShape::Polyline(points)
        }
        None => straight_arc(section, length_mm, straight_mm, arc_radius_mm)?,
    };
    let required = |key: &str| section.number(key)?.ok_or_else(|| section.error(key, "a number", "nothing"));
    let whisker = WhiskerSpec {
        diameter_mm: required("diameter_mm")?,
        youngs_gpa: required("youngs_gpa")?,
        shear_gpa: required("shear_gpa")?,
        density_kg_m3: section.number("density_kg_m3")?,
        rest_shape,
        gravity_direction: section.unit_vector("gravity_direction")?,
    };
    // The shape's keys may stand in a table of their own; the last part is the name in the file.
    let wrong = |e: OutOfRange| {
        if let Some(file) = shape_file.filter(|_| e.key.starts_with("rest_shape")) {
            return InputError::new(file, e.expected, e.found).field(e.key);
        }
        let key = e.key.rsplit('.').next().unwrap_or_default();
        section.error(key, e.expected, e.found).hint("check the unit in the key's name")
    };
    whisker.check().map_err(wrong)?;
    Ok(whisker)
}

fn straight_arc(
    section: &Section<'_>,
    length_mm: Option<f64>,
    straight_mm: Option<f64>,
    arc_radius_mm: Option<f64>,
) -> Result<RestShape, InputError> {
    let needed = |key: &str| section.error(key, "a number, or a rest_shape", "nothing");
    let length_mm = length_mm.ok_or_else(|| needed("length_mm"))?;
    let straight_mm = straight_mm.ok_or_else(|| needed("straight_mm"))?;
    // A wholly straight wire has no arc; any radius describes it.
    let no_arc = (straight_mm >= length_mm).then_some(length_mm);
    let arc_radius_mm = arc_radius_mm.or(no_arc).ok_or_else(|| needed("arc_radius_mm"))?;
    Ok(RestShape::StraightArc { straight_mm, arc_radius_mm, length_mm })
}

fn read_polyline(
    folder: &Path,
    name: &str,
    inputs: &mut Vec<InputFile>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<Vec<Vector3<f64>>, SessionError> {
    let mut table = Table::open(&folder.join(name), name)?;
    let columns = [table.required("x_mm")?, table.required("y_mm")?, table.required("z_mm")?];
    let mut points = Vec::new();
    while let Some(row) = table.next_row()? {
        let [x, y, z] = columns;
        points.push(Vector3::new(row.required(x)?, row.required(y)?, row.required(z)?));
    }
    warnings.extend(table.open_end());
    inputs.push(table.finish()?);
    Ok(points)
}

fn check_polyline(file: &str, points: &[Vector3<f64>]) -> Result<(), InputError> {
    let error = |expected: &str, found: String| InputError::new(file, expected, found).field("rest_shape");
    if points.len() < 2 {
        return Err(error("at least two points", format!("{}", points.len())));
    }
    if points[0].norm() > ROOT_TOLERANCE_MM {
        let p = points[0];
        let found = format!("({}, {}, {})", p.x, p.y, p.z);
        return Err(error("the root at (0, 0, 0), the origin of the base frame", found));
    }
    match points.windows(2).position(|w| (w[1] - w[0]).norm() < 1e-9) {
        Some(index) => {
            Err(error("points that differ from their neighbours", format!("point {} twice", index + 1)))
        }
        None => Ok(()),
    }
}

fn moment_axes(section: &Section<'_>) -> Result<MomentAxes, InputError> {
    let mut moments = MomentAxes::default();
    if let Some(axes) = section.vectors("axes")? {
        let [first, second] = axes[..] else {
            return Err(section.error("axes", "two unit vectors", format!("{}", axes.len())));
        };
        moments.axes = [section.normalised("axes", first)?, section.normalised("axes", second)?];
        let cosine = moments.axes[0].dot(&moments.axes[1]);
        if cosine.abs() > 0.99 {
            return Err(section.error(
                "axes",
                "two different directions",
                format!("parallel ones (cosine {cosine:.4})"),
            ));
        }
    }
    if let Some(sign) = section.number("sign")? {
        if sign != 1.0 && sign != -1.0 {
            return Err(section.error("sign", "1 or -1", format!("{sign}")));
        }
        moments.sign = sign;
    }
    Ok(moments)
}

fn gratings(section: &Section<'_>) -> Result<FbgSpec, InputError> {
    let nominal_nm = section.numbers::<2>("nominal_nm")?;
    let (low, high) = WAVELENGTH_NM;
    if let Some(bad) = nominal_nm.iter().flatten().find(|w| !(low..=high).contains(*w)) {
        let expected = format!("wavelengths between {low} and {high} nm");
        return Err(section.error("nominal_nm", expected, format!("{bad}")).hint("check the unit"));
    }
    Ok(FbgSpec {
        nominal_nm,
        reference_nominal_nm: section.number_in("reference_nominal_nm", low, high)?,
        temperature_pm_per_degc: section.numbers::<2>("temperature_pm_per_degc")?,
        reference_temperature_pm_per_degc: section.number("reference_temperature_pm_per_degc")?,
        temperature_compensated: section.flag("temperature_compensated")?.unwrap_or(false),
    })
}

fn trajectories(
    root: &Section<'_>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<Vec<Trajectory>, InputError> {
    let mut out: Vec<Trajectory> = Vec::new();
    for section in root.sections("trajectory")? {
        let id = match section.number("id")? {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            Some(id) if id.fract() == 0.0 && (0.0..=4e9).contains(&id) => id as u32,
            Some(id) => return Err(section.error("id", "a whole number, zero or more", format!("{id}"))),
            None => return Err(section.error("id", "a whole number, zero or more", "nothing")),
        };
        if out.iter().any(|t| t.id == id) {
            return Err(section.error("id", "every trajectory once", format!("trajectory {id} again")));
        }
        let of =
            |key: &str, expected: &str| section.error(key, expected, format!("nothing (trajectory {id})"));
        out.push(Trajectory {
            id,
            origin_mm: section.vector("origin_mm")?.ok_or_else(|| of("origin_mm", "[x, y, z] in mm"))?,
            direction: section
                .unit_vector("direction")?
                .ok_or_else(|| of("direction", "a unit vector [x, y, z]"))?,
            nominal_arclength_mm: section.number_in("nominal_arclength_mm", 0.0, 2000.0)?,
        });
        warn_unknown(&section, warnings);
    }
    Ok(out)
}
