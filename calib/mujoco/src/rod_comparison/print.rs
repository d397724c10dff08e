//! The table of engines for a person.

use super::RodComparison;
use std::fmt::{Display, Formatter};

impl Display for RodComparison {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "{:>11} {:>8} {:>9} {:>24} {:>20} {:>7} {:>16} {:>10} {:>11} {:>8}",
            "speed mm/s",
            "samples",
            "elsewhere",
            "moment off, p50 p95 N mm",
            "RMS of the rod's RMS",
            "bias",
            "contact off mm",
            "ripple",
            "overlap mm",
            "chatter"
        )?;
        for r in &self.by_speed {
            let [from, to] = r.speed_mm_s;
            let speeds = if from == to { format!("{from:.1}") } else { format!("{from:.1}-{to:.1}") };
            if r.samples == 0 {
                writeln!(f, "{speeds:>11} {:>8}   (no sample that both engines kept)", 0)?;
                continue;
            }
            writeln!(
                f,
                "{speeds:>11} {:>8} {:>8.1}% {:>15.4} {:>8.4} {:>11.4} {:>8.4} {:>6.2}% {:>7.3} {:>8.3} {:>10.4} {:>11.3} {:>7.2}%",
                r.samples,
                r.elsewhere * 100.0,
                r.moment_nmm[0],
                r.moment_nmm[1],
                r.moment_rms_nmm[0],
                r.moment_rms_nmm[1],
                r.bias * 100.0,
                r.contact_mm[0],
                r.contact_mm[1],
                r.ripple_nmm,
                r.overlap_mm,
                r.chatter * 100.0
            )?;
        }
        let verdicts: Vec<String> = self.verdicts.iter().map(|(v, n)| format!("{v}: {n}")).collect();
        writeln!(
            f,
            "both kept {} of {}; verdicts by MuJoCo / rod: {}",
            self.kept[0],
            self.kept[1],
            verdicts.join(", ")
        )?;
        match self.bias_per_mm_s {
            Some([slope, sd]) => writeln!(
                f,
                "speed bias of the mean moment: {:.2} +- {:.2} % a mm/s (one standard deviation)",
                slope * 100.0,
                sd * 100.0
            ),
            None => writeln!(f, "speed bias of the mean moment: not known, the speeds are too few"),
        }
    }
}
