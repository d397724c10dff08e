//! Sweeps by MuJoCo against the same sweeps by the quasi-static rod, by the base's speed: what
//! inertia, damping, soft contacts and convex parts do to moments and contacts (SIMULATED).
//!
//! With moments m_i by MuJoCo and q_i by the rod where both touch at one place: RMS of |m_i - q_i|,
//! bias sum |m_i| / sum |q_i| - 1.

use crate::rod_engine::Run;
use crate::{SweepPlan, Verdict};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// Contacts farther apart than this are of different equilibria: the wire sprang in one engine and
/// not yet in the other, mm.
const ELSEWHERE_MM: f64 = 3.0;
/// Width of a bin of speeds, mm/s, and most bins.
const BIN_MM_S: f64 = 1.0;
const MAX_BINS: usize = 8;

/// Samples of both engines at speeds of one bin.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct SpeedRow {
    /// Speeds of the base, mm/s: from, to.
    pub speed_mm_s: [f64; 2],
    /// Samples at which both touch.
    pub samples: usize,
    /// Share of them whose contacts are so far apart that the wire is in another equilibrium; the
    /// following three leave them out.
    pub elsewhere: f64,
    /// RMS of the difference of the base moments, N mm, and the rod's own RMS.
    pub moment_rms_nmm: [f64; 2],
    /// Mean of |moment| by MuJoCo over that by the rod, less 1: the speed's bias where it grows
    /// with it.
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

/// What is summed over sweeps.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct ComparisonSum {
    /// By speed.
    bins: Vec<Bin>,
    /// Sweeps that both kept, of those run.
    kept: [usize; 2],
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
struct Bin {
    /// From, to, mm/s.
    speed_mm_s: [f64; 2],
    /// Samples of MuJoCo's.
    all: usize,
    /// Samples of MuJoCo's in which the contact opens and closes from step to step.
    chattering: usize,
    /// Samples at which both touch.
    both: usize,
    /// Samples whose contacts are of different equilibria.
    elsewhere: usize,
    /// Squares of the moments' difference, of the rod's moments, and of the contacts' distance.
    squares: [f64; 3],
    /// Sums of |moment|, by the rod and by MuJoCo.
    sizes: [f64; 2],
    /// Deepest overlap of the wire's skin with the mesh, mm.
    overlap_mm: f64,
}

impl ComparisonSum {
    /// Over bins of speed, mm/s: from, to.
    pub fn new(speeds: Vec<[f64; 2]>) -> Self {
        let bins = speeds
            .into_iter()
            .map(|speed_mm_s| Bin {
                speed_mm_s,
                ..Bin::default()
            })
            .collect();
        Self {
            bins,
            ..Self::default()
        }
    }

    /// Over a plan's speeds.
    pub fn over(plan: &SweepPlan) -> Self {
        let [low, high] = plan.speed_mm_s;
        let bins = (((high - low) / BIN_MM_S).ceil() as usize).clamp(1, MAX_BINS);
        let edge = |k: usize| low + (high - low) * k as f64 / bins as f64;
        Self::new((0..bins).map(|k| [edge(k), edge(k + 1)]).collect())
    }

