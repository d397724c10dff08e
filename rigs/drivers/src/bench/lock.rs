//! Locks of the bench's threads.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The guard of a mutex, also where a thread panicked while it held it.
pub(super) fn guard<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A panicked server thread must not take the bench down.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
