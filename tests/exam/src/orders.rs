//! Order books: which sessions an exam draws.

use std::path::Path;

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use wcal_plant::PlantError;
use wcal_plant::case::Tampering;
use wcal_plant::case::{Case, CaseKind, Make, PictureSetup, Request};
use wcal_plant::effects::Kind;
use wcal_plant::layout::Design;
use wcal_plant::noise::Noise;
use wcal_plant::scalar::{self, EffectSize, ScalarCase, ScalarEffect, ScalarNoise, ScalarRequest};
use wcal_plant::session::{draw_looked, draw_under};
use wcal_plant::shapes::Fault;

/// One order of an exam.
#[derive(Debug, Clone, PartialEq)]
pub enum Order {
    /// A whisker's session with noise of a kind on a wire of a make.
    Whisker(Request, Noise, Make),
    /// A paper-like session of a whisker that cameras look at, or the same without them.
    PictureSetup(Request, PictureSetup),
    /// A transducer's or an axis's session.
    Scalar(ScalarRequest),
}

impl Order {
    /// Draws it.
    ///
    /// # Errors
    /// As [`draw_under`].
    pub fn draw(&self) -> Result<Drawn, PlantError> {
        Ok(match self {
            Self::Whisker(request, noise, make) => {
                Drawn::Whisker(Box::new(draw_under(request, *noise, *make)?))
            }
            Self::PictureSetup(request, looked) => {
                Drawn::Whisker(Box::new(draw_looked(request, *looked)?))
            }
            Self::Scalar(request) => Drawn::Scalar(Box::new(scalar::draw(request))),
        })
    }
}

/// A drawn session of any kind.
#[derive(Debug, Clone, PartialEq)]
pub enum Drawn {
    /// Of a whisker.
    Whisker(Box<Case>),
    /// Of a transducer or an axis.
    Scalar(Box<ScalarCase>),
}

impl Drawn {
    /// Writes the session into `folder`.
    ///
    /// # Errors
    /// [`PlantError::Write`] with the file that could not be written.
    pub fn write(&self, folder: &Path) -> Result<(), PlantError> {
        match self {
            Self::Whisker(case) => case.write(folder),
            Self::Scalar(case) => case.write(folder),
        }
    }

    /// Its entry of truth.json.
    ///
    /// # Errors
    /// Where the truth does not go into JSON.
    pub fn truth(&self) -> serde_json::Result<serde_json::Value> {
        match self {
            Self::Whisker(case) => serde_json::to_value(&case.truth),
            Self::Scalar(case) => serde_json::to_value(&case.truth),
        }
    }
}

/// Mixes that [`orders`] knows.
pub const MIXES: [&str; 16] = [
    "null",
    "single",
    "pair",
    "unknown",
    "paper",
    "confounded",
    "adversarial",
    "noise-null",
    "noise-single",
    "scalar-null",
    "scalar-single",
    "pictures",
    "pictures-null",
    "without-pictures",
    "nominals",
    "all",
];

