//! Labelled series: the moments of a simulated sweep, sample by sample, with the contact that
//! caused it. All of them are SIMULATED.

use crate::LabError;
use crate::dataset::read;
use crate::tare::Tare;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_mesh::Mesh;

/// The contact nearest to the base; where several count as one (`count_contacts`), their mean
/// weighted by the forces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Point of the object, base frame, mm.
    pub point_mm: Vector3<f64>,
    /// Arc length from the root, mm.
    pub arclength_mm: f64,
}

/// One sample of a series.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSample {
    /// Time, s.
    pub t_s: f64,
    /// Travel of the base along +z, mm, and its speed, mm/s.
    pub travel_mm: f64,
    /// See `travel_mm`.
    pub speed_mm_s: f64,
    /// Transverse moments (y, z) at the root, N mm.
    pub moment_nmm: [f64; 2],
    /// Contact nearest to the base.
    pub contact: Option<Contact>,
    /// Number of separate contacts (`count_contacts`).
    pub contacts: usize,
    /// Whether the simulated wire came to rest.
    pub settled: bool,
    /// none, onset, release, jump or slip.
    pub event: String,
}

/// A sweep over an object.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepSeries {
    /// Object.
    pub object: String,
    /// Number of the sweep over it.
    pub sweep: u64,
    /// Object to base frame at the start; with time it moves along -z by `travel_mm`.
    pub base_from_object: nalgebra::Isometry3<f64>,
    /// Samples in order of time.
    pub samples: Vec<SweepSample>,
}

/// Contacts nearer to each other along the wire than this are one, mm: they lie on facets of one
/// smooth body, whose edges are as long (the YCB scans': median 1.7 mm, 19 of 20 up to 3.2 mm).
const MIN_SEPARATION_MM: f64 = 3.0;

/// How many contacts there are, from their arc lengths in rising order, mm.
pub(crate) fn count_contacts(arclengths_mm: impl Iterator<Item = f64>) -> usize {
    let mut last = None;
    arclengths_mm.fold(0, |count, mm| {
        let new = last.is_none_or(|last| mm - last >= MIN_SEPARATION_MM);
        last = if new { Some(mm) } else { last };
        count + usize::from(new)
    })
}

/// Where the force of the first contact acts, of touched points in rising order along the wire with
/// their forces, N.
pub(crate) fn nearest_contact(touched: &[(Contact, f64)]) -> Option<Contact> {
    let begins_mm = touched.first()?.0.arclength_mm;
    let one = || {
        touched
            .iter()
            .take_while(|(c, _)| c.arclength_mm - begins_mm < MIN_SEPARATION_MM)
    };
    let carried: f64 = one().map(|(_, force_n)| force_n).sum();
    if !(carried > 0.0) {
        return Some(touched[0].0);
    }
    Some(Contact {
        point_mm: one()
            .map(|(c, force_n)| c.point_mm * (force_n / carried))
            .sum(),
        arclength_mm: one()
            .map(|(c, force_n)| c.arclength_mm * (force_n / carried))
            .sum(),
    })
}

/// Estimates farther than this from the object have no nearest point, mm.
const MAX_DISTANCE_MM: f64 = 1e4;
/// Time at the start, without contact, that sets the zero (`wcal track --tare-s`), s.
const TARE_S: f64 = 0.5;

impl SweepSeries {
    /// With the zero of the free wire at the start: its own weight is no push. What begins in
    /// contact stays as it is.
    pub(crate) fn tared(mut self) -> Self {
        let free = self
            .samples
            .iter()
            .take_while(|i| i.contact.is_none())
            .count();
        let mut tare = Tare::new(TARE_S);
        let mut zero_nmm = [0.0; 2];
        for i in &self.samples[..free] {
            let zeroed = tare.zeroed(i.t_s, i.moment_nmm);
            zero_nmm = [0, 1].map(|k| i.moment_nmm[k] - zeroed[k]);
        }
        for i in &mut self.samples {
            i.moment_nmm = [0, 1].map(|k| i.moment_nmm[k] - zero_nmm[k]);
        }
        self
    }

