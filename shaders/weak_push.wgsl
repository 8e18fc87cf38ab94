// solve, weak coupling, between the two solves: the right-hand side of the solids gets J^T p of the pressure found. One thread per node.
// coupling, words, node_pairs, flags, p: see coupling_force. node_flags: see node_flags. rhs: N, with the squared norm of the terms that it
// sums, in place.
#import coupling_force
#import dispatch
#import node_flags
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> p: array<Real4>;
@group(0) @binding(5) var<storage, read> node_flags: array<u32>;
@group(0) @binding(6) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn weak_push(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let pushed = select(Real3(), Real(coupling.mass) * force(node), is_free(node_flags[node]));
    let before = rhs[node];
    let terms = sqrt(before.w) + sqrt(dot(pushed, pushed));
    rhs[node] = Real4(before.xyz + pushed, terms * terms);
}
