// Bench: rate of arithmetic. Eight independent chains of ROUNDS fused multiply-adds per thread.
// target_out: in and out, so that the compiler can neither fold the factors nor remove the chains.
#import real
#import dispatch

@group(0) @binding(0) var<storage, read_write> target_out: array<Real>;

const ROUNDS = 256u;

@compute @workgroup_size(WG_SIZE)
fn multiply_add(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let ix = linear_index(workgroup, lane);
    if ix >= arrayLength(&target_out) {
        return;
    }
    let start = target_out[ix];
    // Chains x = factor x + 1 converge for factors below 1.
    let factor = Real4(start + Real(0.1), start + Real(0.2), start + Real(0.3), start + Real(0.4));
    let one = Real4(Real(1.0));
    var a = Real4(start);
    var b = one;
    for (var round = 0u; round < ROUNDS; round++) {
        a = fma(a, factor, one);
        b = fma(b, factor, one);
    }
    let difference = a - b;
    target_out[ix] = difference.x + difference.y + difference.z + difference.w;
}
