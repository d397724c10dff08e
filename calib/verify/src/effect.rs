//! What the loop knows of an effect before it sees data: laws, named parameters with unit and
//! range, and what they need of a session.

/// Role of a parameter in a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Role {
    /// Zero means "not there"; `probe` is a typical size.
    Amplitude {
        /// Typical size, in the parameter's unit.
        probe: f64,
    },
    /// Shapes the law; tried on `grid` before it is refined.
    Shape {
        /// Values tried in screening.
        grid: &'static [f64],
    },
}

/// A nonlinear parameter of a law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name in `verify.json`.
    pub name: &'static str,
    /// Unit, `1` where dimensionless.
    pub unit: &'static str,
    /// Physical range; an estimate at its end is no explanation unless the end is "not there".
    pub range: [f64; 2],
    /// Role.
    pub role: Role,
}

/// What a law needs of a session beyond the required columns: the one place that says so.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LawRequirement {
    /// Time stamps.
    Time,
    /// Time stamps, or rows in the order in which they were taken.
    Clock,
    /// The order of the rows itself.
    Order,
    /// A temperature that varies.
    Temperature,
    /// Readings of both directions.
    BothDirections,
    /// Readings taken while the stage moves.
    Motion,
    /// Positions that the stage itself states.
    StagePosition,
    /// The direction of gravity and the wire's density.
    Weight,
    /// A declared model that follows the stimulus.
    Slope,
    /// A further covariate that varies.
    Covariate,
    /// Pairs of pictures of the poses.
    Pictures,
    /// Pairs of pictures taken while the stage moves.
    MovingPictures,
    /// A wire that is declared as a straight part and an arc.
    StraightArc,
    /// Readings at rest beside loaded ones.
    RestReadings,
}

/// One law by which an effect can act.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectModel {
    /// Name, e.g. `prony`.
    pub name: &'static str,
    /// Nonlinear parameters.
    pub parameters: Vec<Parameter>,
    /// Names and units of the coefficients that enter linearly, one a column and channel.
    pub linear: Vec<(&'static str, &'static str)>,
    /// Largest part that those columns may have in what a channel spans; none where the law has no
    /// such limit.
    pub largest_share: Option<f64>,
    /// What it needs of the session.
    pub needs: Vec<LawRequirement>,
}

/// A law without parameters of either kind yet.
pub fn law(name: &'static str) -> EffectModel {
    EffectModel {
        name,
        parameters: Vec::new(),
        linear: Vec::new(),
        largest_share: None,
        needs: Vec::new(),
    }
}

impl EffectModel {
    /// With a nonlinear size of the effect.
    pub fn amplitude(
        mut self,
        name: &'static str,
        unit: &'static str,
        range: [f64; 2],
        probe: f64,
    ) -> Self {
        self.parameters.push(Parameter {
            name,
            unit,
            range,
            role: Role::Amplitude { probe },
        });
        self
    }

    /// With several alike.
    pub(crate) fn amplitudes<const N: usize>(
        self,
        names: [&'static str; N],
        unit: &'static str,
        range: [f64; 2],
        probe: f64,
    ) -> Self {
        let add = |law: Self, name| law.amplitude(name, unit, range, probe);
        names.into_iter().fold(self, add)
    }

    /// With a value that shapes it.
    pub fn shape(
        mut self,
        name: &'static str,
        unit: &'static str,
        range: [f64; 2],
        grid: &'static [f64],
    ) -> Self {
        self.parameters.push(Parameter {
            name,
            unit,
            range,
            role: Role::Shape { grid },
        });
        self
    }

    /// With a coefficient that enters linearly.
    pub fn column(mut self, name: &'static str, unit: &'static str) -> Self {
        self.linear.push((name, unit));
        self
    }

    /// With `count` of them alike.
    pub(crate) fn columns(self, count: usize, name: &'static str, unit: &'static str) -> Self {
        (0..count).fold(self, |law, _| law.column(name, unit))
    }

    /// With a largest share.
    pub fn at_most(mut self, share: f64) -> Self {
        self.largest_share = Some(share);
        self
    }

    /// The same law that needs something of the session.
    pub(crate) fn needing(mut self, needs: &[LawRequirement]) -> Self {
        self.needs = needs.to_vec();
        self
    }
}

/// Values of a law's parameters, by name: what the hooks of an effect see.
#[derive(Debug, Clone, Copy)]
pub struct Values<'a> {
    law: &'a EffectModel,
    index: usize,
    values: &'a [f64],
}

impl<'a> Values<'a> {
    /// Values of `law`, which is number `index` of its effect, in the order of its parameters.
    pub fn new(law: &'a EffectModel, index: usize, values: &'a [f64]) -> Self {
        Self { law, index, values }
    }

    /// Name of the law.
    pub fn law(&self) -> &'static str {
        self.law.name
    }

    /// Number of the law among its effect's.
    pub fn index(&self) -> usize {
        self.index
    }

    /// Value of a parameter; NaN where the law has none of that name, so that no design comes of
    /// it.
    pub fn of(&self, name: &str) -> f64 {
        let at = self.law.parameters.iter().position(|p| p.name == name);
        at.and_then(|k| self.values.get(k))
            .copied()
            .unwrap_or(f64::NAN)
    }

    /// How many columns the law has.
    pub fn linear(&self) -> usize {
        self.law.linear.len()
    }

    /// All values in the order of the law's parameters.
    pub fn all(&self) -> &'a [f64] {
        self.values
    }
}