    /// A sweep by MuJoCo and by the rod.
    pub fn add(&mut self, dynamic: &Run, quasi: &Run) {
        let count = dynamic.verdict == Verdict::Kept && quasi.verdict == Verdict::Kept;
        self.kept[0] += usize::from(count);
        self.kept[1] += 1;
        for (k, sample) in dynamic.samples.iter().enumerate() {
            let Some(bin) = self.bin(sample.speed_mm_s) else {
                continue;
            };
            let bin = &mut self.bins[bin];
            bin.all += 1;
            bin.chattering += usize::from(!sample.settled);
            bin.overlap_mm = sample
                .contacts
                .iter()
                .map(|c| -c.gap_mm)
                .fold(bin.overlap_mm, f64::max);
            let (Some(there), Some(rod)) = (
                sample.contacts.first(),
                quasi.samples.get(k).filter(|_| count),
            ) else {
                continue;
            };
            let Some(here) = rod.contacts.first() else {
                continue;
            };
            bin.both += 1;
            let apart = here.point_mm - there.point_mm;
            // Another equilibrium: one engine has let the wire spring, the other not yet.
            if apart.norm() > ELSEWHERE_MM {
                bin.elsewhere += 1;
                continue;
            }
            let (moment, by_rod) = (sample.moment_nmm, rod.moment_nmm);
            for (sum, add) in bin.squares.iter_mut().zip([moment - by_rod, by_rod, apart]) {
                *sum += add.norm_squared();
            }
            for (sum, add) in bin.sizes.iter_mut().zip([by_rod, moment]) {
                *sum += add.norm();
            }
        }
    }

    /// Takes in another sum over the same bins.
    pub fn merge(&mut self, other: &Self) {
        if self.bins.is_empty() {
            self.bins = other
                .bins
                .iter()
                .map(|b| Bin {
                    speed_mm_s: b.speed_mm_s,
                    ..Bin::default()
                })
                .collect();
        }
        (0..2).for_each(|k| self.kept[k] += other.kept[k]);
        for (own, more) in self.bins.iter_mut().zip(&other.bins) {
            own.all += more.all;
            own.chattering += more.chattering;
            own.both += more.both;
            own.elsewhere += more.elsewhere;
            (0..3).for_each(|k| own.squares[k] += more.squares[k]);
            (0..2).for_each(|k| own.sizes[k] += more.sizes[k]);
            own.overlap_mm = own.overlap_mm.max(more.overlap_mm);
        }
    }

    /// Bin of a speed; the last one has its upper edge in it.
    fn bin(&self, speed_mm_s: f64) -> Option<usize> {
        // The ends of the accelerations are rounded.
        let within = |b: &Bin| {
            speed_mm_s >= b.speed_mm_s[0] - 1e-9
                && speed_mm_s < b.speed_mm_s[1].max(b.speed_mm_s[0] + 1e-9)
        };
        let last = self
            .bins
            .last()
            .is_some_and(|b| (speed_mm_s - b.speed_mm_s[1]).abs() <= 1e-9);
        self.bins
            .iter()
            .position(within)
            .or_else(|| last.then(|| self.bins.len() - 1))
    }

