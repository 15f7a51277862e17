//! The hash-grid radiance field: occupancy, marching, compositing, training, rendering.
