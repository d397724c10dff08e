//! Sweeps by MuJoCo against the same sweeps by the quasi-static rod, by the base's speed: what inertia, damping, soft contacts and
//! convex parts do to moments and contacts (SIMULATED).
//!
//! With moments m_i by MuJoCo and q_i by the rod where both touch at one place: RMS of |m_i - q_i|, bias sum |m_i| / sum |q_i| - 1, ripple the
//! RMS of d_i - (d_(i-1) + d_i + d_(i+1)) / 3 with d = m - q; bias a mm/s is the slope of the sweeps' bias over their mean speed, weighted by
//! sum |q_i|.

use crate::convex::Convex;
use crate::mjcf::MjcfOptions;
use crate::{CableEngine, TwinError};
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use wcal_core::observation::WhiskerSpec;
use wcal_sim::rod_engine::{LINKS, Run};
use wcal_sim::{Mesh, RodEngine, Sample, Sweep, SweepPlan, Verdict};

/// Contacts farther apart than this are of different equilibria: the wire sprang in one engine and not yet in the other, mm.
const ELSEWHERE_MM: f64 = 3.0;

/// Samples of both engines at speeds of one bin.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SpeedRow {
    /// Speeds of the base, mm/s: from, to.
    pub speed_mm_s: [f64; 2],
    /// Samples at which both touch.
    pub samples: usize,
    /// Share of them whose contacts are so far apart that the wire is in another equilibrium; the following four leave them out.
    pub elsewhere: f64,
    /// RMS of the difference of the base moments, N mm, and the rod's own RMS.
    pub moment_rms_nmm: [f64; 2],
    /// Median and 95th percentile of the difference of the base moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Mean of |moment| by MuJoCo over that by the rod, less 1: the speed's bias where it grows with it.
    pub bias: f64,
    /// Median and 95th percentile of the distance between the contacts nearest to the base, mm.
    pub contact_mm: [f64; 2],
    /// RMS of the moments' difference from its own mean over three samples, N mm.
    pub ripple_nmm: f64,
    /// Deepest overlap of the wire's skin with the mesh, mm.
    pub overlap_mm: f64,
    /// Share of MuJoCo's samples that chatter.
    pub chatter: f64,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct RodComparison {
    /// Sweeps that both kept, of those run.
    pub kept: [usize; 2],
    /// How often which verdicts met: "by MuJoCo / by the rod".
    pub verdicts: BTreeMap<String, usize>,
    /// By the base's speed.
    pub by_speed: Vec<SpeedRow>,
    /// Change of the mean |moment| over the rod's with the sweep's speed, 1/(mm/s), and its standard deviation; none where the
    /// speeds are too few.
    pub bias_per_mm_s: Option<[f64; 2]>,
}

/// A place of the wire at a sample: moment (N mm) and contact nearest to the base (mm).
pub type State = (Vector3<f64>, Option<Vector3<f64>>);

/// A sample of MuJoCo's and what the rod has at its time.
#[derive(Debug, Clone, Copy)]
pub struct BothEngines {
    /// Speed of the base, mm/s.
    pub speed_mm_s: f64,
    /// Deepest overlap of the wire's skin with the mesh, mm.
    pub overlap_mm: f64,
    /// Whether the wire of MuJoCo came to rest.
    pub settled: bool,
    /// By MuJoCo.
    pub dynamic: State,
    /// By the rod.
    pub quasi: Option<State>,
}

/// The same sweeps at constant speeds by both engines, one row a speed.
///
/// # Errors
/// Where an engine cannot be started.
pub fn compare_speeds(
    whisker: &WhiskerSpec,
    options: &MjcfOptions,
    objects: &[(Mesh, Convex)],
    plan: &SweepPlan,
    speeds_mm_s: &[f64],
    sweeps: u64,
) -> Result<RodComparison, TwinError> {
    let rod = RodEngine::new(whisker, LINKS)?;
    let mut cable = CableEngine::start(whisker, options)?;
    let mut sum = ComparisonSum::new(speeds_mm_s.iter().map(|v| [*v; 2]).collect());
    for &speed in speeds_mm_s {
        let plan = SweepPlan { speed_mm_s: [speed; 2], acceleration_mm_s2: 0.0, ..plan.clone() };
        for (mesh, convex) in objects {
            let parts = convex.corners();
            for index in 0..sweeps {
                let Some(sweep) = Sweep::draw(mesh, &plan, 1, index, rod.reach_mm()) else { continue };
                let (quasi, dynamic) =
                    (rod.run(mesh, &sweep, &plan), cable.run(mesh, &parts, &sweep, &plan)?);
                let both: Vec<BothEngines> = paired(&quasi, &dynamic).collect();
                sum.add([dynamic.verdict.name(), quasi.verdict.name()], &both);
            }
        }
    }
    Ok(sum.table())
}

