//! Appearance of the wire in one picture: blur and width, from the pieces that show it best.
//!
//! ```text
//! minimise over (ln blur, ln width)  sum over pieces of min over (centre, levels) |pixels - bar|^2
//! N = A - C D^-1 C^T,  g = a - C D^-1 d        A, a: shared parameters;  D, d: centre and levels of a piece;  C: coupling
//! ```
//! Levenberg-Marquardt with every piece's own parameters eliminated. Source: as `bar` (separable
//! least squares).

use crate::picture::Picture;
use crate::wire::bar::{Bar, FIRST_RIDGE, Levels, Pixel, near_px};
use crate::wire::piece::{Appearance, Piece, gather};
use nalgebra::{Const, Matrix2, SMatrix, SVector, Vector2};
use wcal_core::least_squares::{Damping, Linearised, NormalEquations, minimise};

/// Bounds of blur (px) and of width over the expected width.
const BLUR: [f64; 2] = [0.35, 3.0];
const WIDTH: [f64; 2] = [0.6, 1.5];
/// Pieces used; of these the worst quarter is omitted.
const PIECES: usize = 32;

/// A piece's pixels and where its centre is now.
struct Patch {
    pixels: Vec<Pixel>,
    width_px: f64,
    centre: f64,
    level: Levels,
}

/// Pooled squares a pixel with their normal equations in (ln blur, ln width).
struct Pooled {
    normal: NormalEquations<Const<2>>,
    /// Where every patch's centre and levels settled.
    settled: Vec<(f64, Levels)>,
}

impl Linearised for Pooled {
    type Step = Vector2<f64>;

    fn cost(&self) -> f64 {
        self.normal.cost
    }

    fn step(&self, damping: f64) -> Option<Vector2<f64>> {
        self.normal.step(damping)
    }
}

impl Appearance {
    /// After a step in (ln blur, ln width), limited in size and to the range of real wires.
    fn changed(self, step: &Vector2<f64>) -> Self {
        Self {
            blur_px: (self.blur_px * step[0].clamp(-0.3, 0.3).exp()).clamp(BLUR[0], BLUR[1]),
            width_scale: (self.width_scale * step[1].clamp(-0.2, 0.2).exp())
                .clamp(WIDTH[0], WIDTH[1]),
        }
    }
}

/// Blur and width of the wire from the pieces that show it best: least pooled squares by
/// Levenberg-Marquardt, centres and levels of every piece eliminated. `start` where too few pieces
/// show the wire.
pub fn fit_appearance(picture: &Picture, pieces: &[Piece], start: Appearance) -> Appearance {
    let mut best: Vec<&Piece> = pieces.iter().filter(|p| p.evidence > 0.0).collect();
    best.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    best.truncate(PIECES);
    if best.len() < 8 {
        return start;
    }
    let patches: Vec<Patch> = best
        .iter()
        .map(|p| {
            let width_px = p.station.width_px;
            // Room for a blur and a width somewhat above those of the start.
            let near = near_px(width_px * start.width_scale, start.blur_px) + 1.0;
            let mut pixels = gather(picture, &p.station, near + p.offset_px.abs());
            pixels.retain(|q| (q.0 - p.offset_px).abs() <= near);
            let [left, right] = p.depth;
            Patch {
                pixels,
                width_px,
                centre: p.offset_px,
                level: Levels::new(left, right, 0.0, 0.0),
            }
        })
        .collect();
    // Each piece starts where it settled at the place before.
    let settled: Vec<(f64, Levels)> = patches.iter().map(|p| (p.centre, p.level)).collect();
    let Some(first) = pooled(&patches, &settled, start) else {
        return start;
    };
    let damping = Damping {
        grow: 10.0,
        max: 1e6,
        max_steps: 20,
        ..Damping::default()
    };
    let found = minimise(
        ((start, settled), first),
        &damping,
        |(appearance, settled)| pooled(&patches, settled, *appearance),
        |(appearance, _), pooled, step| (appearance.changed(step), pooled.settled.clone()),
        |step, _| step.norm() < 1e-3,
    );
    found.place.0
}

/// Centres are fitted again at every step: fixed where a wrong width put them, they would confirm
/// that width. The worst quarter and pieces that cannot be fitted are left out; none where that is
/// more than a quarter.
fn pooled(patches: &[Patch], starts: &[(f64, Levels)], appearance: Appearance) -> Option<Pooled> {
    let fit = |(p, s): (&Patch, &(f64, Levels))| fit_patch(p, *s, appearance);
    let fits: Vec<Option<PatchFit>> = patches.iter().zip(starts).map(fit).collect();
    let settled = fits.iter().zip(starts);
    let settled = settled
        .map(|(f, s)| f.as_ref().map_or(*s, |f| (f.centre, f.level)))
        .collect();
    let mut all: Vec<PatchFit> = fits.into_iter().flatten().collect();
    let keep = patches.len() * 3 / 4;
    if all.len() < keep {
        return None;
    }
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut normal = NormalEquations {
        cost: 0.0,
        matrix: Matrix2::zeros(),
        descent: Vector2::zeros(),
    };
    for p in &all[..keep] {
        normal.cost += p.cost / keep as f64;
        normal.matrix += p.normal / keep as f64;
        normal.descent += p.gradient / keep as f64;
    }
    Some(Pooled { normal, settled })
}

/// One patch's squares a pixel and its part of the normal equations.
struct PatchFit {
    centre: f64,
    level: Levels,
    cost: f64,
    normal: Matrix2<f64>,
    gradient: Vector2<f64>,
}

fn fit_patch(
    patch: &Patch,
    (centre, level): (f64, Levels),
    appearance: Appearance,
) -> Option<PatchFit> {
    type Nuisance = SVector<f64, 5>;
    let bar = Bar::new(patch.width_px * appearance.width_scale, appearance.blur_px);
    let fit = bar.settle(&patch.pixels, centre, level, 6, false)?;
    // A bar that jumps to a neighbouring line has no information about the wire.
    if (fit.centre - centre).abs() > 1.0 {
        return None;
    }
    let n = patch.pixels.len() as f64;
    // Rows: blur, width; nuisances: centre and levels.
    let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
    let (mut own, mut pull) = (
        SMatrix::<f64, 5, 5>::identity() * 1e-9 * n,
        Nuisance::zeros(),
    );
    // The light across the bar has the same ridge as in `settle`.
    own[(4, 4)] += FIRST_RIDGE;
    let mut cross = SMatrix::<f64, 2, 5>::zeros();
    for &(u, value) in &patch.pixels {
        let [f, by_centre, by_blur, by_width] = bar.shares_with_slopes(u - fit.centre);
        let r = value - f.dot(&fit.level);
        let shared = Vector2::new(by_blur.dot(&fit.level), by_width.dot(&fit.level));
        let nuisance = Nuisance::new(by_centre.dot(&fit.level), f[0], f[1], f[2], f[3]);
        normal += shared * shared.transpose();
        gradient += shared * r;
        own += nuisance * nuisance.transpose();
        pull += nuisance * r;
        cross += shared * nuisance.transpose();
    }
    let inverse = own.cholesky()?;
    normal -= cross * inverse.solve(&cross.transpose());
    gradient -= cross * inverse.solve(&pull);
    Some(PatchFit {
        centre: fit.centre,
        level: fit.level,
        cost: fit.cost / n,
        normal: normal / n,
        gradient: gradient / n,
    })
}
