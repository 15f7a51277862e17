// Rays; no kernel by itself. Needs `rays`, of which each has four vectors: origin and start,
// direction and end, jitter and more, direction in the world.
fn stride(t: f32) -> f32 {
    // Far from the origin a step must still be more than rounding, or the march would stand still.
    return max(max(t * p.cone, p.shortest), t * 1e-6);
}

fn start_of(ray: u32) -> f32 {
    let start = rays[4u * ray].w;
    return start + rays[4u * ray + 2u].x * stride(start);
}

// Rounding may put a point just below the box, where the grid has no cells.
fn point_at(ray: u32, t: f32) -> vec3f {
    return max(rays[4u * ray].xyz + t * rays[4u * ray + 1u].xyz, vec3f());
}