fn paired<'a>(quasi: &'a Run, dynamic: &'a Run) -> impl Iterator<Item = BothEngines> + 'a {
    let state = |s: &Sample| (s.moment_nmm, s.contacts.first().map(|c| c.point_mm));
    dynamic.samples.iter().enumerate().map(move |(k, s)| BothEngines {
        speed_mm_s: s.speed_mm_s,
        overlap_mm: s.contacts.iter().map(|c| -c.gap_mm).fold(0.0, f64::max),
        settled: s.settled,
        dynamic: state(s),
        quasi: quasi.samples.get(k).map(state),
    })
}

/// What is summed over sweeps.
#[derive(Debug, Default)]
pub struct ComparisonSum {
    bins: Vec<Bin>,
    verdicts: BTreeMap<String, usize>,
    kept: usize,
    run: usize,
    /// Mean speed (mm/s) and bias of each sweep, and the rod's sum of |moment|: its weight.
    sweeps: Vec<[f64; 3]>,
}

#[derive(Debug, Default)]
struct Bin {
    speed_mm_s: [f64; 2],
    all: usize,
    chattering: usize,
    both: usize,
    elsewhere: usize,
    squares: [f64; 2],
    sizes: [f64; 2],
    differences_nmm: Vec<f64>,
    ripples: Vec<f64>,
    contacts_mm: Vec<f64>,
    overlap_mm: f64,
}

impl ComparisonSum {
    /// Over bins of speed, mm/s: from, to.
    pub fn new(speeds: Vec<[f64; 2]>) -> Self {
        let bins = speeds.into_iter().map(|speed_mm_s| Bin { speed_mm_s, ..Bin::default() }).collect();
        Self { bins, ..Self::default() }
    }

    /// A sweep with its verdicts, by MuJoCo and by the rod.
    pub fn add(&mut self, [dynamic, quasi]: [&str; 2], samples: &[BothEngines]) {
        self.run += 1;
        *self.verdicts.entry(format!("{dynamic} / {quasi}")).or_default() += 1;
        let kept = Verdict::Kept.name();
        let count = dynamic == kept && quasi == kept;
        self.kept += usize::from(count);
        let mut differences: Vec<(usize, Vector3<f64>)> = Vec::new();
        let (mut speed, mut sizes) = (0.0, [0.0; 2]);
        for sample in samples {
            let Some(k) = self.bin(sample.speed_mm_s) else { continue };
            let bin = &mut self.bins[k];
            bin.all += 1;
            bin.chattering += usize::from(!sample.settled);
            bin.overlap_mm = bin.overlap_mm.max(sample.overlap_mm);
            let (moment, Some(there)) = sample.dynamic else { continue };
            let Some((by_rod, Some(here))) = sample.quasi.filter(|_| count) else { continue };
            bin.both += 1;
            let distance_mm = (here - there).norm();
            // Another equilibrium: one engine has let the wire spring, the other not yet.
            if distance_mm > ELSEWHERE_MM {
                bin.elsewhere += 1;
                continue;
            }
            let difference = moment - by_rod;
            differences.push((k, difference));
            bin.differences_nmm.push(difference.norm());
            bin.contacts_mm.push(distance_mm);
            for (sum, add) in bin.squares.iter_mut().zip([difference, by_rod]) {
                *sum += add.norm_squared();
            }
            for (n, size) in [by_rod.norm(), moment.norm()].into_iter().enumerate() {
                bin.sizes[n] += size;
                sizes[n] += size;
            }
            speed += sample.speed_mm_s;
        }
        for w in differences.windows(3) {
            let ripple = (w[1].1 - (w[0].1 + w[1].1 + w[2].1) / 3.0).norm_squared();
            self.bins[w[1].0].ripples.push(ripple);
        }
        if sizes[0] > 0.0 {
            self.sweeps.push([speed / differences.len() as f64, sizes[1] / sizes[0] - 1.0, sizes[0]]);
        }
    }

    /// Bin of a speed; the last one has its upper edge in it.
    fn bin(&self, speed_mm_s: f64) -> Option<usize> {
        // The ends of the accelerations are rounded.
        let within = |b: &Bin| {
            speed_mm_s >= b.speed_mm_s[0] - 1e-9 && speed_mm_s < b.speed_mm_s[1].max(b.speed_mm_s[0] + 1e-9)
        };
        let last = self.bins.last().is_some_and(|b| (speed_mm_s - b.speed_mm_s[1]).abs() <= 1e-9);
        self.bins.iter().position(within).or_else(|| last.then(|| self.bins.len() - 1))
    }

    /// The table.
    pub fn table(self) -> RodComparison {
        let bias_per_mm_s = slope(&self.sweeps);
        let by_speed = self.bins.into_iter().map(Bin::row).collect();
        RodComparison { kept: [self.kept, self.run], verdicts: self.verdicts, by_speed, bias_per_mm_s }
    }
}

