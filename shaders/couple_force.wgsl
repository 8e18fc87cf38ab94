// Two-field PCG, for nodes: J^T p.
// coupling, words, node_pairs, flags: see coupling_force. p: direction of the pressure, m/s. t: out.
#import coupling_force
#import dispatch
#import inner
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> p: array<Inner4>;
@group(0) @binding(5) var<storage, read_write> t: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_force(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    t[node] = Real4(force(node), Real(0.0));
}
