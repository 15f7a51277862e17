// Factors that lie in memory as matrices.
fn factor_a(row: u32, k: u32) -> f32 {
    return a_at(row * p.a_row + k * p.a_depth);
}

fn column_place(column: u32) -> vec4i {
    return vec4i(i32(column * p.b_column), 0, 0, 0);
}

fn factor_b(k: u32, place: vec4i) -> f32 {
    return b_at(u32(place.x) + k * p.b_depth);
}
