//! How often the 95 % regions of tracked contacts hold the true one, by how the contact moves and
//! what is stated of wire and friction. SIMULATED.
//!
//! ```text
//! in space          d' C^-1 d <= 7.815     d: stated place less the true one of the wire's axis, C: stated covariance
//! along the wire    the true arc length lies in one of the row's regions
//! ```
//!
//! Rows of a record share their errors: the interval of a share, which counts rows, is too narrow.

use crate::statements::{Auditor, Counted, Labelled, StatementRow, in_ellipsoid, tallied};
use anyhow::Context;
use nalgebra::{Matrix3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;
use wcal_plant::sweep::{SweepCase, SweepKind, SweepReading};

/// A friction that is stated as it is drawn.
const STATED: ([f64; 2], bool) = ([0.15, 0.05], true);

/// How a contact moves, and what is stated to `track`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackRegime {
    /// Name.
    pub name: &'static str,
    /// What is drawn.
    pub kind: SweepKind,
    /// Relative standard deviation of the diameter that is stated.
    pub diameter_sd: Option<f64>,
    /// Mean and standard deviation from which the friction is drawn, and whether they are stated;
    /// else it is that of the sweep, 0 to 0.3.
    pub friction: Option<([f64; 2], bool)>,
}

/// Regimes that are drawn.
pub const TRACK_REGIMES: [TrackRegime; 9] = {
    const fn plain(name: &'static str, kind: SweepKind) -> TrackRegime {
        TrackRegime {
            name,
            kind,
            diameter_sd: None,
            friction: None,
        }
    }
    [
        plain("one way", SweepKind::OneWay),
        plain("there and back", SweepKind::ThereAndBack),
        TrackRegime {
            friction: Some(([0.0, 0.0], false)),
            ..plain("there and back, no friction", SweepKind::ThereAndBack)
        },
        TrackRegime {
            friction: Some(STATED),
            ..plain("one way, friction stated", SweepKind::OneWay)
        },
        TrackRegime {
            friction: Some(STATED),
            ..plain("there and back, friction stated", SweepKind::ThereAndBack)
        },
        plain("small ellipse", SweepKind::SmallEllipse),
        plain("needle", SweepKind::Needle),
        plain("wire 1 % off, not stated", SweepKind::OtherWire),
        TrackRegime {
            diameter_sd: Some(0.01),
            ..plain("wire 1 % off, stated", SweepKind::OtherWire)
        },
    ]
};

impl TrackRegime {
    /// The sweep of a seed; none where no draw is one.
    fn drawn(&self, seed: u64) -> Option<SweepCase> {
        let case = SweepCase::draw_kind(seed, self.kind).ok()?;
        let Some(([mean, sd], _)) = self.friction else {
            return Some(case);
        };
        let normal: f64 = StandardNormal.sample(&mut ChaCha8Rng::seed_from_u64(!seed));
        case.under_friction((mean + sd * normal).max(0.0))
    }

    /// Whether the wire is what the rows say that they assume.
    fn as_assumed(&self) -> bool {
        self.kind != SweepKind::OtherWire || self.diameter_sd.is_some()
    }

    /// What is stated to `track`.
    fn arguments(&self) -> Vec<OsString> {
        let diameter = self
            .diameter_sd
            .map(|sd| ["--diameter-sd".into(), sd.to_string().into()]);
        let friction = self
            .friction
            .filter(|f| f.1)
            .map(|([mean, sd], _)| ["--friction".into(), format!("{mean} +- {sd}").into()]);
        diameter.into_iter().chain(friction).flatten().collect()
    }
}

impl Auditor {
    /// Draws so many benches, verifies each, and tracks a record of each regime with its
    /// calibration.
    ///
    /// # Errors
    /// Where a record cannot be written or the program cannot be started.
    pub fn audit_tracks(
        &self,
        regimes: &[TrackRegime],
        benches: usize,
        seed: u64,
    ) -> anyhow::Result<Vec<StatementRow>> {
        let seeds: Vec<u64> = (0..benches as u64)
            .map(|k| seed.wrapping_mul(1_000_003).wrapping_add(k))
            .collect();
        let label = |c| (c, "white", [benches, 0]);
        let counted = self.each(&seeds, |seed| -> anyhow::Result<Vec<Labelled>> {
            Ok(self
                .tracked(*seed, regimes)?
                .into_iter()
                .map(label)
                .collect())
        })?;
        Ok(tallied(counted))
    }

