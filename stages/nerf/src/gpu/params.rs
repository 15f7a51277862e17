//! What the kernels are told, besides their arrays. Knows nothing of who tells them.

use compute::kernels::params;

params! {
    /// A pass of rays, the same for all kernels that follow them.
    pub struct Pass {
        /// Rays of this pass.
        rays: u32,
        /// The first of them among all.
        first: u32,
        /// Levels of the hash grid.
        levels: u32,
        /// The shortest step, and its growth with distance.
        shortest: f32,
        cone: f32,
        /// Occupancy cells per unit of length, and along the axes.
        resolution: f32,
        size_x: u32,
        size_y: u32,
        size_z: u32,
        /// In training, pixels of the whole batch.
        pixels: u32,
        /// Where the loss turns from squared to absolute.
        beta: f32,
        /// The strengths of the regularisers.
        distortion: f32,
        fog: f32,
        fog_range: f32,
    }
}

params! {
    /// Counts to sum: `len` of them from `first` on.
    pub struct Span {
        len: u32,
        first: u32,
    }
}

params! {
    /// A batch that has come to something.
    pub struct Outcome {
        rays: u32,
        pixels: u32,
    }
}

params! {
    /// A step of Adam of the networks.
    pub struct NetworkStep {
        /// Parts of the gradient.
        parts: u32,
        rate: f32,
        l2: f32,
    }
}

params! {
    /// A step of Adam of the table.
    pub struct TableStep {
        entries: u32,
        rate: f32,
        /// Steps whose bias is corrected.
        corrected: u32,
    }
}

params! {
    /// A draw of cells from a set.
    pub struct Draw {
        /// Words of the set.
        words: u32,
        /// The step of the random numbers.
        step: u32,
        /// Tells the draws from different sets apart.
        part: u32,
        key_low: u32,
        key_high: u32,
    }
}

params! {
    /// An update of the occupancy grid.
    pub struct Update {
        /// Words of a set of cells.
        words: u32,
        /// Levels of the hash grid.
        levels: u32,
        /// The step of the random numbers.
        step: u32,
        key_low: u32,
        key_high: u32,
        /// What a cell keeps of its value.
        decay: f32,
        /// The length of a sample.
        shortest: f32,
        /// Cells per unit of length, and along two axes.
        resolution: f32,
        size_x: u32,
        size_y: u32,
    }
}

params! {
    /// How many cells the grid has.
    pub struct Cells {
        cells: u32,
    }
}
