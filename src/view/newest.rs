//! A place for one thing: a newer one takes the place of one that nobody has taken yet. Knows
//! nothing of what it holds.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// The newest of what was put there.
pub struct Newest<T> {
    place: Mutex<Place<T>>,
    changed: Condvar,
}

/// What is in the place.
enum Place<T> {
    /// Nothing.
    Empty,
    /// What nobody has taken yet.
    Waiting(T),
    /// Nothing, and nothing will be.
    Closed,
}

impl<T> Default for Newest<T> {
    fn default() -> Self {
        Self {
            place: Mutex::new(Place::Empty),
            changed: Condvar::new(),
        }
    }
}

impl<T> Newest<T> {
    /// Puts something there. What was waiting is dropped, and so is this once the place is closed.
    pub fn put(&self, thing: T) {
        let mut place = self.lock();
        if !matches!(*place, Place::Closed) {
            *place = Place::Waiting(thing);
        }
        // Only the painter takes, so waking one is enough.
        self.changed.notify_one();
    }

    /// Waits for something and takes it; `None` once the place is closed.
    pub fn take(&self) -> Option<T> {
        let is_empty = |place: &mut Place<T>| matches!(place, Place::Empty);
        let waited = self.changed.wait_while(self.lock(), is_empty);
        let mut place = waited.unwrap_or_else(PoisonError::into_inner);
        match std::mem::replace(&mut *place, Place::Empty) {
            Place::Waiting(thing) => Some(thing),
            Place::Empty | Place::Closed => {
                // Taking has emptied the place, and a closed one must stay closed.
                *place = Place::Closed;
                None
            }
        }
    }

    /// Whether taking would not wait.
    pub fn has_news(&self) -> bool {
        !matches!(*self.lock(), Place::Empty)
    }

    /// Drops what is waiting, and takes nothing more.
    pub fn close(&self) {
        *self.lock() = Place::Closed;
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, Place<T>> {
        // Every change is one assignment, so a thread that panicked has left the place whole.
        self.place.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_thing_is_taken_and_what_it_replaced_is_dropped() {
        let place = Newest::default();
        let old = std::sync::Arc::new(1);
        place.put(old.clone());
        place.put(std::sync::Arc::new(2));
        assert_eq!(std::sync::Arc::strong_count(&old), 1, "dropped");
        assert!(place.has_news());
        assert_eq!(place.take().as_deref(), Some(&2));
        assert!(!place.has_news());
    }

    #[test]
    fn whoever_waits_gets_what_comes_and_then_the_end() {
        let place = Newest::default();
        std::thread::scope(|scope| {
            let taker = scope.spawn(|| [place.take(), place.take()]);
            place.put(3);
            while place.has_news() {
                std::thread::yield_now();
            }
            place.close();
            assert_eq!(taker.join().unwrap(), [Some(3), None]);
        });
        place.put(4);
        assert_eq!(place.take(), None, "closed for good");
    }
}
