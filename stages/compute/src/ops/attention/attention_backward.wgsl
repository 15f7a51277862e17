// What both gradients of attention start from: the gradient to the output, and what the forward
// pass left of each row.
@group(0) @binding(4) var<storage, read> dout: array<f32>;
@group(0) @binding(5) var<storage, read> lse: array<f32>;
@group(0) @binding(6) var<storage, read> delta: array<f32>;

#use reader X=dout LEN=p.queries

// The place of a query's number in arrays of one number per query and head.
fn place(which: u32, query: u32) -> u32 {
    return (which / p.heads * p.queries + query) * p.heads + which % p.heads;
}

// The weight of a key for a query, by its score.
fn weight(which: u32, query: u32, key: u32, score: f32) -> f32 {
    if (!sees(query, key)) {
        return 0.0;
    }
    // `lse` is the logarithm of the row's sum: this is the softmax without another walk.
    return exp(score * p.scale - lse[place(which, query)]);
}

// The gradient to a score, by the gradient to the key's weight.
fn score_gradient(which: u32, query: u32, weight: f32, gradient: f32) -> f32 {
    // Also for places beyond the last query, which have no delta.
    if (weight == 0.0) {
        return 0.0;
    }
    return weight * (gradient - delta[place(which, query)]) * p.scale;
}

#define begin
let ty = t / 16u;
let tx = t % 16u;
let row0 = group.x * 64u;
let feature0 = group.z * ${SLICES}u * 64u;
let start_q = start_of(group.y, p.queries);
let start_dout = start_q;
let start_k = start_of(group.y, p.keys);
let start_v = start_k;
#end

#define put
for (var c = 0u; c < 4u; c++) {
    let row = row0 + ty * 4u + ${i}u;
    let f = feature0 + ${j}u * 64u + tx * 4u + c;
    if (row < ${LEN} && f < p.depth) {
        ${OUT}[${START} + row * p.heads * p.depth + f] = ${SUM}_${j}_${i}[c];
    }
}
#end
