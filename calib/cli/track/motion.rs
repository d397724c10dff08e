//! What is said of rows whose motion the network was never trained on, or that is not known.

use serde_json::{Value, json};
use wcal_track::motion_judge::MotionJudge;

/// For track.json: rows by what their motion is.
pub fn summary(judge: &MotionJudge) -> Value {
    json!({"rows": judge.untrained().values().sum::<u64>(), "by_motion": judge.untrained(), "assumed_rows": judge.assumed()})
}

/// The same for people.
pub fn say(judge: &MotionJudge, whose: &str, rows: u64) {
    let untrained = judge.untrained();
    if !untrained.is_empty() {
        let by: Vec<String> = untrained.iter().map(|(name, n)| format!("{name} {n}")).collect();
        eprintln!(
            "warning: {whose}{} of {rows} rows are contact in a motion that the model was never trained on ({}): their places are what the \
             moments alone tell, an arc of the wire; marked untrained-motion in status",
            untrained.values().sum::<u64>(),
            by.join(", ")
        );
    }
    if judge.assumed() > 0 {
        eprintln!(
            "warning: {whose}{} of {rows} rows are contact in a motion that is not known: their places assume one as in training (the base \
             along its +z past an object at rest), their regions hold for any; marked motion-assumed in status (--sweep vouches for the motion)",
            judge.assumed()
        );
    }
}
