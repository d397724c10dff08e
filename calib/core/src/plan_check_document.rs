//! Which effects a plan can distinguish, as `wcal stage-sweep --dry-run` prints it.

use schemars::JsonSchema;
use serde::Serialize;

/// What a plan can say of an effect.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PlannedEffect {
    /// Effect.
    pub id: String,
    /// `testable`, `absorbed` or `not-observable`.
    pub status: String,
    /// Why it cannot be seen, or what remains of its signature.
    pub why: String,
    /// Effects that imitate it at every shape: not to be distinguished from it on this plan.
    pub never_apart: Vec<String>,
    /// Effects that imitate it at some shapes.
    pub sometimes_alike: Vec<String>,
}

/// Something that could be added to the plan, and what it would do.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Addition {
    /// What.
    pub what: String,
    /// Effects that become testable by it.
    pub testable: Vec<String>,
    /// Pairs that it distinguishes.
    pub separates: Vec<[String; 2]>,
}

/// The answer for a plan.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct PlanCheck {
    /// Every effect of the catalogue.
    pub effects: Vec<PlannedEffect>,
    /// Additions that would help, the most helpful first.
    pub additions: Vec<Addition>,
}

impl PlanCheck {
    /// One line an effect, one line an addition.
    pub fn text(&self) -> String {
        let mut out = String::new();
        for e in &self.effects {
            out += &format!("{:<24}{:<16}{}", e.id, e.status, e.why);
            if !e.never_apart.is_empty() {
                out += &format!("; never distinguished from {}", e.never_apart.join(", "));
            }
            if !e.sometimes_alike.is_empty() {
                out += &format!("; at some shapes like {}", e.sometimes_alike.join(", "));
            }
            out.push('\n');
        }
        for a in &self.additions {
            let pairs: Vec<String> = a.separates.iter().map(|p| p.join(" from ")).collect();
            let mut gains = Vec::new();
            if !pairs.is_empty() {
                gains.push(format!("distinguishes {}", pairs.join(", ")));
            }
            if !a.testable.is_empty() {
                gains.push(format!("shows {}", a.testable.join(", ")));
            }
            out += &format!("with {}: {}\n", a.what, gains.join("; "));
        }
        out
    }
}