    /// Distance of a point (base frame, mm) to the object's surface after a travel of the base, mm.
    pub fn surface_distance_mm(&self, mesh: &Mesh, travel_mm: f64, point_mm: &Vector3<f64>) -> f64 {
        mesh.closest_point(&self.to_object_frame(travel_mm, point_mm), MAX_DISTANCE_MM)
            .map_or(MAX_DISTANCE_MM, |n| n.distance_mm.abs())
    }

    /// The surface's point nearest to a point (base frame, mm) after a travel of the base, mm; the
    /// point itself beyond that distance.
    pub fn closest_surface_point(
        &self,
        mesh: &Mesh,
        travel_mm: f64,
        point_mm: &Vector3<f64>,
    ) -> Vector3<f64> {
        mesh.closest_point(&self.to_object_frame(travel_mm, point_mm), MAX_DISTANCE_MM)
            .map_or(*point_mm, |n| {
                self.base_from_object
                    .transform_point(&n.point_mm.into())
                    .coords
                    - Vector3::z() * travel_mm
            })
    }

    /// A point of the base frame after a travel of the base, mm, in the object's.
    fn to_object_frame(&self, travel_mm: f64, point_mm: &Vector3<f64>) -> Vector3<f64> {
        let at_start = nalgebra::Point3::from(point_mm + Vector3::z() * travel_mm);
        self.base_from_object
            .inverse_transform_point(&at_start)
            .coords
    }
}

/// Kept series of a dataset's folder, by object; `objects` narrows them down to these where it is
/// not empty.
///
/// # Errors
/// Names the shard that is damaged or holds what is not a number.
pub fn read_sweep_series(
    folder: &Path,
    objects: &[String],
) -> Result<BTreeMap<String, Vec<SweepSeries>>, LabError> {
    let mut all: BTreeMap<String, Vec<SweepSeries>> = BTreeMap::new();
    for (name, manifest) in read::manifests(folder)? {
        if objects.is_empty() || objects.contains(&manifest.object) {
            let all_series = read_shard(folder, &name, &manifest.object)?;
            all.entry(manifest.object).or_default().extend(all_series);
        }
    }
    if all.is_empty() {
        return Err(LabError::value(
            folder.display().to_string(),
            "shards of `wcal-lab simulate`",
            "none",
        ));
    }
    all.values_mut()
        .for_each(|all_series| all_series.sort_by_key(|c| c.sweep));
    Ok(all)
}