/// A varied order book. `mix` is one of [`MIXES`]: `confounded` are pairs on approach-only
/// sessions, `noise-*` go through all kinds of noise, layouts and both wires, `scalar-*` through
/// transducers and axes. `pictures` are nulls, singles, pairs and faults of the cameras on
/// approach-only sessions that cameras look at, `pictures-null` nulls alone, `without-pictures` the
/// same ones without their pictures, `nominals` such sessions with pictures whose wire is not as
/// long straight as declared.
///
/// `only` keeps one effect identifier. Orders repeat the same for the same seed.
pub fn orders(mix: &str, draws: usize, seed: u64, only: Option<&str>, rivals: bool) -> Vec<Order> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let kinds: Vec<Kind> = wcal_plant::effects::ALL
        .into_iter()
        .filter(|k| only.is_none_or(|o| k.name().0 == o || k.name().1 == o))
        .collect();
    let catalogue: Vec<Kind> = kinds.iter().copied().filter(|k| !k.is_unknown()).collect();
    let unknown: Vec<Kind> = kinds.iter().copied().filter(|k| k.is_unknown()).collect();
    let targets = [8.0, 12.0, 20.0, 40.0];
    let (mut noisy, mut scalars) = (0, 0);
    let (mut walked, offset) = (0, rng.random_range(0..50_usize));
    if ["pictures", "pictures-null", "without-pictures", "nominals"].contains(&mix) {
        let of: Vec<Kind> = catalogue
            .into_iter()
            .filter(|k| k.observable(false) && *k != Kind::SlipOutliers)
            .collect();
        return (0..draws)
            .map(|i| looked_order(mix, i, &of, seed_of(seed, i)))
            .collect();
    }
    (0..draws)
        .map(|i| {
            let part = match mix {
                "all" => ALL_PARTS[i % ALL_PARTS.len()],
                one => one,
            };
            if let Some(effect) = part.strip_prefix("scalar-") {
                scalars += 1;
                return Order::Scalar(scalar_order(
                    effect == "single",
                    scalars - 1,
                    seed_of(seed, i),
                    &mut rng,
                ));
            }
            // Walk through the laws by turns (a stride prime to their number), so that few draws
            // see many of them.
            let mut turn = |of: &[Kind]| -> Option<Kind> {
                walked += 1;
                of.get((walked * 7 + offset) % of.len().max(1)).copied()
            };
            let mut design = Design::Rich;
            let (mut noise, mut make) = (Noise::Gaussian, Make::Usual);
            if part.starts_with("noise-") {
                noise = Noise::ALL[noisy % Noise::ALL.len()];
                noisy += 1;
                design = noisy_layout(noise, part == "noise-null", &mut rng);
                make = if rng.random_bool(1.0 / 3.0) {
                    Make::Thin
                } else {
                    Make::Usual
                };
            }
            let want = match part {
                // Which reading is off is the truth already where the noise has gross readings.
                "noise-single" if matches!(noise, Noise::OneGross | Noise::TwoGross) => {
                    let of: Vec<Kind> = catalogue
                        .iter()
                        .copied()
                        .filter(|k| *k != Kind::SlipOutliers)
                        .collect();
                    turn(&of).map_or(CaseKind::Null, |k| CaseKind::Effects(vec![k]))
                }
                "single" | "noise-single" => {
                    turn(&catalogue).map_or(CaseKind::Null, |k| CaseKind::Effects(vec![k]))
                }
                "pair" => pair(&catalogue, &mut rng),
                "confounded" => {
                    design = Design::Paper;
                    let of: Vec<Kind> = catalogue
                        .iter()
                        .copied()
                        .filter(|k| k.observable(false))
                        .collect();
                    pair(&of, &mut rng)
                }
                "unknown" => turn(&unknown).map_or(CaseKind::Null, |k| CaseKind::Effects(vec![k])),
                "paper" => {
                    design = Design::Paper;
                    let of: Vec<Kind> = catalogue
                        .iter()
                        .copied()
                        .filter(|k| k.observable(false))
                        .collect();
                    if rng.random_bool(0.3) {
                        CaseKind::Null
                    } else {
                        turn(&of).map_or(CaseKind::Null, |k| CaseKind::Effects(vec![k]))
                    }
                }
                "adversarial" => {
                    CaseKind::Adversarial(Tampering::ALL[(i / 15 + i) % Tampering::ALL.len()])
                }
                _ => CaseKind::Null,
            };
            let target_sigma = targets[rng.random_range(0..targets.len())];
            let seed = seed_of(seed, i);
            Order::Whisker(
                Request {
                    seed,
                    design,
                    want,
                    target_sigma,
                    rivals,
                },
                noise,
                make,
            )
        })
        .collect()
}

/// Kinds of a whisker's session that cameras look at, in turn.
const LOOKED_PARTS: [&str; 8] = [
    "single", "camera", "single", "null", "single", "pair", "camera", "single",
];

