//! Scratch space that threads borrow and give back, so that nothing is allocated anew from step to
//! step. Knows nothing of what it is used for: what a borrower finds in it must not change what the
//! borrower does.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// As many pieces of scratch space as were ever in use at the same time.
#[derive(Default)]
pub struct Pool<T>(Mutex<Vec<T>>);

impl<T: Default> Pool<T> {
    /// Calls `work` with a piece that nobody else uses meanwhile: one from an earlier call, or a
    /// new one.
    pub fn lend<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        let mut piece = self.free().pop().unwrap_or_default();
        let result = work(&mut piece);
        // Not reached where `work` panics: what such a piece holds nobody knows.
        self.free().push(piece);
        result
    }

    fn free(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_comes_back_unless_it_is_in_use() {
        let pool = Pool::<Vec<u8>>::default();
        pool.lend(|outer| {
            outer.push(1);
            pool.lend(|inner| assert!(inner.is_empty(), "the first piece is taken"));
        });
        assert_eq!(pool.free().len(), 2);
        assert_eq!(pool.lend(|piece| piece.len()), 1, "the last one given back");
    }
}
