//! Base moments along each trajectory from the rod, tabulated; friction as a play between two slip branches.

use nalgebra::Vector3;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_rod::{Guess, Line, Outcome, Rod, Softening, Tangential};

/// Mechanical deviations from the nominal whisker and bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanics {
    /// Constant offset of the groove, mm.
    pub offset_mm: [f64; 3],
    /// Root compliance about base y and z, rad/(N mm).
    pub compliance_rad_per_nmm: [f64; 2],
    /// Softening of the wire.
    pub softening: Option<Softening>,
    /// Relative change of EI from root to tip.
    pub taper: f64,
    /// Share of the wire's weight that acts (0 undeclared, 1 full).
    pub weight: f64,
    /// Friction coefficient along the wire; independent of the tables.
    pub friction: f64,
    /// Friction while the groove moves over friction at rest.
    pub moving_share: f64,
}

impl Default for Mechanics {
    fn default() -> Self {
        Self {
            offset_mm: [0.0; 3],
            compliance_rad_per_nmm: [0.0; 2],
            softening: None,
            taper: 0.0,
            weight: 0.0,
            friction: 0.0,
            moving_share: 1.0,
        }
    }
}

impl Mechanics {
    fn key(&self) -> Vec<u64> {
        let mut key: Vec<u64> = self.offset_mm.iter().map(|v| v.to_bits()).collect();
        key.extend(self.compliance_rad_per_nmm.iter().map(|v| v.to_bits()));
        match self.softening {
            None => key.push(0),
            Some(Softening::Bilinear { onset_per_m, ratio }) => {
                key.extend([1, onset_per_m.to_bits(), ratio.to_bits()]);
            }
            Some(Softening::Section { onset_per_m, hardening }) => {
                key.extend([2, onset_per_m.to_bits(), hardening.to_bits()]);
            }
        }
        key.extend([self.taper.to_bits(), self.weight.to_bits()]);
        key
    }
}

/// Values on a uniform grid of stage position.
#[derive(Debug, Clone, PartialEq)]
pub struct LineTable {
    /// First touch, mm; the moment is zero before it.
    pub touch_mm: f64,
    /// Grid spacing, mm.
    pub step_mm: f64,
    /// Moment components, N mm.
    pub moments_nmm: Vec<[f64; 2]>,
    /// Contact arc length, mm.
    pub arclength_mm: Vec<f64>,
    /// Last stage position of the branch, mm; beyond it the model has no answer.
    pub end_mm: f64,
}

