//! Order books: which sessions an exam draws.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::adversarial::Trick;
use crate::effects::Kind;
use crate::layout::Design;
use crate::session::{Request, Want};

/// A varied order book: `mix` is one of `null`, `single`, `pair`, `unknown`, `paper`, `confounded` (pairs on
/// approach-only sessions), `adversarial`, `all`.
///
/// `only` keeps one effect identifier. Orders repeat the same for the same seed.
pub fn orders(mix: &str, draws: usize, seed: u64, only: Option<&str>, rivals: bool) -> Vec<Request> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let kinds: Vec<Kind> = crate::effects::ALL
        .into_iter()
        .filter(|k| only.is_none_or(|o| k.name().0 == o || k.name().1 == o))
        .collect();
    let catalogue: Vec<Kind> = kinds.iter().copied().filter(|k| !k.is_unknown()).collect();
    let unknown: Vec<Kind> = kinds.iter().copied().filter(|k| k.is_unknown()).collect();
    let targets = [8.0, 12.0, 20.0, 40.0];
    let (mut walked, offset) = (0, rng.random_range(0..50_usize));
    (0..draws)
        .map(|i| {
            let part = match mix {
                "all" => [
                    "null",
                    "single",
                    "single",
                    "pair",
                    "single",
                    "unknown",
                    "null",
                    "single",
                    "paper",
                    "adversarial",
                ][i % 10],
                one => one,
            };
            // Walk through the laws by turns (a stride prime to their number), so that few draws see many of them.
            let mut turn = |of: &[Kind]| -> Option<Kind> {
                walked += 1;
                of.get((walked * 7 + offset) % of.len().max(1)).copied()
            };
            let mut design = Design::Rich;
            let want = match part {
                "single" => turn(&catalogue).map_or(Want::Null, |k| Want::Effects(vec![k])),
                "pair" => pair(&catalogue, &mut rng),
                "confounded" => {
                    design = Design::Paper;
                    let of: Vec<Kind> = catalogue.iter().copied().filter(|k| k.observable(false)).collect();
                    pair(&of, &mut rng)
                }
                "unknown" => turn(&unknown).map_or(Want::Null, |k| Want::Effects(vec![k])),
                "paper" => {
                    design = Design::Paper;
                    let of: Vec<Kind> = catalogue.iter().copied().filter(|k| k.observable(false)).collect();
                    if rng.random_bool(0.3) {
                        Want::Null
                    } else {
                        turn(&of).map_or(Want::Null, |k| Want::Effects(vec![k]))
                    }
                }
                "adversarial" => Want::Adversarial(Trick::ALL[(i / 10 + i) % Trick::ALL.len()]),
                _ => Want::Null,
            };
            let target_sigma = targets[rng.random_range(0..targets.len())];
            Request {
                seed: seed.wrapping_mul(1_000_003).wrapping_add(i as u64),
                design,
                want,
                target_sigma,
                rivals,
            }
        })
        .collect()
}

/// Two effects of different names.
fn pair(catalogue: &[Kind], rng: &mut impl Rng) -> Want {
    for _ in 0..100 {
        let mut one = || catalogue.get(rng.random_range(0..catalogue.len().max(1))).copied();
        let (Some(a), Some(b)) = (one(), one()) else { return Want::Null };
        if a.name().0 != b.name().0 && a != Kind::StageScale && b != Kind::StageScale {
            return Want::Effects(vec![a, b]);
        }
    }
    Want::Null
}
