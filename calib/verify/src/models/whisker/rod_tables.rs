//! Base moments along each trajectory from the rod, tabulated; friction as a play between two slip
//! branches.

use super::branch_cache::BranchCache;
use super::kept::Kept;
use super::path::{Node, WhiskerPath, positions};
use super::rod_parameters::RodParameters;
use super::tables::{LineTable, MAX_RATIO, RATIO_STEPS, SlipRow, SlipTable};
use nalgebra::Vector3;
use rayon::prelude::*;
use std::sync::Arc;
use wcal_core::observation::{MomentAxes, RestShape, WhiskerData, WhiskerSpec};
use wcal_rod::{Equilibrium, Guess, Line, Outcome, Rod, Tangential, Touch};

type Key = Vec<u64>;

/// The rod's answers along the lines of one session, kept by mechanical parameters.
pub struct RodTables {
    spec: WhiskerSpec,
    fluid_kg_m3: f64,
    pub(super) lines: Vec<Line>,
    start_mm: Vec<f64>,
    reach_mm: Vec<f64>,
    pub(super) axes: MomentAxes,
    /// So few readings that each is solved for by itself.
    sparse: bool,
    pub(super) points: Kept<Key, Vec<Option<Equilibrium>>>,
    touches: Kept<(usize, [u64; 5]), Touch>,
    pub(super) branches: BranchCache,
    tables: Kept<Key, Vec<LineTable>>,
    slips: Kept<Key, Vec<Option<SlipTable>>>,
}

/// Mesh of the rod, mm: moments differ by 4e-6 N mm from those of a fine mesh (wcal-rod,
/// tests/acceptance/order.rs).
const MESH_MM: f64 = 4.0;
/// Density of air, kg/m^3.
pub(super) const AIR_KG_M3: f64 = 1.2;
/// Grid of the tables, mm: interpolation is right to 1e-4 of the moment there (tests).
const GRID_MM: f64 = 0.8;
/// Room past the last reading for effects that shift the stage, mm.
const MARGIN_MM: f64 = 0.6;

/// At most this many distinct positions a line, on average, are solved one by one: a table has some
/// twenty.
const SPARSE_POSITIONS: usize = 6;

fn is_sparse(path: &WhiskerPath) -> bool {
    let xs: Vec<f64> = path.nodes.iter().map(|n| n.x_mm).collect();
    let wanted = positions(&path.nodes, &xs, path.lines.len());
    let used = wanted.iter().filter(|w| !w.is_empty()).count();
    wanted.iter().map(Vec::len).sum::<usize>() <= SPARSE_POSITIONS * used
}

/// The wire with another straight part and another arc.
fn wire_of(spec: &WhiskerSpec, rod_parameters: &RodParameters) -> WhiskerSpec {
    let mut wire = spec.clone();
    if let RestShape::StraightArc {
        straight_mm,
        arc_radius_mm,
        ..
    } = &mut wire.rest_shape
    {
        *straight_mm += rod_parameters.straight_change_mm;
        *arc_radius_mm += rod_parameters.arc_radius_change_mm;
    }
    wire
}

/// A wire with the given deviations in a medium.
pub(super) fn rod_of(
    spec: &WhiskerSpec,
    fluid_kg_m3: f64,
    rod_parameters: &RodParameters,
) -> Option<Rod> {
    let mut rod = Rod::new(&wire_of(spec, rod_parameters), MESH_MM).ok()?;
    let [y, z] = rod_parameters.compliance_rad_per_nmm;
    let largest = y.abs().max(z.abs());
    if largest > 0.0 {
        rod.compliance_rad_per_nmm = largest;
        // The root turns under bending alone, so nothing about base x.
        rod.compliance_axes = Vector3::new(0.0, y / largest, z / largest);
    }
    rod.section.softening = rod_parameters.softening;
    rod.section.taper = rod_parameters.taper;
    if rod_parameters.weight != 0.0 {
        rod = rod.with_weight(spec, fluid_kg_m3);
        rod.weight_n_per_mm *= rod_parameters.weight;
    }
    Some(rod)
}

impl RodTables {
    /// Bench of a whisker and the lines that its readings use.
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(data: &WhiskerData, path: &WhiskerPath) -> Result<Self, wcal_rod::RodError> {
        Rod::new(&data.whisker, MESH_MM)?;
        Ok(Self {
            spec: data.whisker.clone(),
            fluid_kg_m3: match data.medium.as_str() {
                // At 20 deg C, kg/m^3.
                "water" => 998.2,
                _ => AIR_KG_M3,
            },
            lines: path.lines.clone(),
            start_mm: path.start_mm.clone(),
            reach_mm: path.reach_mm.clone(),
            axes: data.moments.clone(),
            sparse: is_sparse(path),
            points: Kept::at_most(256),
            touches: Kept::at_most(4096),
            branches: BranchCache::new(path.lines.len()),
            tables: Kept::at_most(65),
            slips: Kept::at_most(9),
        })
    }