fn read_shard(folder: &Path, name: &str, object: &str) -> Result<Vec<SweepSeries>, LabError> {
    let sweeps = read::table(&folder.join(format!("{name}.sweeps.parquet")))?;
    let samples = read::table(&folder.join(format!("{name}.samples.parquet")))?;
    let pose: Vec<&[Option<f64>]> = ["qw", "qx", "qy", "qz", "x_mm", "y_mm", "z_mm"]
        .iter()
        .map(|k| sweeps.maybe(&format!("base_from_object_{k}")))
        .collect::<Result<_, _>>()?;
    let mut all_series: BTreeMap<i64, SweepSeries> = BTreeMap::new();
    for (row, (sweep, kept)) in sweeps
        .whole("sweep")?
        .iter()
        .zip(sweeps.whole("kept")?)
        .enumerate()
    {
        let pose: Option<Vec<f64>> = pose.iter().map(|c| c[row]).collect();
        if let (1, Some(p)) = (kept, pose) {
            let turn = UnitQuaternion::new_normalize(Quaternion::new(p[0], p[1], p[2], p[3]));
            let base_from_object =
                nalgebra::Isometry3::from_parts(Translation3::new(p[4], p[5], p[6]), turn);
            let series = SweepSeries {
                object: object.to_owned(),
                sweep: *sweep as u64,
                base_from_object,
                samples: vec![],
            };
            all_series.insert(*sweep, series);
        }
    }
    let number = samples.whole("sweep")?;
    let (t, travel, speed) = (
        samples.real("t_s")?,
        samples.real("travel_mm")?,
        samples.real("speed_mm_s")?,
    );
    let (my, mz) = (samples.real("moment_y_nmm")?, samples.real("moment_z_nmm")?);
    let (settled, event) = (samples.whole("settled")?, samples.text("event")?);
    let mut touched: BTreeMap<(i64, i64), Vec<(Contact, f64)>> = BTreeMap::new();
    if samples.whole("contacts")?.iter().any(|n| *n > 0) {
        let contacts = read::table(&folder.join(format!("{name}.contacts.parquet")))?;
        let [x, y, z, along, force_n] =
            ["x_mm", "y_mm", "z_mm", "arclength_mm", "force_n"].map(|k| contacts.real(k));
        let (x, y, z, along, force_n) = (x?, y?, z?, along?, force_n?);
        let at = contacts
            .whole("sweep")?
            .iter()
            .zip(contacts.whole("sample")?);
        for (row, (sweep, sample)) in at.enumerate() {
            let point_mm = Vector3::new(x[row], y[row], z[row]);
            let contact = Contact {
                point_mm,
                arclength_mm: along[row],
            };
            touched
                .entry((*sweep, *sample))
                .or_default()
                .push((contact, force_n[row]));
        }
        for of in touched.values_mut() {
            of.sort_by(|a, b| a.0.arclength_mm.total_cmp(&b.0.arclength_mm));
        }
    }
    let sample = samples.whole("sample")?;
    for (row, number) in number.iter().enumerate() {
        let Some(series) = all_series.get_mut(number) else {
            continue;
        };
        let touched = touched
            .get(&(*number, sample[row]))
            .map_or(&[][..], Vec::as_slice);
        series.samples.push(SweepSample {
            t_s: t[row],
            travel_mm: travel[row],
            speed_mm_s: speed[row],
            moment_nmm: [my[row], mz[row]],
            contact: nearest_contact(touched),
            contacts: count_contacts(touched.iter().map(|(c, _)| c.arclength_mm)),
            settled: settled[row] == 1,
            event: event[row].clone(),
        });
    }
    Ok(all_series.into_values().map(SweepSeries::tared).collect())
}

#[cfg(test)]
mod tests {
    use super::{Contact, count_contacts, nearest_contact};
    use nalgebra::Vector3;

    #[test]
    fn contacts_on_neighbouring_facets_are_one() {
        let count = |mm: &[f64]| count_contacts(mm.iter().copied());
        assert_eq!(count(&[]), 0);
        assert_eq!(count(&[31.0, 31.0, 31.02, 33.9]), 1);
        // Negative control: what is farther away is another one, also at the end of a row of near
        // ones.
        assert_eq!(count(&[31.0, 34.0]), 2);
        assert_eq!(count(&[31.0, 33.0, 35.0, 37.5]), 2);
    }

    #[test]
    fn touched_points_that_are_one_contact_are_where_their_forces_act() {
        let at = |mm: f64, force_n: f64| {
            (
                Contact {
                    point_mm: Vector3::new(mm, 0.0, 2.0 * mm),
                    arclength_mm: mm,
                },
                force_n,
            )
        };
        assert_eq!(nearest_contact(&[]), None);
        assert_eq!(nearest_contact(&[at(31.0, 0.2)]), Some(at(31.0, 0.0).0));
        let mean = nearest_contact(&[at(31.0, 0.3), at(32.0, 0.1), at(36.0, 4.0)]).unwrap();
        // What is farther away does not count, however hard it presses.
        assert!((mean.arclength_mm - 31.25).abs() < 1e-12, "{mean:?}");
        assert!(
            (mean.point_mm - Vector3::new(31.25, 0.0, 62.5)).norm() < 1e-12,
            "{mean:?}"
        );
    }
}
