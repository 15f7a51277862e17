// Real spherical harmonics up to degree 3 of a unit vector; no kernel by itself.
fn harmonics(d: vec3f) -> array<f32, 16> {
    let xx = d.x * d.x;
    let yy = d.y * d.y;
    let zz = d.z * d.z;
    return array<f32, 16>(
        0.2820948,
        -0.48860252 * d.y,
        0.48860252 * d.z,
        -0.48860252 * d.x,
        1.0925485 * d.x * d.y,
        -1.0925485 * d.y * d.z,
        0.31539157 * (3.0 * zz - 1.0),
        -1.0925485 * d.x * d.z,
        0.54627424 * (xx - yy),
        -0.5900436 * d.y * (3.0 * xx - yy),
        2.8906114 * d.x * d.y * d.z,
        -0.4570458 * d.y * (5.0 * zz - 1.0),
        0.37317634 * d.z * (5.0 * zz - 3.0),
        -0.4570458 * d.x * (5.0 * zz - 1.0),
        1.4453057 * d.z * (xx - yy),
        -0.5900436 * d.x * (xx - 3.0 * yy),
    );
}