    /// The rod with the given deviations.
    pub(super) fn rod(&self, rod_parameters: &RodParameters) -> Option<Rod> {
        rod_of(&self.spec, self.fluid_kg_m3, rod_parameters)
    }

    pub(super) fn line(&self, l: usize, rod_parameters: &RodParameters) -> Line {
        Line {
            origin_mm: self.lines[l].origin_mm + Vector3::from(rod_parameters.offset_mm),
            direction: self.lines[l].direction,
        }
    }

    /// Where line `l` ends: its last reading and some room, mm.
    pub(super) fn end_mm(&self, l: usize) -> f64 {
        self.reach_mm[l] + MARGIN_MM
    }

    /// Tables of every line under `rod_parameters`.
    pub fn tables(&self, rod_parameters: &RodParameters) -> Option<Arc<Vec<LineTable>>> {
        self.tables.get(rod_parameters.key(), || {
            let rod = self.rod(rod_parameters)?;
            let lines = (0..self.lines.len()).into_par_iter();
            let table = |l| self.tabulate(&rod, l, rod_parameters);
            Some(lines.map(table).collect())
        })
    }

    fn tabulate(&self, rod: &Rod, l: usize, rod_parameters: &RodParameters) -> LineTable {
        if self.reach_mm[l] <= self.start_mm[l] {
            return LineTable {
                touch_mm: self.reach_mm[l],
                step_mm: 1.0,
                moments_nmm: vec![[0.0; 2]; 4],
                arclength_mm: vec![0.0; 4],
                end_mm: f64::INFINITY,
            };
        }
        let touch = self.touch(rod, l, rod_parameters);
        // As fine as the grid asks for: few nodes interpolate badly, many cost rod solutions.
        let count = ((self.reach_mm[l] - touch.x_mm) / GRID_MM)
            .ceil()
            .clamp(14.0, 40.0) as usize;
        let step_mm = (self.end_mm(l) - touch.x_mm) / count as f64;
        let xs: Vec<f64> = (0..=count)
            .map(|k| touch.x_mm + step_mm * k as f64)
            .collect();
        // A walk from first touch costs many solutions: a known neighbour is tried first.
        let equilibria = self
            .warm_start(rod, l, rod_parameters, touch.x_mm, &xs)
            .unwrap_or_else(|| self.followed(rod, l, rod_parameters, touch.x_mm, &xs));
        // The weight of the free wire bends it before any contact: that is part of the zero.
        let at_rest = self.axes.components_nmm(&rod.rest_moment_nmm());
        let node = |e: &Equilibrium| {
            let m = self.axes.components_nmm(&e.moment_nmm);
            ([m[0] - at_rest[0], m[1] - at_rest[1]], e.arclength_mm)
        };
        let (mut moments_nmm, mut arclength_mm): (Vec<_>, Vec<_>) =
            equilibria.iter().map(node).unzip();
        let nodes = equilibria.len().max(4);
        moments_nmm.resize(nodes, [0.0; 2]);
        arclength_mm.resize(nodes, touch.arclength_mm);
        LineTable {
            touch_mm: touch.x_mm,
            step_mm,
            moments_nmm,
            arclength_mm,
            end_mm: xs[equilibria.len().saturating_sub(1)],
        }
    }

    /// First touch; it depends on the groove's offset and the wire at rest alone.
    pub(super) fn touch(&self, rod: &Rod, l: usize, rod_parameters: &RodParameters) -> Touch {
        let find = || {
            rod.first_touch(
                &self.line(l, rod_parameters),
                MARGIN_MM - self.start_mm[l],
                self.reach_mm[l],
            )
        };
        let RodParameters {
            offset_mm: [x, y, z],
            straight_change_mm,
            arc_radius_change_mm,
            ..
        } = *rod_parameters;
        let key = [x, y, z, straight_change_mm, arc_radius_change_mm].map(f64::to_bits);
        let kept = self.touches.get((l, key), || Some(find()));
        kept.map_or_else(find, |touch| *touch)
    }

    fn slip_tables(&self, rod_parameters: &RodParameters) -> Option<Arc<Vec<Option<SlipTable>>>> {
        self.slips.get(rod_parameters.key(), || {
            let (rod, tables) = (self.rod(rod_parameters)?, self.tables(rod_parameters)?);
            let lines = tables.par_iter().enumerate();
            let slip = |(l, t)| self.tabulate_slip(&rod, l, rod_parameters, t);
            Some(lines.map(slip).collect())
        })
    }

