//! The exam: draws sessions, has `wcal verify` judge them, and scores the answers against what was
//! put in.

mod check_statements;
mod goal;
mod map_statements;
pub mod orders;
mod pictures;
mod run;
mod score;
pub mod statements;
pub mod stereo_statements;
mod summary;
pub mod tracked_statements;
mod whisker_statements;

pub use orders::{Order, orders};
pub use run::{Examiner, Paper, answer};
pub use score::{FollowUp, Kind as Mark, Outcome, Part, score, score_scalar};
pub use summary::{Goal, NoiseRow, by_noise, clopper_pearson, summarise};
