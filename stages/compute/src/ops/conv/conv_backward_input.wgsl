// A is the weight [O, C, KH KW] turned: row c, column (o, ky, kx). B is the gradient: row (o, ky,
// kx), column (image, y, x) of the input.
fn factor_a(row: u32, k: u32) -> f32 {
    return a_at(k / (KH * KW) * p.a_depth + row * KH * KW + k % (KH * KW));
}

fn column_place(column: u32) -> vec4i {
    let pixel = column % p.pixels;
    return vec4i(
        i32(column / p.pixels * p.channels * p.out_height * p.out_width),
        i32(pixel / p.width + p.top),
        i32(pixel % p.width + p.left),
        0,
    );
}

fn factor_b(k: u32, place: vec4i) -> f32 {
    let y = place.y - i32(k / KW % KH);
    let x = place.z - i32(k % KW);
    // Where the stride passed over a place, no output saw it by this tap.
    if (y < 0 || x < 0 || u32(y) % p.stride != 0u || u32(x) % p.stride != 0u) {
        return 0.0;
    }
    let at = vec2u(u32(y), u32(x)) / p.stride;
    if (at.x >= p.out_height || at.y >= p.out_width) {
        return 0.0;
    }
    return b_at(u32(place.x) + (k / (KH * KW) * p.out_height + at.x) * p.out_width + at.y);
}
