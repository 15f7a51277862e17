// Steps along rays, over empty cells; no kernel by itself. Needs `rays` and `bits`, the occupied
// cells.
struct Step {
    middle: f32,
    // 0 past the ray's end.
    length: f32,
    next: f32,
}

fn is_occupied(cell: vec3u) -> bool {
    let i = (cell.z * p.size_y + cell.y) * p.size_x + cell.x;
    return (bits[i / 32u] >> (i % 32u) & 1u) == 1u;
}

// The distance at which a ray leaves a cell.
fn exit_of(origin: vec3f, direction: vec3f, cell: vec3u) -> f32 {
    let face = (vec3f(cell) + select(vec3f(), vec3f(1.0), direction > vec3f())) / p.resolution;
    // Along a face a ray leaves by another one; 3e38 stands for infinity, which WGSL cannot write.
    let leave = select((face - origin) / direction, vec3f(3e38), direction == vec3f());
    return min(leave.x, min(leave.y, leave.z));
}

// The first step from `t` on that ends up in an occupied cell.
fn step_from(ray: u32, from_t: f32) -> Step {
    let origin = rays[4u * ray].xyz;
    let direction = rays[4u * ray + 1u].xyz;
    let end = rays[4u * ray + 1u].w;
    let last = vec3u(p.size_x, p.size_y, p.size_z) - 1u;
    var t = from_t;
    while (t < end) {
        let length = stride(t);
        let middle = t + 0.5 * length;
        // Rounding may put the middle just outside of the box, where the grid has no cells.
        let cell = min(vec3u(max((origin + middle * direction) * p.resolution, vec3f())), last);
        t += length;
        if (is_occupied(cell)) {
            return Step(middle, length, t);
        }
        // Whole steps, so that a cell that falls empty does not shift the samples behind it.
        let exit = min(exit_of(origin, direction, cell), end);
        while (t + 0.5 * stride(t) < exit) {
            t += stride(t);
        }
    }
    return Step(0.0, 0.0, t);
}