    /// Walks each slip branch outward from the frictionless one, ratio by ratio.
    fn tabulate_slip(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        table: &LineTable,
    ) -> Option<SlipTable> {
        if self.reach_mm[l] <= self.start_mm[l] || table.end_mm <= table.touch_mm {
            return None;
        }
        let line = self.line(l, rod_parameters);
        // The table of friction carries a small difference only: a coarser grid is enough.
        let count = table.moments_nmm.len().clamp(8, 24);
        let step_mm = (table.end_mm - table.touch_mm) / (count - 1) as f64;
        // Friction acts against the sliding: loading and unloading have opposite signs.
        let ratios: Vec<f64> = (0..=2 * RATIO_STEPS)
            .map(|k| MAX_RATIO * (k as f64 / RATIO_STEPS as f64 - 1.0))
            .collect();
        let xs: Vec<f64> = (0..count)
            .map(|k| table.touch_mm + step_mm * k as f64)
            .collect();
        let mut slip = SlipTable {
            touch_mm: table.touch_mm,
            step_mm,
            ratios,
            rows: Vec::with_capacity(count),
        };
        // At first touch the force is zero, so no ratio of friction changes the moment.
        slip.rows.push(SlipRow::untouched(
            table.arclength(table.touch_mm),
            slip.ratios.len(),
        ));
        for (x, outcome) in xs.iter().zip(rod.follow(&line, &xs)).skip(1) {
            // Slip branches start from the frictionless contact: where it is lost there are none.
            let Outcome::Held(free) = outcome else {
                return None;
            };
            slip.rows
                .push(self.slip_row(rod, &line.point(*x), &free, &slip.ratios));
        }
        // At first touch the force vanishes but its direction does not: the contact's place tends
        // to the next one's.
        let [first, second] = [1, 2].map(|i| &slip.rows[i].arclength_mm);
        slip.rows[0].arclength_mm = first.iter().zip(second).map(|(a, b)| 2.0 * a - b).collect();
        Some(slip)
    }

    /// The slip branches at one position of the groove. Where friction leaves the wire no
    /// equilibrium, a branch goes on straight, as far as no contact is held there.
    fn slip_row(
        &self,
        rod: &Rod,
        point_mm: &Vector3<f64>,
        free: &Equilibrium,
        ratios: &[f64],
    ) -> SlipRow {
        let of = |e: &Equilibrium| (e.arclength_mm, self.axes.components_nmm(&e.moment_nmm));
        let mut row = vec![of(free); ratios.len()];
        let mut held = [-MAX_RATIO, MAX_RATIO];
        for (side, end) in [-1_i64, 1].into_iter().zip(&mut held) {
            let at = |step: i64| (RATIO_STEPS as i64 + side * step) as usize;
            // Newton's method stays on the branch only from the solution of the ratio next to it.
            let (mut guess, mut lost) = (Guess::from(free), false);
            for step in 1..=RATIO_STEPS as i64 {
                let ratio = Tangential::Ratio(ratios[at(step)]);
                let found = if lost {
                    None
                } else {
                    rod.solve(point_mm, &guess, ratio).ok()
                };
                row[at(step)] = if let Some(e) = found {
                    guess = Guess::from(&e);
                    of(&e)
                } else {
                    if !lost {
                        (*end, lost) = (ratios[at(step - 1)], true);
                    }
                    let [(s, m), (s_before, m_before)] =
                        [row[at(step - 1)], row[at((step - 2).max(-1))]];
                    (2.0 * s - s_before, [0, 1].map(|c| 2.0 * m[c] - m_before[c]))
                };
            }
        }
        let (arclength_mm, moments_nmm) = row.into_iter().unzip();
        SlipRow {
            arclength_mm,
            moments_nmm,
            held,
        }
    }

    /// Moments without friction at every node, N mm: from the tables, or solved one by one where
    /// that is less work.
    fn frictionless(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        rod_parameters: &RodParameters,
    ) -> Option<Vec<[f64; 2]>> {
        // With weight the moment of the free wire must be taken off, which only the tables do.
        if self.sparse && rod_parameters.weight == 0.0 {
            return self.solved_moments(nodes, xs_mm, rod_parameters);
        }
        let tables = self.tables(rod_parameters)?;
        let at = |(node, x): (&Node, &f64)| match node.loaded_line() {
            Some(l) => tables[l].moment(*x),
            None => Some([0.0; 2]),
        };
        nodes.iter().zip(xs_mm).map(at).collect()
    }