/// An effect of a catalogue: what it is called, and the laws by which it can act.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Identifier of docs/src/method.md.
    pub id: &'static str,
    /// One plain sentence for the report.
    pub sentence: &'static str,
    /// Laws, the plainest first.
    pub laws: Vec<EffectModel>,
    /// Richer laws, tried only where the effect is accepted already and something remains. Their
    /// indices go on after those of `laws`.
    pub refinements: Vec<EffectModel>,
    /// What it does to a reading depends on the readings before.
    pub has_memory: bool,
    /// Its laws are things that can act at once (periods, columns, time constants), each more than
    /// once where it has its own shape; else they describe one thing, and only one of them is true.
    pub superposes: bool,
    /// Ratio of their shapes from which on two of its terms are two things; nearer ones are one
    /// that is not steady.
    pub min_shape_ratio: f64,
    /// Each law follows a further column of the session, in their order.
    pub by_column: bool,
    /// It is found reading by reading, by the outlier stage, not by a law.
    pub is_outlier_process: bool,
}

impl Effect {
    /// An effect without memory of which one law is true.
    pub fn new(id: &'static str, sentence: &'static str, laws: Vec<EffectModel>) -> Self {
        Self {
            id,
            sentence,
            laws,
            refinements: Vec::new(),
            has_memory: false,
            superposes: false,
            min_shape_ratio: 1.0,
            by_column: false,
            is_outlier_process: false,
        }
    }

    /// A law by its index.
    ///
    /// # Panics
    /// Where there is none.
    pub fn law(&self, index: usize) -> &EffectModel {
        self.laws
            .get(index)
            .unwrap_or_else(|| &self.refinements[index - self.laws.len()])
    }

    /// A law by its name, with its index.
    pub(crate) fn law_named(&self, name: &str) -> Option<(usize, &EffectModel)> {
        self.laws
            .iter()
            .chain(&self.refinements)
            .enumerate()
            .find(|(_, l)| l.name == name)
    }

    /// What the plainest law needs of a session.
    pub fn needs(&self) -> &[LawRequirement] {
        self.laws.first().map_or(&[], |l| &l.needs)
    }

    /// The further column that a law follows, of those of the session.
    pub fn column<'a>(&self, law: usize, columns: &'a [String]) -> Option<&'a str> {
        columns
            .get(law)
            .filter(|_| self.by_column)
            .map(String::as_str)
    }
}

/// The effects of a catalogue.
pub(crate) type Catalogue = [Effect];

/// An effect with its law and nonlinear parameter values.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectTerm {
    /// Index in the catalogue.
    pub effect: usize,
    /// Index in the effect's laws.
    pub law: usize,
    /// Values of the law's nonlinear parameters.
    pub values: Vec<f64>,
}

/// What a term stands for: two terms of one explanation never stand for the same, and two
/// explanations of the same are one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct TermKey {
    /// Index in the catalogue.
    pub effect: usize,
    /// Index of the law where the effect's laws can act at once, else 0.
    pub law: usize,
    /// Number among the terms of that law.
    pub instance: usize,
}

impl EffectTerm {
    /// Key of the first term of its kind.
    pub fn key(&self, catalogue: &Catalogue) -> TermKey {
        let law = if catalogue[self.effect].superposes {
            self.law
        } else {
            0
        };
        TermKey {
            effect: self.effect,
            law,
            instance: 0,
        }
    }

    /// Whether both can stand in one explanation: they stand for different things, or for two
    /// instances that differ in shape.
    pub fn beside(&self, other: &Self, catalogue: &Catalogue) -> bool {
        if self.key(catalogue) != other.key(catalogue) {
            return true;
        }
        let law = catalogue[self.effect].law(self.law);
        let differs = |k: usize| match law.parameters[k].role {
            Role::Shape { grid } => {
                let (a, b) = (self.values[k], other.values[k]);
                (a - b).abs() > RAYLEIGH_GAPS * grid_spacing(grid, a).min(grid_spacing(grid, b))
                    && a.max(b) >= catalogue[self.effect].min_shape_ratio * a.min(b)
            }
            Role::Amplitude { .. } => false,
        };
        catalogue[self.effect].superposes && (0..law.parameters.len()).any(differs)
    }
}

/// Keys of terms, ascending; instances numbered.
pub fn keys(terms: &[EffectTerm], catalogue: &Catalogue) -> Vec<TermKey> {
    let mut out: Vec<TermKey> = Vec::new();
    for term in terms {
        let first = term.key(catalogue);
        let instance = out
            .iter()
            .filter(|k| (k.effect, k.law) == (first.effect, first.law))
            .count();
        out.push(TermKey { instance, ..first });
    }
    out.sort_unstable();
    out
}

/// Gaps of the shape's grid from which on two instances are two: for a period one cycle over the
/// range (Rayleigh).
const RAYLEIGH_GAPS: f64 = 1.9;

/// Distance from the grid point nearest to `value` to its neighbour: a law changes its shape over
/// about that much.
pub(crate) fn grid_spacing(grid: &[f64], value: f64) -> f64 {
    let near = grid
        .iter()
        .copied()
        .min_by(|a, b| (a - value).abs().total_cmp(&(b - value).abs()));
    let gaps = grid
        .iter()
        .filter_map(|g| near.map(|n| (g - n).abs()))
        .filter(|d| *d > 0.0);
    gaps.fold(f64::INFINITY, f64::min)
}
