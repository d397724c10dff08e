//! What is said of rows whose motion the network was never trained on, or that is not known, and of rows with several contacts.

use serde_json::{Value, json};
use wcal_contact::motion_judge::MotionJudge;

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

/// For track.json: rows with a probability of several contacts, and those at which several are more probable than one.
pub fn several_summary([rows, probable]: [u64; 2]) -> Value {
    json!({"rows": rows, "probable_rows": probable})
}

/// The same for people, where there is anything to say.
pub fn say_several(whose: &str, [rows, probable]: [u64; 2]) {
    if probable > 0 {
        eprintln!(
            "{whose}at {probable} of {rows} rows in contact several contacts are more probable than one (several_probability above 0.5): the \
             places of the further ones are not estimated"
        );
    }
}
