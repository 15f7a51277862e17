// A is the gradient: row o, column (image, y, x). B is the images: row (image, y, x), column (c,
// ky, kx).
fn factor_a(row: u32, k: u32) -> f32 {
    let pixels = p.out_height * p.out_width;
    return a_at((k / pixels * p.rows + row) * pixels + k % pixels);
}

fn column_place(column: u32) -> vec4i {
    return vec4i(
        i32(column / (KH * KW) * p.height * p.width),
        i32(column / KW % KH) - i32(p.top),
        i32(column % KW) - i32(p.left),
        0,
    );
}

fn factor_b(k: u32, place: vec4i) -> f32 {
    let pixels = p.out_height * p.out_width;
    let pixel = k % pixels;
    let y = i32(pixel / p.out_width * p.stride) + place.y;
    let x = i32(pixel % p.out_width * p.stride) + place.z;
    if (y < 0 || x < 0 || y >= i32(p.height) || x >= i32(p.width)) {
        return 0.0;
    }
    let image = k / pixels * p.channels * p.height * p.width;
    return b_at(image + u32(place.x) + u32(y) * p.width + u32(x));
}