    /// Moment components at every node of the path, N mm; `xs_mm` are the nodes' effective stage
    /// positions.
    pub fn moments(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        rod_parameters: &RodParameters,
    ) -> Option<Vec<[f64; 2]>> {
        let frictionless = self.frictionless(nodes, xs_mm, rod_parameters)?;
        if rod_parameters.friction <= 0.0 {
            return Some(frictionless);
        }
        let slips = self.slip_tables(rod_parameters)?;
        let held = stick_slip(&slips, nodes, xs_mm, rod_parameters)?;
        let moment = |k: usize| {
            let (Some(h), Some(l)) = (held[k], nodes[k].line) else {
                return Some([0.0; 2]);
            };
            let slip = slips[l].as_ref()?;
            // Friction beyond what the branch holds lets the wire snap out: no moment to state.
            if !slip.has_equilibrium(xs_mm[k], h.ratio) {
                return None;
            }
            let (with, without) = (slip.moment(xs_mm[k], h.ratio), slip.moment(xs_mm[k], 0.0));
            // The fine table carries the size, the coarse one only the difference that friction
            // makes.
            Some([0, 1].map(|c| frictionless[k][c] + with[c] - without[c]))
        };
        (0..nodes.len()).map(moment).collect()
    }

    /// Equilibria at the nodes `wanted`, friction included; none where the wire is free there.
    pub(super) fn contacts(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        rod_parameters: &RodParameters,
        wanted: &[usize],
    ) -> Option<Vec<Option<Equilibrium>>> {
        // Where every reading is solved for anyway, the cameras' poses are among them.
        let free: Vec<Option<Equilibrium>> = if self.sparse && rod_parameters.weight == 0.0 {
            let all = self.solved_contacts(nodes, xs_mm, rod_parameters)?;
            wanted.iter().map(|&k| all[k]).collect()
        } else {
            let some: Vec<Node> = wanted.iter().map(|&k| nodes[k]).collect();
            let xs: Vec<f64> = wanted.iter().map(|&k| xs_mm[k]).collect();
            self.solved_contacts(&some, &xs, rod_parameters)?.to_vec()
        };
        if rod_parameters.friction <= 0.0 {
            return Some(free);
        }
        let slips = self.slip_tables(rod_parameters)?;
        let held = stick_slip(&slips, nodes, xs_mm, rod_parameters)?;
        let rod = self.rod(rod_parameters)?;
        let stuck = |(e, &k): (&Option<Equilibrium>, &usize)| {
            let (Some(e), Some(h)) = (e, held[k]) else {
                return *e;
            };
            // Where the contact sticks is known, and the force along the wire is not.
            let found = rod.solve(
                &e.point_mm,
                &Guess::from(e),
                Tangential::Stick(h.arclength_mm),
            );
            Some(found.unwrap_or(Equilibrium {
                arclength_mm: h.arclength_mm,
                ..*e
            }))
        };
        Some(free.iter().zip(wanted).map(stuck).collect())
    }

    /// Contact arc length at stage position `x_mm` on line `l` under the declared model, mm.
    pub fn arclength_mm(&self, l: usize, x_mm: f64) -> Option<f64> {
        Some(self.tables(&RodParameters::default())?[l].arclength(x_mm))
    }
}

/// Where friction holds the contact.
#[derive(Debug, Clone, Copy)]
struct FrictionContact {
    /// Arc length, mm.
    arclength_mm: f64,
    /// Tangential over normal force.
    ratio: f64,
}

/// Contact under friction along the path: it sticks inside the cone and slips at its edge; none
/// where the wire is free.
fn stick_slip(
    slips: &[Option<SlipTable>],
    nodes: &[Node],
    xs_mm: &[f64],
    rod_parameters: &RodParameters,
) -> Option<Vec<Option<FrictionContact>>> {
    // Line, arc length and stage position of the contact before.
    let mut before: Option<(usize, f64, f64)> = None;
    let of = |(node, &x): (&Node, &f64)| {
        let last = before.take();
        let Some(l) = node.loaded_line() else {
            return Some(None);
        };
        let slip = slips[l].as_ref()?;
        // Free of the groove the contact forgets where it stuck.
        if x <= slip.touch_mm {
            return Some(None);
        }
        let (mut s, from) = match last {
            Some((line, s, from)) if line == l => (s, from),
            // A new contact begins at first touch, without force and so without friction.
            _ => (slip.arclength(slip.touch_mm, 0.0), slip.touch_mm),
        };
        let moving_share = if node.moving {
            rod_parameters.moving_share
        } else {
            1.0
        };
        let friction = rod_parameters.friction * moving_share;
        // Small steps: the play is taken up along the way, not at its end.
        let pieces = ((x - from).abs() / FRICTION_STEP_MM).ceil().max(1.0) as usize;
        for k in 1..=pieces {
            let at = from + (x - from) * k as f64 / pieces as f64;
            slip.advance(at, friction, &mut s);
        }
        before = Some((l, s, x));
        Some(Some(FrictionContact {
            arclength_mm: s,
            ratio: slip.ratio_at(x, s, friction),
        }))
    };
    nodes.iter().zip(xs_mm).map(of).collect()
}

/// Substep of the groove for the stick-slip play, mm.
const FRICTION_STEP_MM: f64 = 0.25;