/// Four-point Lagrange weights for position `f` in [-1, 2] relative to the second of four nodes.
fn lagrange(f: f64) -> [f64; 4] {
    [
        -f * (f - 1.0) * (f - 2.0) / 6.0,
        (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0,
        -(f + 1.0) * f * (f - 2.0) / 2.0,
        (f + 1.0) * f * (f - 1.0) / 6.0,
    ]
}

fn bracket(x: f64, len: usize) -> (usize, [f64; 4]) {
    let j = (x.floor().max(0.0) as usize).clamp(1, len.saturating_sub(3).max(1));
    (j - 1, lagrange(x - j as f64))
}

impl LineTable {
    /// Moment components at stage position `x_mm`, N mm; none past the end of the branch.
    #[must_use]
    pub fn moment(&self, x_mm: f64) -> Option<[f64; 2]> {
        if x_mm <= self.touch_mm {
            return Some([0.0; 2]);
        }
        if x_mm > self.end_mm + 1e-9 {
            return None;
        }
        let (j, w) = bracket((x_mm - self.touch_mm) / self.step_mm, self.moments_nmm.len());
        let mut m = [0.0; 2];
        for (k, weight) in w.iter().enumerate() {
            for (c, component) in m.iter_mut().enumerate() {
                *component += weight * self.moments_nmm[j + k][c];
            }
        }
        Some(m)
    }

    /// Contact arc length at stage position `x_mm`, mm.
    #[must_use]
    pub fn arclength(&self, x_mm: f64) -> f64 {
        let x = x_mm.clamp(self.touch_mm, self.end_mm);
        let (j, w) = bracket((x - self.touch_mm) / self.step_mm, self.arclength_mm.len());
        (0..4).map(|k| w[k] * self.arclength_mm[j + k]).sum()
    }
}

/// Slip branches of one line: tables over (stage position, tangential over normal force).
#[derive(Debug, Clone, PartialEq)]
pub struct SlipTable {
    touch_mm: f64,
    step_mm: f64,
    /// Ratios, ascending, symmetric about 0.
    ratios: Vec<f64>,
    /// Arc length, mm: grid position x ratio.
    arclength_mm: Vec<Vec<f64>>,
    /// Moments, N mm: grid position x ratio.
    moments_nmm: Vec<Vec<[f64; 2]>>,
}

/// Friction coefficients up to 0.4, raised by 1/sin(45 deg) for the two walls of the groove, with room to fit.
const LARGEST_RATIO: f64 = 0.72;
const RATIO_STEPS: usize = 4;

impl SlipTable {
    fn at<T>(&self, x_mm: f64, pick: impl Fn(usize, usize) -> T, ratio: f64, zero: T) -> T
    where
        T: std::ops::Add<Output = T> + std::ops::Mul<f64, Output = T> + Copy,
    {
        let x = (x_mm - self.touch_mm).max(0.0) / self.step_mm;
        let (j, w) = bracket(x, self.moments_nmm.len());
        let dr = self.ratios[1] - self.ratios[0];
        let (k, v) = bracket((ratio - self.ratios[0]) / dr, self.ratios.len());
        let mut sum = zero;
        for (a, wa) in w.iter().enumerate() {
            for (b, vb) in v.iter().enumerate() {
                sum = sum + pick(j + a, k + b) * (wa * vb);
            }
        }
        sum
    }

    fn arclength(&self, x_mm: f64, ratio: f64) -> f64 {
        self.at(x_mm, |i, k| self.arclength_mm[i][k], ratio, 0.0)
    }

    fn moment(&self, x_mm: f64, ratio: f64) -> [f64; 2] {
        [0, 1].map(|c| self.at(x_mm, |i, k| self.moments_nmm[i][k][c], ratio, 0.0))
    }

    /// Ratio at which the contact sits at `s_mm`, by bisection inside +-`limit`; arc length is monotone in the ratio.
    fn ratio_at(&self, x_mm: f64, s_mm: f64, limit: f64) -> f64 {
        let rising = self.arclength(x_mm, limit) >= self.arclength(x_mm, -limit);
        let (mut lo, mut hi) = (-limit, limit);
        for _ in 0..40 {
            let mid = 0.5 * (lo + hi);
            if (self.arclength(x_mm, mid) < s_mm) == rising { lo = mid } else { hi = mid }
        }
        0.5 * (lo + hi)
    }

    /// One move of the groove to `x_mm`: the contact sticks until the cone's edge, then slips along it.
    fn advance(&self, x_mm: f64, friction: f64, contact_mm: &mut f64) {
        let (a, b) = (self.arclength(x_mm, -friction), self.arclength(x_mm, friction));
        *contact_mm = contact_mm.clamp(a.min(b), a.max(b));
    }
}

type Key = Vec<u64>;

/// The rod's answers along the lines of one session, kept by mechanical parameters.
pub struct Bench {
    spec: WhiskerSpec,
    fluid_kg_m3: f64,
    lines: Vec<Line>,
    start_mm: Vec<f64>,
    reach_mm: Vec<f64>,
    axes: MomentAxes,
    step_mm: f64,
    tables: Mutex<HashMap<Key, Arc<Vec<LineTable>>>>,
    slips: Mutex<HashMap<Key, Arc<Vec<Option<SlipTable>>>>>,
}

/// Grid of the tables, mm: interpolation is right to 1e-4 of the moment there (tests).
const GRID_MM: f64 = 0.8;
/// Room past the last reading for effects that shift the stage, mm.
const MARGIN_MM: f64 = 0.6;

impl Bench {
    /// Bench of a whisker and the lines that its readings use.
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(
        spec: &WhiskerSpec,
        fluid_kg_m3: f64,
        path: &crate::path::WhiskerPath,
    ) -> Result<Self, wcal_rod::RodError> {
        Rod::new(spec, wcal_rod::WORKING_STEP_MM)?;
        Ok(Self {
            spec: spec.clone(),
            fluid_kg_m3,
            lines: path.lines.clone(),
            start_mm: path.start_mm.clone(),
            reach_mm: path.reach_mm.clone(),
            axes: path.moments.clone(),
            step_mm: wcal_rod::WORKING_STEP_MM,
            tables: Mutex::new(HashMap::new()),
            slips: Mutex::new(HashMap::new()),
        })
    }

    /// The rod with the given deviations.
    fn rod(&self, mechanics: &Mechanics) -> Option<Rod> {
        let mut rod = Rod::new(&self.spec, self.step_mm).ok()?;
        let [y, z] = mechanics.compliance_rad_per_nmm;
        let largest = y.abs().max(z.abs());
        if largest > 0.0 {
            rod.compliance_rad_per_nmm = largest;
            rod.compliance_axes = Vector3::new(0.0, y / largest, z / largest);
        }
        rod.section.softening = mechanics.softening;
        rod.section.taper = mechanics.taper;
        if mechanics.weight != 0.0 {
            rod = rod.with_weight(&self.spec, self.fluid_kg_m3);
            rod.weight_n_per_mm *= mechanics.weight;
        }
        Some(rod)
    }

    fn line(&self, l: usize, mechanics: &Mechanics) -> Line {
        Line {
            origin_mm: self.lines[l].origin_mm + Vector3::from(mechanics.offset_mm),
            direction: self.lines[l].direction,
        }
    }

    /// Tables of every line under `mechanics`.
    pub fn tables(&self, mechanics: &Mechanics) -> Option<Arc<Vec<LineTable>>> {
        let key = mechanics.key();
        if let Some(found) = self.tables.lock().ok()?.get(&key) {
            return Some(found.clone());
        }
        let rod = self.rod(mechanics)?;
        let tables: Vec<LineTable> =
            (0..self.lines.len()).map(|l| self.tabulate(&rod, l, mechanics)).collect();
        let tables = Arc::new(tables);
        let mut kept = self.tables.lock().ok()?;
        // Refits visit hundreds of parameter values; only a short memory is of use.
        if kept.len() > 64 {
            kept.clear();
        }
        kept.insert(key, tables.clone());
        Some(tables)
    }

    fn tabulate(&self, rod: &Rod, l: usize, mechanics: &Mechanics) -> LineTable {
        let line = self.line(l, mechanics);
        let (start, reach) = (self.start_mm[l], self.reach_mm[l]);
        if reach <= start {
            return LineTable {
                touch_mm: reach,
                step_mm: 1.0,
                moments_nmm: vec![[0.0; 2]; 4],
                arclength_mm: vec![0.0; 4],
                end_mm: f64::INFINITY,
            };
        }
        let touch = rod.first_touch(&line, MARGIN_MM - start, reach);
        let count = ((reach - touch.x_mm) / GRID_MM).ceil().clamp(14.0, 40.0) as usize;
        let step_mm = (reach + MARGIN_MM - touch.x_mm) / count as f64;
        let xs: Vec<f64> = (0..=count).map(|k| touch.x_mm + step_mm * k as f64).collect();
        let mut table = LineTable {
            touch_mm: touch.x_mm,
            step_mm,
            moments_nmm: Vec::with_capacity(count + 1),
            arclength_mm: Vec::with_capacity(count + 1),
            end_mm: xs[count],
        };
        let at_rest = self.axes.components_nmm(&rod.rest_moment_nmm());
        for (k, outcome) in rod.follow(&line, &xs).iter().enumerate() {
            let Some(e) = outcome.equilibrium() else {
                table.end_mm = if k > 0 { xs[k - 1] } else { touch.x_mm };
                break;
            };
            let m = self.axes.components_nmm(&e.moment_nmm);
            table.moments_nmm.push([m[0] - at_rest[0], m[1] - at_rest[1]]);
            table.arclength_mm.push(e.arclength_mm);
        }
        while table.moments_nmm.len() < 4 {
            table.moments_nmm.push([0.0; 2]);
            table.arclength_mm.push(touch.arclength_mm);
        }
        table
    }

    fn slip_tables(&self, mechanics: &Mechanics) -> Option<Arc<Vec<Option<SlipTable>>>> {
        let key = mechanics.key();
        if let Some(found) = self.slips.lock().ok()?.get(&key) {
            return Some(found.clone());
        }
        let rod = self.rod(mechanics)?;
        let tables = self.tables(mechanics)?;
        let slips: Vec<Option<SlipTable>> =
            tables.iter().enumerate().map(|(l, t)| self.tabulate_slip(&rod, l, mechanics, t)).collect();
        let slips = Arc::new(slips);
        let mut kept = self.slips.lock().ok()?;
        if kept.len() > 8 {
            kept.clear();
        }
        kept.insert(key, slips.clone());
        Some(slips)
    }

    /// Walks each slip branch outward from the frictionless one, ratio by ratio.
    fn tabulate_slip(
        &self,
        rod: &Rod,
        l: usize,
        mechanics: &Mechanics,
        table: &LineTable,
    ) -> Option<SlipTable> {
        if self.reach_mm[l] <= self.start_mm[l] || table.end_mm <= table.touch_mm {
            return None;
        }
        let line = self.line(l, mechanics);
        let count = table.moments_nmm.len().clamp(8, 24);
        let step_mm = (table.end_mm - table.touch_mm) / (count - 1) as f64;
        let ratios: Vec<f64> =
            (0..=2 * RATIO_STEPS).map(|k| LARGEST_RATIO * (k as f64 / RATIO_STEPS as f64 - 1.0)).collect();
        let xs: Vec<f64> = (0..count).map(|k| table.touch_mm + step_mm * k as f64).collect();
        let mut slip = SlipTable {
            touch_mm: table.touch_mm,
            step_mm,
            ratios,
            arclength_mm: Vec::with_capacity(count),
            moments_nmm: Vec::with_capacity(count),
        };
        let width = slip.ratios.len();
        slip.arclength_mm.push(vec![table.arclength(table.touch_mm); width]);
        slip.moments_nmm.push(vec![[0.0; 2]; width]);
        for (x, outcome) in xs.iter().zip(rod.follow(&line, &xs)).skip(1) {
            let Outcome::Held(free) = outcome else { return None };
            let mut arclength = vec![free.arclength_mm; width];
            let mut moments = vec![self.axes.components_nmm(&free.moment_nmm); width];
            for side in [-1_i64, 1] {
                let mut guess = Guess::from(&free);
                for step in 1..=RATIO_STEPS as i64 {
                    let k = (RATIO_STEPS as i64 + side * step) as usize;
                    let e = rod.solve(&line.point(*x), &guess, Tangential::Ratio(slip.ratios[k])).ok()?;
                    guess = Guess::from(&e);
                    arclength[k] = e.arclength_mm;
                    moments[k] = self.axes.components_nmm(&e.moment_nmm);
                }
            }
            slip.arclength_mm.push(arclength);
            slip.moments_nmm.push(moments);
        }
        // At first touch the force vanishes but its direction does not: the contact's place tends to the next one's.
        slip.arclength_mm[0] =
            slip.arclength_mm[1].iter().zip(&slip.arclength_mm[2]).map(|(a, b)| 2.0 * a - b).collect();
        Some(slip)
    }

    /// Moment components at every node of the path, N mm; `xs_mm` are the nodes' effective stage positions.
    pub fn moments(
        &self,
        nodes: &[crate::path::Node],
        xs_mm: &[f64],
        mechanics: &Mechanics,
    ) -> Option<Vec<[f64; 2]>> {
        let tables = self.tables(mechanics)?;
        let slips = if mechanics.friction > 0.0 { Some(self.slip_tables(mechanics)?) } else { None };
        let mut contact: Option<(usize, f64, f64)> = None;
        let mut out = Vec::with_capacity(nodes.len());
        for (node, &x) in nodes.iter().zip(xs_mm) {
            let Some(l) = node.line.filter(|_| !node.rest) else {
                contact = None;
                out.push([0.0; 2]);
                continue;
            };
            let frictionless = tables[l].moment(x)?;
            let Some(slip) = slips.as_ref().and_then(|s| s[l].as_ref()) else {
                if slips.is_some() {
                    return None;
                }
                out.push(frictionless);
                continue;
            };
            if x <= slip.touch_mm {
                contact = None;
                out.push([0.0; 2]);
                continue;
            }
            let (mut s, from) = match contact {
                Some((line, s, from)) if line == l => (s, from),
                _ => (slip.arclength(slip.touch_mm, 0.0), slip.touch_mm),
            };
            let friction = mechanics.friction * if node.moving { mechanics.moving_share } else { 1.0 };
            let pieces = ((x - from).abs() / FRICTION_STEP_MM).ceil().max(1.0) as usize;
            for k in 1..=pieces {
                slip.advance(from + (x - from) * k as f64 / pieces as f64, friction, &mut s);
            }
            contact = Some((l, s, x));
            let ratio = slip.ratio_at(x, s, friction);
            let (with, without) = (slip.moment(x, ratio), slip.moment(x, 0.0));
            // The fine table carries the size, the coarse one only the difference that friction makes.
            out.push([frictionless[0] + with[0] - without[0], frictionless[1] + with[1] - without[1]]);
        }
        Some(out)
    }

    /// Contact arc length at stage position `x_mm` on line `l` under the declared model, mm.
    pub fn arclength_mm(&self, l: usize, x_mm: f64) -> Option<f64> {
        Some(self.tables(&Mechanics::default())?[l].arclength(x_mm))
    }
}

/// Substep of the groove for the stick-slip play, mm.
const FRICTION_STEP_MM: f64 = 0.25;
