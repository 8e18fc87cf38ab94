// Outer loop of the coupled solve, for nodes: v = v + scale dv, with the correction of the round.
// coupling. norms: see refine. search: direction, then correction. x: v, m/s, in place.
#import coupling
#import dispatch
#import real
#import refine

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> norms: array<Real>;
@group(0) @binding(2) var<storage, read> search: array<Real4>;
@group(0) @binding(3) var<storage, read_write> x: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_correct(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    x[node] += norms[SCALE] * search[coupling.n_nodes + node];
}
