// Philox4x32-10, the same numbers as on the CPU; no kernel by itself.
fn high_of_product(a: u32, b: u32) -> u32 {
    // WGSL has no numbers of 64 bits: the product goes by halves of 16, none of whose sums runs
    // over.
    let low = (a & 0xffffu) * (b & 0xffffu);
    let left = (a >> 16u) * (b & 0xffffu) + (low >> 16u);
    let right = (a & 0xffffu) * (b >> 16u) + (left & 0xffffu);
    return (a >> 16u) * (b >> 16u) + (left >> 16u) + (right >> 16u);
}

fn draw(step: u32, element: vec2u, first_key: vec2u) -> vec4u {
    var counter = vec4u(element, step, 0u);
    var key = first_key;
    for (var round = 0u; round < 10u; round++) {
        // Multipliers and key increments are those of Salmon et al. 2011.
        let a = vec2u(high_of_product(0xD2511F53u, counter.x), 0xD2511F53u * counter.x);
        let b = vec2u(high_of_product(0xCD9E8D57u, counter.z), 0xCD9E8D57u * counter.z);
        counter = vec4u(b.x ^ counter.y ^ key.x, b.y, a.x ^ counter.w ^ key.y, a.y);
        key += vec2u(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

// Four numbers, uniform in [0, 1).
fn uniform_numbers(step: u32, element: vec2u, key: vec2u) -> vec4f {
    // 24 bits, as many as an f32 holds exactly.
    return vec4f(draw(step, element, key) >> vec4u(8u)) / 16777216.0;
}

// Uniform in 0..n.
fn below(step: u32, element: vec2u, n: u32, key: vec2u) -> u32 {
    let bits = draw(step, element, key);
    // This is (2^32 x + y) n / 2^64, rounded down: the carry from the middle words counts.
    let low = bits.x * n;
    let sum = low + high_of_product(bits.y, n);
    return high_of_product(bits.x, n) + select(0u, 1u, sum < low);
}
