//! Sweeps by MuJoCo against the same sweeps by the quasi-static rod, by the base's speed: what inertia, damping, soft contacts and
//! convex parts do to moments and contacts (SIMULATED).
//!
//! With moments m_i by MuJoCo and q_i by the rod where both touch at one place: RMS of |m_i - q_i|, bias sum |m_i| / sum |q_i| - 1.

use crate::Verdict;
use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::Serialize;
use std::fmt::{Display, Formatter};

/// Contacts farther apart than this are of different equilibria: the wire sprang in one engine and not yet in the other, mm.
const ELSEWHERE_MM: f64 = 3.0;

/// Samples of both engines at speeds of one bin.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SpeedRow {
    /// Speeds of the base, mm/s: from, to.
    pub speed_mm_s: [f64; 2],
    /// Samples at which both touch.
    pub samples: usize,
    /// Share of them whose contacts are so far apart that the wire is in another equilibrium; the following three leave them out.
    pub elsewhere: f64,
    /// RMS of the difference of the base moments, N mm, and the rod's own RMS.
    pub moment_rms_nmm: [f64; 2],
    /// Mean of |moment| by MuJoCo over that by the rod, less 1: the speed's bias where it grows with it.
    pub bias: f64,
    /// RMS of the distance between the contacts nearest to the base, mm.
    pub contact_rms_mm: f64,
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
    /// By the base's speed.
    pub by_speed: Vec<SpeedRow>,
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

/// What is summed over sweeps.
#[derive(Debug, Default)]
pub struct ComparisonSum {
    bins: Vec<Bin>,
    kept: [usize; 2],
}

#[derive(Debug, Default)]
struct Bin {
    speed_mm_s: [f64; 2],
    all: usize,
    chattering: usize,
    both: usize,
    elsewhere: usize,
    /// Squares of the moments' difference, of the rod's moments, and of the contacts' distance.
    squares: [f64; 3],
    /// Sums of |moment|, by the rod and by MuJoCo.
    sizes: [f64; 2],
    overlap_mm: f64,
}

impl ComparisonSum {
    /// Over bins of speed, mm/s: from, to.
    pub fn new(speeds: Vec<[f64; 2]>) -> Self {
        let bins = speeds.into_iter().map(|speed_mm_s| Bin { speed_mm_s, ..Bin::default() }).collect();
        Self { bins, ..Self::default() }
    }

    /// A sweep with its verdicts, by MuJoCo and by the rod.
    pub fn add(&mut self, verdicts: [&str; 2], samples: &[BothEngines]) {
        let count = verdicts == [Verdict::Kept.name(); 2];
        self.kept[0] += usize::from(count);
        self.kept[1] += 1;
        for sample in samples {
            let Some(k) = self.bin(sample.speed_mm_s) else { continue };
            let bin = &mut self.bins[k];
            bin.all += 1;
            bin.chattering += usize::from(!sample.settled);
            bin.overlap_mm = bin.overlap_mm.max(sample.overlap_mm);
            let (moment, Some(there)) = sample.dynamic else { continue };
            let Some((by_rod, Some(here))) = sample.quasi.filter(|_| count) else { continue };
            bin.both += 1;
            // Another equilibrium: one engine has let the wire spring, the other not yet.
            if (here - there).norm() > ELSEWHERE_MM {
                bin.elsewhere += 1;
                continue;
            }
            for (sum, add) in bin.squares.iter_mut().zip([moment - by_rod, by_rod, here - there]) {
                *sum += add.norm_squared();
            }
            for (sum, add) in bin.sizes.iter_mut().zip([by_rod, moment]) {
                *sum += add.norm();
            }
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
    pub fn table(&self) -> RodComparison {
        RodComparison { kept: self.kept, by_speed: self.bins.iter().map(Bin::row).collect() }
    }
}

impl Bin {
    fn row(&self) -> SpeedRow {
        let same = (self.both - self.elsewhere).max(1) as f64;
        let [off, own, contact] = self.squares.map(|sum| (sum / same).sqrt());
        SpeedRow {
            speed_mm_s: self.speed_mm_s,
            samples: self.both,
            elsewhere: self.elsewhere as f64 / self.both.max(1) as f64,
            moment_rms_nmm: [off, own],
            bias: self.sizes[1] / self.sizes[0] - 1.0,
            contact_rms_mm: contact,
            overlap_mm: self.overlap_mm,
            chatter: self.chattering as f64 / self.all.max(1) as f64,
        }
    }
}

impl Display for RodComparison {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "MuJoCo against the rod: both kept {} of {} sweeps", self.kept[0], self.kept[1])?;
        let head =
            ["speed mm/s", "samples", "elsewhere", "moment off", "rod's RMS N mm", "bias", "contact off mm"];
        writeln!(f, "{}   overlap mm   chatter", head.map(|h| format!("{h:>14}")).join(" "))?;
        for r in &self.by_speed {
            let ([from, to], [off, own]) = (r.speed_mm_s, r.moment_rms_nmm);
            let (elsewhere, bias, chatter) = (r.elsewhere * 100.0, r.bias * 100.0, r.chatter * 100.0);
            let first = format!("{:>14} {:>14} {elsewhere:>13.1}%", format!("{from:.1}-{to:.1}"), r.samples);
            let then = format!("{off:>14.4} {own:>14.4} {bias:>13.2}% {:>14.3}", r.contact_rms_mm);
            writeln!(f, "{first} {then} {:>12.3} {chatter:>8.2}%", r.overlap_mm)?;
        }
        Ok(())
    }
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
        assert_eq!(table.kept, [41, 42]);
        let [slow, fast] = &table.by_speed[..] else { panic!("{table:?}") };
        assert!((slow.bias - 0.08).abs() < 0.002 && (fast.bias - 0.12).abs() < 0.002, "{slow:?} {fast:?}");
        assert_eq!((slow.samples + fast.samples, slow.elsewhere), (121, 0.0));
        assert!(fast.elsewhere > 0.0 && (fast.contact_rms_mm - 0.1).abs() < 1e-9, "{fast:?}");
        assert!(fast.moment_rms_nmm[0] < 0.13 * fast.moment_rms_nmm[1], "{fast:?}");
        // Negative control: the same moments have no bias.
        let mut sum = ComparisonSum::new(vec![[3.0, 7.0]]);
        sum.add(["kept", "kept"], &[both(4.0, 1.0, 1.0, 0.0); 3]);
        assert_eq!((sum.table().by_speed[0].bias, sum.table().by_speed[0].moment_rms_nmm[0]), (0.0, 0.0));
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
