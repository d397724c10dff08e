//! The sweeps that a tracker is trained on where none are given: three kinds, each drawn from a
//! seed of its own. All of them are SIMULATED.
//!
//! - `clean`: turned at random, without friction, weight or medium; the only kind that objects are
//!   held out of and scored on
//! - `friction`: turned at random, friction 0 to 0.3, the wire's weight, and the drag of air
//! - `upright`: as `clean`, upright in four faces a quarter turn apart; a quarter as many, since
//!   only plane and gap are left to draw

use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_lab_sweeps::{SweepPlan, Turn};

/// Coefficients of friction.
const FRICTION: [f64; 2] = [0.0, 0.3];
/// Samples a second.
const RATE_HZ: f64 = 10.0;
/// From the seed of one kind to that of the next: the same seed would draw the same turns and gaps.
const SEED_STEP: u64 = 10;

/// A kind of sweeps.
#[derive(Debug, Clone, PartialEq)]
pub struct SweepKind {
    /// Name of its folder.
    pub name: &'static str,
    /// How its sweeps are drawn.
    pub plan: SweepPlan,
    /// Sweeps over an object.
    pub sweeps: u64,
    /// Seed of its draws.
    pub seed: u64,
}

/// Sweeps turned at random, with friction, weight and the drag of air.
pub fn friction_plan() -> SweepPlan {
    let physics = PhysicsPlan {
        friction: FRICTION,
        medium: Medium::Air,
        weight: true,
        ..PhysicsPlan::default()
    };
    SweepPlan {
        physics,
        ..clean_plan()
    }
}

fn clean_plan() -> SweepPlan {
    SweepPlan {
        rate_hz: RATE_HZ,
        ..SweepPlan::default()
    }
}

/// The three kinds, `clean` first, with so many sweeps over an object in each of the first two.
pub fn sweep_kinds(sweeps: u64, seed: u64) -> [SweepKind; 3] {
    let upright = SweepPlan {
        turn: Turn::Faces,
        ..clean_plan()
    };
    let kind = |name, plan, sweeps, number: u64| {
        let seed = seed.wrapping_add(SEED_STEP * number);
        SweepKind {
            name,
            plan,
            sweeps,
            seed,
        }
    };
    [
        kind("clean", clean_plan(), sweeps, 0),
        kind("friction", friction_plan(), sweeps, 1),
        kind("upright", upright, sweeps.div_ceil(4), 2),
    ]
}