impl Bin {
    fn row(mut self) -> SpeedRow {
        let mean = |sum: f64, n: usize| (sum / n.max(1) as f64).sqrt();
        let same = self.differences_nmm.len();
        SpeedRow {
            speed_mm_s: self.speed_mm_s,
            samples: self.both,
            elsewhere: self.elsewhere as f64 / self.both.max(1) as f64,
            moment_rms_nmm: self.squares.map(|sum| mean(sum, same)),
            moment_nmm: quantiles(&mut self.differences_nmm),
            bias: self.sizes[1] / self.sizes[0] - 1.0,
            contact_mm: quantiles(&mut self.contacts_mm),
            ripple_nmm: mean(self.ripples.iter().fold(0.0, |a, b| a + b), self.ripples.len()),
            overlap_mm: self.overlap_mm,
            chatter: self.chattering as f64 / self.all.max(1) as f64,
        }
    }
}

/// Median and 95th percentile.
fn quantiles(values: &mut [f64]) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| {
        values
            .get((share * values.len().saturating_sub(1) as f64).round() as usize)
            .copied()
            .unwrap_or(f64::NAN)
    };
    [at(0.5), at(0.95)]
}

/// Weighted slope of the second over the first, with its standard deviation from what is left over.
fn slope(rows: &[[f64; 3]]) -> Option<[f64; 2]> {
    let weight: f64 = rows.iter().map(|r| r[2]).sum();
    let mean = |k: usize| rows.iter().map(|r| r[k] * r[2]).sum::<f64>() / weight;
    let (x, y) = (mean(0), mean(1));
    let spread: f64 = rows.iter().map(|r| r[2] * (r[0] - x).powi(2)).sum();
    if rows.len() < 3 || !(spread > 1e-6 * weight) {
        return None;
    }
    let slope = rows.iter().map(|r| r[2] * (r[0] - x) * (r[1] - y)).sum::<f64>() / spread;
    // Of a weighted slope whose residuals differ from row to row (H. White, Econometrica 48, 1980).
    let left = |r: &[f64; 3]| (r[2] * (r[0] - x) * (r[1] - y - slope * (r[0] - x))).powi(2);
    let sd = rows.iter().map(left).sum::<f64>().sqrt() / spread;
    let few = rows.len() as f64 / (rows.len() as f64 - 2.0);
    Some([slope, sd * few.sqrt()])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both(speed_mm_s: f64, quasi_nmm: f64, dynamic_nmm: f64, apart_mm: f64) -> BothEngines {
        let state = |m: f64, x: f64| (Vector3::y() * m, Some(Vector3::x() * x));
        BothEngines {
            speed_mm_s,
            overlap_mm: 0.01,
            settled: true,
            dynamic: state(dynamic_nmm, 30.0 + apart_mm),
            quasi: Some(state(quasi_nmm, 30.0)),
        }
    }

    #[test]
    fn a_bias_that_grows_with_the_speed_is_found() {
        let mut sum = ComparisonSum::new(vec![[3.0, 5.0], [5.0, 7.0]]);
        for k in 0..40 {
            let speed = 3.0 + f64::from(k) / 39.0 * 4.0;
            let moments: Vec<BothEngines> =
                [0.5, 1.0, 0.7].iter().map(|m| both(speed, *m, m * (1.0 + 0.02 * speed), 0.1)).collect();
            sum.add(["kept", "kept"], &moments);
        }
        // A rejected sweep and another equilibrium leave the differences as they are.
        sum.add(["kept", "no-contact"], &[both(4.0, 1.0, 9.0, 0.1)]);
        sum.add(["kept", "kept"], &[both(6.0, 1.0, 9.0, 8.0)]);
        let table = sum.table();
        assert_eq!((table.kept, table.verdicts["kept / no-contact"]), ([41, 42], 1));
        let [slope, sd] = table.bias_per_mm_s.unwrap();
        assert!((slope - 0.02).abs() < 1e-9 && sd < 1e-9, "{slope} {sd}");
        let [slow, fast] = &table.by_speed[..] else { panic!("{table:?}") };
        assert!((slow.bias - 0.08).abs() < 0.002 && (fast.bias - 0.12).abs() < 0.002, "{slow:?} {fast:?}");
        assert_eq!((slow.samples + fast.samples, slow.elsewhere), (121, 0.0));
        assert!(fast.elsewhere > 0.0 && fast.contact_mm[1] < 0.11, "{fast:?}");
        // Negative control: the same moments have no bias; one speed has no slope.
        let mut sum = ComparisonSum::new(vec![[3.0, 7.0]]);
        sum.add(["kept", "kept"], &[both(4.0, 1.0, 1.0, 0.0); 3]);
        let table = sum.table();
        assert!(table.by_speed[0].bias == 0.0 && table.bias_per_mm_s.is_none(), "{table:?}");
    }

    #[test]
    fn a_speed_falls_into_one_bin() {
        let edges = [3.0, 4.0, 5.0, 6.0, 7.0];
        let sum = ComparisonSum::new(edges.windows(2).map(|w| [w[0], w[1]]).collect());
        assert_eq!(
            [2.9, 3.0, 3.99, 4.0, 7.0, 7.1].map(|v| sum.bin(v)),
            [None, Some(0), Some(0), Some(1), Some(3), None]
        );
    }
}
