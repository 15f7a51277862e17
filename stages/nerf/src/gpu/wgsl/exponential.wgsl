// exp, by the same series as on the CPU, and what is made of it; no kernel by itself.
fn exponential(x: f32) -> f32 {
    let y = clamp(x, -87.0, 88.0);
    let n = round(y * 1.44269504);
    let r = (y - n * 0.6933594) - n * -2.1219444e-4;
    let tail = 0.041666668 + r * (0.008333334 + r * (0.0013888889 + r * 1.984127e-4));
    let series = 1.0 + r * (1.0 + r * (0.5 + r * (0.16666667 + r * tail)));
    // 2^n, by its exponent's bits: the clamp keeps them within 1 to 254.
    return series * bitcast<f32>(u32(i32(n) + 127) << 23u);
}

fn logistic(x: f32) -> f32 {
    return 1.0 / (1.0 + exponential(-x));
}

// The density of a raw output of the network, and its derivative, held back where it would explode.
fn density_of(raw: f32) -> f32 {
    return exponential(raw - 1.0);
}

fn density_slope(raw: f32) -> f32 {
    // The derivative of exp is exp itself.
    return exponential(min(raw - 1.0, 15.0));
}