/// One approach-only session. Its content hangs on its place and seed alone, so that it is the same
/// with and without pictures.
fn looked_order(mix: &str, place: usize, of: &[Kind], seed: u64) -> Order {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x100c);
    let part = match mix {
        "nominals" => "nominal",
        "pictures-null" => "null",
        _ => LOOKED_PARTS[place % LOOKED_PARTS.len()],
    };
    let mut looked = PictureSetup {
        pictures: mix != "without-pictures",
        fault: Fault::None,
        straight_off_mm: 0.0,
    };
    let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
    let mut direction = |size: f64| {
        let v: [f64; 3] = [0; 3].map(|_| rng.sample::<f64, _>(StandardNormal));
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.map(|x| size * x / norm)
    };
    match part {
        "camera" => {
            looked.fault = match (place / 2) % 3 {
                0 => Fault::BoardScale(sign * 5e-3),
                1 => Fault::RigTag(direction(0.4)),
                _ => Fault::Moved(direction(0.2), 0.5),
            }
        }
        "nominal" => looked.straight_off_mm = sign * [0.5, 1.0, 2.0][place % 3],
        _ => {}
    }
    let want = match part {
        "single" => of
            .get((place * 7 + place / 8) % of.len().max(1))
            .map_or(CaseKind::Null, |k| CaseKind::Effects(vec![*k])),
        "pair" => pair(of, &mut rng),
        _ => CaseKind::Null,
    };
    let target_sigma = [8.0, 12.0, 20.0][rng.random_range(0..3_usize)];
    Order::PictureSetup(
        Request {
            seed,
            design: Design::Paper,
            want,
            target_sigma,
            rivals: false,
        },
        looked,
    )
}

/// Parts of the mix `all`, in turn.
const ALL_PARTS: [&str; 15] = [
    "null",
    "single",
    "noise-null",
    "pair",
    "single",
    "scalar-null",
    "unknown",
    "noise-single",
    "single",
    "paper",
    "noise-null",
    "adversarial",
    "single",
    "scalar-single",
    "noise-single",
];

fn seed_of(seed: u64, order: usize) -> u64 {
    seed.wrapping_mul(1_000_003).wrapping_add(order as u64)
}

/// A layout on which a kind of noise can be drawn: scatter of poses is asked for where poses are
/// read more than once.
fn noisy_layout(noise: Noise, null: bool, rng: &mut impl Rng) -> Design {
    let of: &[Design] = match (noise, null) {
        (Noise::Pose, _) => &[Design::Repeats, Design::Shuffled],
        (_, true) => &[
            Design::Rich,
            Design::Repeats,
            Design::Shuffled,
            Design::Staircase,
            Design::Paper,
        ],
        (_, false) => &[
            Design::Rich,
            Design::Repeats,
            Design::Shuffled,
            Design::Staircase,
        ],
    };
    of[rng.random_range(0..of.len())]
}

fn scalar_order(single: bool, turn: usize, seed: u64, rng: &mut impl Rng) -> ScalarRequest {
    let kinds = ScalarNoise::ALL.len();
    ScalarRequest {
        seed,
        axis: (turn / kinds) % 2 == 1,
        noise: ScalarNoise::ALL[turn % kinds],
        effect: single.then(|| ScalarEffect::ALL[rng.random_range(0..ScalarEffect::ALL.len())]),
        size: EffectSize::Noises([8.0, 12.0, 20.0, 40.0][rng.random_range(0..4_usize)]),
        layout: None,
        noise_seed: None,
    }
}

/// Two effects of different names.
fn pair(catalogue: &[Kind], rng: &mut impl Rng) -> CaseKind {
    for _ in 0..100 {
        let mut one = || {
            catalogue
                .get(rng.random_range(0..catalogue.len().max(1)))
                .copied()
        };
        let (Some(a), Some(b)) = (one(), one()) else {
            return CaseKind::Null;
        };
        if a.name().0 != b.name().0 && a != Kind::StageScale && b != Kind::StageScale {
            return CaseKind::Effects(vec![a, b]);
        }
    }
    CaseKind::Null
}
