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

/// A piece's pixels and expected width, px.
type Patch = (Vec<Pixel>, f64);

/// Where a patch's centre and levels are.
type Place = (f64, Levels);

/// Pooled squares a pixel with their normal equations in (ln blur, ln width).
struct Pooled {
    normal: NormalEquations<Const<2>>,
    /// Where every patch's centre and levels settled.
    settled: Vec<Place>,
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
    // Each piece starts where it settled at the place before.
    let (patches, settled): (Vec<Patch>, Vec<Place>) = best
        .iter()
        .map(|p| {
            let width_px = p.station.width_px;
            // Room for a blur and a width somewhat above those of the start.
            let near = near_px(width_px * start.width_scale, start.blur_px) + 1.0;
            let mut pixels = gather(picture, &p.station, near + p.offset_px.abs());
            pixels.retain(|q| (q.0 - p.offset_px).abs() <= near);
            let [left, right] = p.depth;
            let level = Levels::new(left, right, 0.0, 0.0);
            ((pixels, width_px), (p.offset_px, level))
        })
        .unzip();
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
fn pooled(patches: &[Patch], starts: &[Place], appearance: Appearance) -> Option<Pooled> {
    let (mut settled, mut all) = (starts.to_vec(), Vec::new());
    for (patch, place) in patches.iter().zip(&mut settled) {
        if let Some((there, normal)) = fit_patch(patch, *place, appearance) {
            *place = there;
            all.push(normal);
        }
    }
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
        normal.matrix += p.matrix / keep as f64;
        normal.descent += p.descent / keep as f64;
    }
    Some(Pooled { normal, settled })
}

/// Where one patch settles, its squares a pixel and its part of the normal equations.
fn fit_patch(
    (pixels, width_px): &Patch,
    (centre, level): Place,
    appearance: Appearance,
) -> Option<(Place, NormalEquations<Const<2>>)> {
    type Nuisance = SVector<f64, 5>;
    let bar = Bar::new(width_px * appearance.width_scale, appearance.blur_px);
    let fit = bar.settle(pixels, centre, level, 6, false)?;
    // A bar that jumps to a neighbouring line has no information about the wire.
    if (fit.centre - centre).abs() > 1.0 {
        return None;
    }
    let n = pixels.len() as f64;
    // Rows: blur, width; nuisances: centre and levels.
    let (mut normal, mut gradient) = (Matrix2::zeros(), Vector2::zeros());
    let (mut own, mut pull) = (
        SMatrix::<f64, 5, 5>::identity() * 1e-9 * n,
        Nuisance::zeros(),
    );
    // The light across the bar has the same ridge as in `settle`.
    own[(4, 4)] += FIRST_RIDGE;
    let mut cross = SMatrix::<f64, 2, 5>::zeros();
    for &(u, value) in pixels {
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
    // Schur complement: the piece's own parameters eliminated.
    let inverse = own.cholesky()?;
    normal -= cross * inverse.solve(&cross.transpose());
    gradient -= cross * inverse.solve(&pull);
    let normal = NormalEquations {
        cost: fit.cost / n,
        matrix: normal / n,
        descent: gradient / n,
    };
    Some(((fit.centre, fit.level), normal))
}
