//! Memory for values. Large buffers that are done with are kept for the next ones, since fresh pages cost as much as
//! filling them does. It knows sizes, not what the values mean.

use std::collections::VecDeque;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Buffers of fewer elements are left to the allocator.
const SMALLEST: usize = 1 << 14;
/// Elements kept in all: 128 MiB.
const LIMIT: usize = 1 << 25;

/// Values in host memory.
pub struct Buffer {
    /// At least `len` of them.
    values: Vec<f32>,
    len: usize,
}

/// Buffers without an owner, the latest last.
struct Pool {
    kept: VecDeque<Vec<f32>>,
    elements: usize,
}

static POOL: Mutex<Pool> = Mutex::new(Pool {
    kept: VecDeque::new(),
    elements: 0,
});

fn pool() -> MutexGuard<'static, Pool> {
    POOL.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Pool {
    /// The latest buffer that has room for `len` elements and not many more.
    fn take(&mut self, len: usize) -> Option<Vec<f32>> {
        let place = self
            .kept
            .iter()
            .rposition(|values| (len..=len + len / 4).contains(&values.len()))?;
        let values = self.kept.remove(place)?;
        self.elements -= values.len();
        Some(values)
    }

    /// Keeps `values`; what no longer fits is returned, to be freed once the pool is unlocked.
    fn put(&mut self, values: Vec<f32>) -> Vec<Vec<f32>> {
        self.elements += values.len();
        self.kept.push_back(values);
        let mut surplus = Vec::new();
        while self.elements > LIMIT {
            let Some(oldest) = self.kept.pop_front() else {
                break;
            };
            self.elements -= oldest.len();
            surplus.push(oldest);
        }
        surplus
    }
}

impl Buffer {
    /// Room for `len` values, which are whatever they were: for kernels that write every one of them.
    pub fn stale(len: usize) -> Buffer {
        let kept = if len < SMALLEST {
            None
        } else {
            pool().take(len)
        };
        Buffer {
            values: kept.unwrap_or_else(|| vec![0.0; len]),
            len,
        }
    }

    /// `len` zeros.
    pub fn zeros(len: usize) -> Buffer {
        if len < SMALLEST {
            return vec![0.0; len].into();
        }
        let mut buffer = Buffer::stale(len);
        buffer.fill(0.0);
        buffer
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if (SMALLEST..=LIMIT / 2).contains(&self.values.len()) {
            let surplus = pool().put(std::mem::take(&mut self.values));
            drop(surplus);
        }
    }
}

impl From<Vec<f32>> for Buffer {
    fn from(values: Vec<f32>) -> Buffer {
        Buffer {
            len: values.len(),
            values,
        }
    }
}

impl Clone for Buffer {
    fn clone(&self) -> Buffer {
        let mut copy = Buffer::stale(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for Buffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values[..self.len]
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[..self.len]
    }
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Buffer of {}", self.len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dropped_buffer_serves_the_next_of_about_its_size() {
        let mut pool = Pool {
            kept: VecDeque::new(),
            elements: 0,
        };
        assert!(pool.put(vec![1.0; 100]).is_empty() && pool.put(vec![2.0; 50]).is_empty());
        assert_eq!(pool.take(101), None);
        assert_eq!(
            pool.take(70),
            None,
            "a buffer much too large is left for others"
        );
        assert_eq!(pool.take(90), Some(vec![1.0; 100]));
        assert_eq!((pool.take(90), pool.elements), (None, 50));
    }

    #[test]
    fn the_pool_is_bounded_and_frees_the_oldest_first() {
        let mut pool = Pool {
            kept: VecDeque::new(),
            elements: 0,
        };
        assert!(
            pool.put(vec![0.0; LIMIT / 2]).is_empty() && pool.put(vec![0.0; LIMIT / 4]).is_empty()
        );
        let surplus = pool.put(vec![0.0; LIMIT / 2]);
        assert_eq!(
            (surplus.len(), surplus[0].len(), pool.elements),
            (1, LIMIT / 2, LIMIT / 4 + LIMIT / 2)
        );
    }
}