    fn tracked(&self, seed: u64, regimes: &[TrackRegime]) -> anyhow::Result<Vec<Counted>> {
        let folder = self.folder.join(format!("sweeps-{seed}"));
        let drawn: Vec<(&TrackRegime, SweepCase)> = regimes
            .iter()
            .filter_map(|r| Some((r, r.drawn(seed)?)))
            .collect();
        let Some((_, first)) = drawn.first() else {
            return Ok(Vec::new());
        };
        let (session, verified) = (folder.join("session"), folder.join("verify"));
        first.session()?.write(&session)?;
        self.run(&[
            "verify".as_ref(),
            session.as_ref(),
            "--out".as_ref(),
            verified.as_ref(),
            "--force".as_ref(),
        ])?;
        let calibration = verified.join("calibration.json");
        let mut counted = Vec::new();
        // Without a calibration nothing is stated.
        for (regime, case) in drawn.iter().filter(|_| calibration.exists()) {
            let place = folder.join(regime.name.replace(' ', "-"));
            std::fs::create_dir_all(&place)?;
            case.write_record(&place)?;
            let (readings, base, out) = (
                place.join("readings.csv"),
                place.join("base.csv"),
                place.join("track.csv"),
            );
            let mut arguments: Vec<OsString> = vec!["track".into(), readings.into()];
            arguments.extend([
                "--motion".into(),
                base.into(),
                "--calibration".into(),
                calibration.clone().into(),
            ]);
            arguments.extend(["--out".into(), out.clone().into(), "--force".into()]);
            arguments.extend(regime.arguments());
            self.run(
                &arguments
                    .iter()
                    .map(OsString::as_os_str)
                    .collect::<Vec<_>>(),
            )?;
            counted.extend(self.counted(regime, case, &out)?);
        }
        Ok(counted)
    }

    /// Rows in contact whose contact is located.
    fn counted(
        &self,
        regime: &TrackRegime,
        case: &SweepCase,
        out: &Path,
    ) -> anyhow::Result<Vec<Counted>> {
        let mut reader =
            csv::Reader::from_path(out).with_context(|| format!("reading {}", out.display()))?;
        let mut counted = Vec::new();
        for (record, reading) in reader
            .deserialize::<BTreeMap<String, String>>()
            .zip(&case.readings)
        {
            let Some(Held { in_space, along }) = self.held(&record?, reading) else {
                continue;
            };
            for (what, held) in [
                ("contact in its ellipsoid", in_space.0),
                ("arc length in its regions", along),
            ] {
                let mut count = |rows: &str| {
                    let statement = format!("track, {}: {what}, {rows}", regime.name);
                    let counts = Counted::new(statement, 0.95, held);
                    counted.push(if regime.as_assumed() {
                        counts
                    } else {
                        counts.unsaid()
                    });
                };
                count("all rows");
                if in_space.1 {
                    count("rows `ok`");
                }
            }
        }
        Ok(counted)
    }

    /// Whether the regions of a row hold the contact; none where the wire is free or nothing is
    /// located.
    fn held(&self, row: &BTreeMap<String, String>, reading: &SweepReading) -> Option<Held> {
        let (touch, number) = (reading.touch.as_ref()?, |name: &str| {
            row.get(name)?.parse::<f64>().ok()
        });
        let [x, y, z] = ["contact_x_mm", "contact_y_mm", "contact_z_mm"].map(number);
        let off = Vector3::new(x?, y?, z?) - touch.axis_mm;
        let names = [
            "var_xx_mm2",
            "var_yy_mm2",
            "var_zz_mm2",
            "cov_xy_mm2",
            "cov_xz_mm2",
            "cov_yz_mm2",
        ];
        let [xx, yy, zz, xy, xz, yz] = names.map(number);
        let (xy, xz, yz) = (xy?, xz?, yz?);
        let covariance = Matrix3::new(xx?, xy, xz, xy, yy?, yz, xz, yz, zz?) * self.widened.powi(2);
        let inside = in_ellipsoid(&off, covariance);
        let region = |text: &str| {
            let (span, _) = text.split_once('@')?;
            let (from, to) = span.split_once('-')?;
            let (from, to) = (from.parse::<f64>().ok()?, to.parse::<f64>().ok()?);
            let (middle, half) = (0.5 * (from + to), 0.5 * (to - from) * self.widened);
            // Ends are printed to 0.01 mm.
            Some((touch.arclength_mm - middle).abs() <= half + 0.005)
        };
        let along = row
            .get("arclength_regions95")?
            .split('|')
            .filter_map(region)
            .any(|held| held);
        let ok = row.get("status").is_some_and(|status| status == "ok");
        Some(Held {
            in_space: (inside, ok),
            along,
        })
    }
}

/// Whether the regions of a row hold the contact, in space (and whether the row is `ok`) and along
/// the wire.
struct Held {
    in_space: (bool, bool),
    along: bool,
}
