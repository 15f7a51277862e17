// One step of Adam: the parameter and both moments anew.
@group(0) @binding(1) var<storage, read> parameter: array<f32>;
@group(0) @binding(2) var<storage, read> gradient: array<f32>;
@group(0) @binding(3) var<storage, read> mean: array<f32>;
@group(0) @binding(4) var<storage, read> square: array<f32>;
@group(0) @binding(5) var<storage, read_write> new_parameter: array<f32>;
@group(0) @binding(6) var<storage, read_write> new_mean: array<f32>;
@group(0) @binding(7) var<storage, read_write> new_square: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = (group.y * groups.x + group.x) * 256u + local;
    if (i < p.len) {
        let g = gradient[i];
        let m = p.beta1 * mean[i] + (1.0 - p.beta1) * g;
        let v = p.beta2 * square[i] + (1.0 - p.beta2) * g * g;
        new_mean[i] = m;
        new_square[i] = v;
        // Bias corrections are in `rate` and `root`, as on the CPU.
        new_parameter[i] = parameter[i] * p.keep - p.rate * m / (sqrt(v) * p.root + p.eps);
    }
}
