//! Memory for values. Large buffers that are done with are kept for the next ones, since fresh
//! pages cost as much as filling them does. It knows sizes, not what the values mean.

use std::collections::VecDeque;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Buffers of fewer elements are left to the allocator.
const SMALLEST: usize = 1 << 14;
/// Elements kept in all: 128 MiB.
const LIMIT: usize = 1 << 25;

/// Elements of a cache line. Vectors that lie across two lines are read and written at half the
/// speed.
const ALIGNMENT: usize = 16;

/// Values in host memory; those of kernels' results begin with a cache line.
pub struct HostBuffer {
    /// At least `start + len` of them.
    values: Vec<f32>,
    start: usize,
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
            // The latest is likeliest to be in the cache still. A much longer one would waste what
            // the pool may hold.
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
        // The oldest go first: their size is the least likely to be asked for again.
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

impl HostBuffer {
    /// Room for `len` values, which are whatever they were: for kernels that write every one of
    /// them.
    pub fn uninitialised(len: usize) -> HostBuffer {
        // The allocator promises no cache line, so there is room to begin at one.
        let room = len + ALIGNMENT - 1;
        let kept = if len < SMALLEST {
            None
        } else {
            pool().take(room)
        };
        HostBuffer::aligned(kept.unwrap_or_else(|| vec![0.0; room]), len)
    }

    /// The first `len` of `values` that begin with a cache line.
    fn aligned(values: Vec<f32>, len: usize) -> HostBuffer {
        let line = ALIGNMENT * size_of::<f32>();
        let beyond = values.as_ptr().addr() % line;
        let start = (line - beyond) % line / size_of::<f32>();
        HostBuffer { values, start, len }
    }

    /// A buffer of `len` zeros, which begins with a cache line.
    pub fn zeros(len: usize) -> HostBuffer {
        // `vec!` asks for zeroed memory, so that nothing is filled twice.
        if len < SMALLEST {
            return HostBuffer::aligned(vec![0.0; len + ALIGNMENT - 1], len);
        }
        let mut buffer = HostBuffer::uninitialised(len);
        buffer.fill(0.0);
        buffer
    }
}

impl Drop for HostBuffer {
    fn drop(&mut self) {
        // A buffer of more than half of the pool would push all others out.
        if (SMALLEST..=LIMIT / 2).contains(&self.values.len()) {
            // Freed once the pool is unlocked: giving large memory back to the system takes long.
            let surplus = pool().put(std::mem::take(&mut self.values));
            drop(surplus);
        }
    }
}

impl From<Vec<f32>> for HostBuffer {
    fn from(values: Vec<f32>) -> HostBuffer {
        HostBuffer {
            len: values.len(),
            start: 0,
            values,
        }
    }
}

impl Clone for HostBuffer {
    fn clone(&self) -> HostBuffer {
        let mut copy = HostBuffer::uninitialised(self.len);
        copy.copy_from_slice(self);
        copy
    }
}

impl Deref for HostBuffer {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.values[self.start..self.start + self.len]
    }
}

impl DerefMut for HostBuffer {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.start..self.start + self.len]
    }
}

impl fmt::Debug for HostBuffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HostBuffer of {}", self.len)
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
    fn results_begin_with_a_cache_line() {
        for len in [0, 1, 100, SMALLEST, SMALLEST + 7] {
            for buffer in [HostBuffer::uninitialised(len), HostBuffer::zeros(len)] {
                assert_eq!((buffer.as_ptr().addr() % 64, buffer.len()), (0, len));
            }
        }
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
