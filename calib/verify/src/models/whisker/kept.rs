//! Results by key, all forgotten where there are too many: refits visit hundreds of parameter
//! values, and only a short memory is of use.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex};

/// At most `most` results.
pub(super) struct Kept<K, V> {
    most: usize,
    by_key: Mutex<HashMap<K, Arc<V>>>,
}

impl<K: Eq + Hash, V> Kept<K, V> {
    pub(super) fn at_most(most: usize) -> Self {
        Self {
            most,
            by_key: Mutex::default(),
        }
    }

    /// The result for `key`, made where it is not kept; none where it cannot be made.
    pub(super) fn get(&self, key: K, make: impl FnOnce() -> Option<V>) -> Option<Arc<V>> {
        if let Some(found) = self.by_key.lock().ok()?.get(&key) {
            return Some(found.clone());
        }
        let made = Arc::new(make()?);
        let mut kept = self.by_key.lock().ok()?;
        if kept.len() >= self.most {
            kept.clear();
        }
        kept.insert(key, made.clone());
        Some(made)
    }
}
