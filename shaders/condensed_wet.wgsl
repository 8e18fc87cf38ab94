// Condensed solve, once the active cells are known, for nodes: which of them pressure acts on, 0 or 1.
// coupling, words, node_pairs: see coupling_force. flags: active lanes. wet: out.
#import coupling
#import dispatch

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read_write> wet: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn condensed_wet(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    var found = 0u;
    let last = words[coupling.node_starts + node + 1u];
    for (var at = words[coupling.node_starts + node]; at < last; at++) {
        let cell = node_pairs[at].w;
        found |= flags[cell / 4u] >> (cell % 4u) & 1u;
    }
    wet[node] = found;
}
