// Adam for one number, with the constants of the CPU's; no kernel by itself.
struct Moments {
    value: f32,
    first: f32,
    second: f32,
}

fn descend(old: Moments, gradient: f32, rate: f32) -> Moments {
    let first = 0.9 * old.first + (1.0 - 0.9) * gradient;
    let second = 0.99 * old.second + (1.0 - 0.99) * gradient * gradient;
    return Moments(old.value - rate * first / (sqrt(second) + 1e-15), first, second);
}

// Whether the loss, by its bits, is a number: if not, nothing is learnt from it.
fn is_finite(loss: u32) -> bool {
    // WGSL lets compilers assume that no number is NaN or infinite, so that a comparison may be
    // dropped.
    return (loss & 0x7f800000u) != 0x7f800000u;
}
