// A step down for the hash entries that have a gradient; the others rest. Each counts its own
// steps, and the table that look-ups read holds the values rounded to halves. Moments have 16 bits
// each, as on the CPU. Clears the gradient.
@group(0) @binding(1) var<storage, read> stats: array<u32>;
@group(0) @binding(2) var<storage, read> corrections: array<f32>;
@group(0) @binding(3) var<storage, read_write> d_table: array<vec4u>;
@group(0) @binding(4) var<storage, read_write> values: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> first: array<u32>;
@group(0) @binding(6) var<storage, read_write> second: array<u32>;
@group(0) @binding(7) var<storage, read_write> steps: array<u32>;
@group(0) @binding(8) var<storage, read_write> table: array<u32>;

// A number of two words, the lower first, in units of 2^-52.
fn number(words: vec2u) -> f32 {
    let negative = words.y > 0x7fffffffu;
    let low = select(words.x, 0u - words.x, negative);
    let high = select(words.y, ~words.y + select(0u, 1u, words.x == 0u), negative);
    // 2^-20 and 2^-52.
    let size = f32(high) * 9.536743e-7 + f32(low) * 2.220446e-16;
    return select(size, -size, negative);
}

// The nearest half, to even; what is too large becomes the largest half.
fn narrow(x: f32) -> u32 {
    let size = min(abs(x), 65504.0);
    let bits = bitcast<u32>(size);
    // The biases of the exponents differ by 112, and a fraction loses 13 bits.
    let normal = ((bits + 0xfffu + (bits >> 13u & 1u)) >> 13u) - 0x1c000u;
    // Below 2^-14 a half's unit is 2^-24.
    let half = select(normal, u32(round(size * 16777216.0)), size < 6.1035156e-5);
    return half | (bitcast<u32>(x) >> 16u & 0x8000u);
}

// The upper bits of a number, rounded to the nearest, halfway to even.
fn upper(x: f32, dropped: u32) -> u32 {
    let bits = bitcast<u32>(x);
    return (bits + (1u << (dropped - 1u)) - 1u + (bits >> dropped & 1u)) >> dropped;
}

// Two of them in a word.
fn pack(x: f32, y: f32, dropped: u32) -> u32 {
    return upper(x, dropped) | upper(y, dropped) << 16u;
}

fn unpack(word: u32, dropped: u32) -> vec2f {
    return bitcast<vec2f>(vec2u(word & 0xffffu, word >> 16u) << vec2u(dropped));
}

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) t: u32,
) {
    let i = (group.y * groups.x + group.x) * 256u + t;
    if (i >= p.entries) {
        return;
    }
    let words = d_table[i];
    // Most entries: a step touches a small part of the table, and the gradient alone is a fifth of the bytes.
    if (all(words == vec4u())) {
        return;
    }
    // Cleared even where no step is taken: the next batch adds up from nothing.
    d_table[i] = vec4u();
    if (!is_finite(stats[0])) {
        return;
    }
    // Corrections are 1 from there on, and the CPU keeps the count in 16 bits.
    let count = min(steps[i] + 1u, p.corrected);
    steps[i] = count;
    let rate = p.rate * corrections[count - 1u];
    let mean = unpack(first[i], 16u);
    // A square has no sign, whose bit serves as one more of its fraction.
    let square = unpack(second[i], 15u);
    let x = descend(Moments(values[i].x, mean.x, square.x), number(words.xy), rate);
    let y = descend(Moments(values[i].y, mean.y, square.y), number(words.zw), rate);
    values[i] = vec2f(x.value, y.value);
    first[i] = pack(x.first, y.first, 16u);
    second[i] = pack(x.second, y.second, 15u);
    table[i] = narrow(x.value) | narrow(y.value) << 16u;
}
