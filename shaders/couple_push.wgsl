// solve, for liquid and solids, before the search for contacts judges it: F + J^T p, what pushes nodes to walls and obstacles. One thread per node.
// coupling, words, node_pairs, flags, p: see coupling_force. rhs: F, N. pushed: N, out.
#import coupling_force
#import dispatch
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> p: array<Real4>;
@group(0) @binding(5) var<storage, read> rhs: array<Real4>;
@group(0) @binding(6) var<storage, read_write> pushed: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_push(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node < coupling.n_nodes {
        pushed[node] = Real4(rhs[node].xyz + Real(coupling.mass) * force(node), Real(0.0));
    }
}
