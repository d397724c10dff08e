//! How far a search is, for whoever waits.

use std::sync::OnceLock;

/// Hears how far a search is: name of the stage, and the part of it that is done.
type Heard = Box<dyn Fn(&str, f64) + Send + Sync>;
static HEARD: OnceLock<Heard> = OnceLock::new();

/// Names who hears, for this process; the first one stays.
pub fn on_progress(heard: impl Fn(&str, f64) + Send + Sync + 'static) {
    let _ = HEARD.set(Box::new(heard));
}

/// Tells how far a stage is.
pub fn progress(stage: &str, done: f64) {
    if let Some(heard) = HEARD.get() {
        heard(stage, done);
    }
}
