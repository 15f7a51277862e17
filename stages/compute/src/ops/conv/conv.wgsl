// A is the weight [O, C KH KW]; B the images as the kernel meets them: row (c, ky, kx), column
// (image, y, x).
fn factor_a(row: u32, k: u32) -> f32 {
    return a_at(row * p.a_row + k);
}

// Where an output pixel's window begins: its image's offset, and the first row and column, which
// may lie outside.
fn column_place(column: u32) -> vec4i {
    let pixel = column % p.pixels;
    return vec4i(
        i32(column / p.pixels * p.channels * p.height * p.width),
        i32(pixel / p.out_width * p.stride) - i32(p.top),
        i32(pixel % p.out_width * p.stride) - i32(p.left),
        0,
    );
}

fn factor_b(k: u32, place: vec4i) -> f32 {
    let y = place.y + i32(k / KW % KH);
    let x = place.z + i32(k % KW);
    if (y < 0 || x < 0 || y >= i32(p.height) || x >= i32(p.width)) {
        return 0.0;
    }
    return b_at(u32(place.x) + (k / (KH * KW) * p.height + u32(y)) * p.width + u32(x));
}