    /// The table.
    pub fn table(&self) -> RodComparison {
        RodComparison {
            kept: self.kept,
            by_speed: self.bins.iter().map(Bin::row).collect(),
        }
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
        writeln!(
            f,
            "MuJoCo against the rod: both kept {} of {} sweeps",
            self.kept[0], self.kept[1]
        )?;
        let head = [
            "speed mm/s",
            "samples",
            "elsewhere",
            "moment off",
            "rod's RMS N mm",
            "bias",
            "contact off mm",
        ];
        writeln!(
            f,
            "{}   overlap mm   chatter",
            head.map(|h| format!("{h:>14}")).join(" ")
        )?;
        for r in &self.by_speed {
            let ([from, to], [off, own]) = (r.speed_mm_s, r.moment_rms_nmm);
            let (elsewhere, bias, chatter) =
                (r.elsewhere * 100.0, r.bias * 100.0, r.chatter * 100.0);
            let first = format!(
                "{:>14} {:>14} {elsewhere:>13.1}%",
                format!("{from:.1}-{to:.1}"),
                r.samples
            );
            let then = format!(
                "{off:>14.4} {own:>14.4} {bias:>13.2}% {:>14.3}",
                r.contact_rms_mm
            );
            writeln!(f, "{first} {then} {:>12.3} {chatter:>8.2}%", r.overlap_mm)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Sample;
    use crate::contact::Contact;
    use crate::sweep::Event;
    use nalgebra::Vector3;

    /// A run of samples with these moments at one speed, its contacts at a place.
    fn run(verdict: Verdict, speed_mm_s: f64, moments: &[f64], x_mm: f64) -> Run {
        let point_mm = Vector3::x() * x_mm;
        let contact = Contact {
            arclength_mm: x_mm,
            centre_mm: point_mm,
            point_mm,
            normal: Vector3::z(),
            force_n: 0.01,
            friction_n: Vector3::zeros(),
            gap_mm: -0.01,
        };
        let sample = |m: &f64| Sample {
            t_s: 0.0,
            travel_mm: 0.0,
            speed_mm_s,
            moment_nmm: Vector3::y() * *m,
            contacts: vec![contact],
            event: Event::None,
            settled: true,
        };
        Run {
            samples: moments.iter().map(sample).collect(),
            verdict,
            solves: 0,
            iterations: 0,
        }
    }

    #[test]
    fn a_bias_that_grows_with_the_speed_is_found() {
        let mut sum = ComparisonSum::new(vec![[3.0, 5.0], [5.0, 7.0]]);
        let quasi = [0.5, 1.0, 0.7];
        for k in 0..40 {
            let speed = 3.0 + f64::from(k) / 39.0 * 4.0;
            let own = quasi.map(|m| m * (1.0 + 0.02 * speed));
            sum.add(
                &run(Verdict::Kept, speed, &own, 30.1),
                &run(Verdict::Kept, speed, &quasi, 30.0),
            );
        }
        // A rejected sweep and another equilibrium leave the differences as they are.
        let strange = |verdict, x_mm| run(verdict, 6.0, &[9.0], x_mm);
        sum.add(
            &strange(Verdict::Kept, 30.1),
            &run(Verdict::Rejected("no-contact"), 6.0, &[1.0], 30.0),
        );
        sum.add(
            &strange(Verdict::Kept, 38.0),
            &run(Verdict::Kept, 6.0, &[1.0], 30.0),
        );
        let table = sum.table();
        assert_eq!(table.kept, [41, 42]);
        let [slow, fast] = &table.by_speed[..] else {
            panic!("{table:?}")
        };
        assert!(
            (slow.bias - 0.08).abs() < 0.002 && (fast.bias - 0.12).abs() < 0.002,
            "{slow:?} {fast:?}"
        );
        assert_eq!((slow.samples + fast.samples, slow.elsewhere), (121, 0.0));
        assert!(
            fast.elsewhere > 0.0 && (fast.contact_rms_mm - 0.1).abs() < 1e-9,
            "{fast:?}"
        );
        assert!(
            fast.moment_rms_nmm[0] < 0.13 * fast.moment_rms_nmm[1] && fast.overlap_mm == 0.01,
            "{fast:?}"
        );
        // Two halves are the whole.
        let mut twice = ComparisonSum::default();
        twice.merge(&sum);
        twice.merge(&sum);
        let doubled = twice.table();
        assert_eq!(
            (doubled.kept, doubled.by_speed[0].samples),
            ([82, 84], 2 * slow.samples)
        );
        assert!((doubled.by_speed[1].bias - fast.bias).abs() < 1e-12);
        // Negative control: the same moments have no bias.
        let mut sum = ComparisonSum::new(vec![[3.0, 7.0]]);
        sum.add(
            &run(Verdict::Kept, 4.0, &[1.0; 3], 30.0),
            &run(Verdict::Kept, 4.0, &[1.0; 3], 30.0),
        );
        assert_eq!(
            (
                sum.table().by_speed[0].bias,
                sum.table().by_speed[0].moment_rms_nmm[0]
            ),
            (0.0, 0.0)
        );
    }

    #[test]
    fn a_speed_falls_into_one_bin_of_a_plan() {
        let sum = ComparisonSum::over(&SweepPlan::default());
        assert_eq!(
            [2.9, 3.0, 3.99, 4.0, 7.0, 7.1].map(|v| sum.bin(v)),
            [None, Some(0), Some(0), Some(1), Some(3), None]
        );
    }
}
