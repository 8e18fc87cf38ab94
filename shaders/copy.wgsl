// Bench: bandwidth of a plain copy, the reference for the bandwidth of other kernels.
// source: in. target_out: out.
#import dispatch

@group(0) @binding(0) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> target_out: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn copy(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix < arrayLength(&source) {
        target_out[ix] = source[ix];
    }
}
