// What the kernels that follow rays are told, the same for all of them.
struct Params {
    // Rays of this pass, and the first of them among all.
    rays: u32,
    first: u32,
    levels: u32,
    // Marching: the shortest step and its growth with distance; occupancy cells per unit of length and along the axes.
    shortest: f32,
    cone: f32,
    resolution: f32,
    size_x: u32,
    size_y: u32,
    size_z: u32,
    // Pixels of the whole batch, where the loss turns from squared to absolute, and the regularisers.
    pixels: u32,
    beta: f32,
    distortion: f32,
    fog: f32,
    fog_range: f32,
}

@group(0) @binding(0) var<uniform> p: Params;
