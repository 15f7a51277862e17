//! The extents of one attention, and which keys a query sees. They know no values.

/// The extents of one attention.
#[derive(Clone, Copy, Debug)]
pub struct Extents {
    pub batch: usize,
    pub queries: usize,
    pub keys: usize,
    pub heads: usize,
    /// Features of one head.
    pub depth: usize,
    pub causal: bool,
}

impl Extents {
    /// Features of all heads.
    pub fn width(&self) -> usize {
        self.heads * self.depth
    }

    /// What scores are multiplied by.
    pub fn scale(&self) -> f32 {
        1.0 / (self.depth as f32).sqrt()
    }

    /// How many of the `keys` from `first` on the query may see.
    pub fn visible(&self, query: usize, first: usize, keys: usize) -> usize {
        if self.causal {
            (query + 1).saturating_sub(first).min(keys)
        } else {
            keys
        }
    }
}
