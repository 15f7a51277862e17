// Functions of single numbers; no kernel by itself. Exponents are kept from overflow, since a driver
// may take it that no number is infinite.

// By its bits: a driver may as well take it that each number equals itself.
fn is_nan(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7fffffffu) > 0x7f800000u;
}

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(min(-x, 87.0)));
}

fn silu(x: f32) -> f32 {
    return x * sigmoid(x);
}

fn silu_slope(x: f32) -> f32 {
    let s = sigmoid(x);
    return s * (1.0 + x * (1.0 - s));
}

// The error function: the same fits as on the CPU, a polynomial in x^2 below 1 and 1 - exp(-x^2)
// p(2 / (2 + x)) above.
fn erf(x: f32) -> f32 {
    let size = abs(x);
    let s = size * size;
    let near = size * (((((((-9.67359e-6 * s + 1.1268254e-4) * s - 8.484396e-4) * s + 5.2210535e-3)
        * s - 2.6865438e-2) * s + 0.11283783) * s - 0.37612638) * s + 1.1283792);
    let t = 2.0 / (2.0 + size);
    let p = ((((((((-1.133854e-2 * t - 2.8195934e-2) * t + 0.2684886) * t - 0.52453876) * t
        + 0.34704587) * t - 7.931277e-2) * t + 0.22503269) * t + 0.2376412) * t + 0.2830955) * t
        + 0.2820467;
    let far = 1.0 - exp(max(-s, -87.0)) * t * p;
    return select(far, near, size < 1.0) * sign(x);
}

fn normal_cdf(x: f32) -> f32 {
    return 0.5 + 0.5 * erf(x * 0.70710678);
}

fn gelu_slope(x: f32) -> f32 {
    return normal_cdf(x) + x * 0.3989423 * exp(max(-0.5 * x * x, -87.0));
}

fn quick_gelu_slope(x: f32) -> f32 {
    let s = sigmoid(1.702 * x);
    return s * (1.0 + 1.702 * x * (1.0 - s));
}
