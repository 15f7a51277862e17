// The hash grid and the layers of the networks; no kernel by itself. Needs `levels`, `table` (a
// pair of halves per entry) and `weights` (all matrices as [inputs, outputs], then all again as
// [outputs, inputs]).
//
// A tile holds rows of features by quads of samples: number quad * ROWS + row. An invocation
// computes one column of a layer for every (SIZE / columns)-th quad, so that neighbours read
// neighbouring weights and the same activations.
struct Level {
    scale: f32,
    nx: u32,
    ny: u32,
    dense: u32,
    entries: u32,
    offset: u32,
}

struct Place {
    cell: vec3u,
    fraction: vec3f,
}

fn place_of(level: Level, position: vec3f) -> Place {
    // Half a cell's shift staggers the levels.
    let x = position * level.scale + 0.5;
    let cell = vec3u(x);
    return Place(cell, x - vec3f(cell));
}

fn corner_of(corner: u32) -> vec3u {
    return vec3u(corner & 1u, corner >> 1u & 1u, corner >> 2u);
}

fn weight_of(place: Place, corner: vec3u) -> f32 {
    let w = select(1.0 - place.fraction, place.fraction, corner == vec3u(1u));
    return w.x * w.y * w.z;
}

// The entry of a vertex among those of all levels.
fn entry_of(level: Level, v: vec3u) -> u32 {
    // The spatial hash of Müller et al. 2022, equation 4; a hashed level has a power of two of
    // entries.
    let hash = (v.x ^ v.y * 2654435761u ^ v.z * 805459861u) & (level.entries - 1u);
    // On the box's far side a corner can lie beyond the last entry and begins at the first again; elsewhere `i - level.entries`
    // is below zero, which as an unsigned number is the larger of the two.
    let i = v.x + level.nx * (v.y + level.ny * v.z);
    let wrapped = min(min(i, i - level.entries), level.entries - 1u);
    return level.offset + select(hash, wrapped, level.dense == 1u);
}

// A finite half as a float. By hand, since drivers may take denormal halves for zero.
fn widen(half: u32) -> f32 {
    let size = half & 0x7fffu;
    // 0x38000000 moves the exponent by the 112 that the biases differ by; 2^-24 is a denormal's
    // unit.
    let value = select(bitcast<f32>((size << 13u) + 0x38000000u), f32(size) * 5.9604645e-8, size < 0x400u);
    return select(value, -value, half > 0x7fffu);
}

fn entry_at(at: u32) -> vec2f {
    let pair = table[at];
    return vec2f(widen(pair & 0xffffu), widen(pair >> 16u));
}

// The features of a level at a position; zero for columns that only fill up.
fn features(l: u32, position: vec3f) -> vec2f {
    var sum = vec2f();
    if (l < p.levels) {
        let level = levels[l];
        let place = place_of(level, position);
#for c 8
        {
            let corner = corner_of(${c}u);
            sum = fma(entry_at(entry_of(level, place.cell + corner)), vec2f(weight_of(place, corner)), sum);
        }
#end
    }
    return sum;
}

fn rectified(x: vec4f) -> vec4f {
    return max(x, vec4f());
}

fn kept(x: vec4f) -> vec4f {
    return x;
}

// Features of the tile's samples, whose positions are in `places`, to the rows from FROM on.
#define encode
for (var e = t; e < 2u * QUADS * ENCODING; e += 256u) {
    let s = e % (4u * QUADS);
    let l = e / (4u * QUADS);
    let f = features(l, places[s].xyz);
    tile[s / 4u * ROWS + ${TO}u + 2u * l][s % 4u] = f.x;
    tile[s / 4u * ROWS + ${TO}u + 2u * l + 1u][s % 4u] = f.y;
}
workgroupBarrier();
#end

// INPUTS rows from FROM on times the matrix at AT of the weights, through FUNCTION, to OUTPUTS rows
// from TO on; EACH quads per invocation.
#define layer
{
    let n = t % ${OUTPUTS}u;
    let q = t / ${OUTPUTS}u;
#for j ${EACH}
    var s${j} = vec4f();
#end
    if (q < QUADS) {
        // One weight for EACH quads: it is read once and multiplied with four samples of each.
        for (var k = 0u; k < ${INPUTS}u; k++) {
            let w = vec4f(weights[${AT}u + k * ${OUTPUTS}u + n]);
#for j ${EACH}
            s${j} = fma(w, tile[(q + ${j}u * (256u / ${OUTPUTS}u)) * ROWS + ${FROM}u + k], s${j});
#end
        }
    }
    // FROM and TO may overlap: nobody writes before all have read.
    workgroupBarrier();
    if (q < QUADS) {
#for j ${EACH}
        tile[(q + ${j}u * (256u / ${OUTPUTS}u)) * ROWS + ${TO}u + n] = ${FUNCTION}(s${j});
#end
    }
    workgroupBarrier();
}
#end
