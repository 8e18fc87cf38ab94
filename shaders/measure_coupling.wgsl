// diagnose with solids in liquid: the force J^T p on each node, p the pressure at cell centres, N. One thread per
// node.
// coupling, words, node_pairs, flags, p: see coupling_force. partials: out.
#import coupling_force
#import dispatch
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> p: array<Real4>;
@group(0) @binding(5) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn measure_coupling(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node < coupling.n_nodes {
        partials[node] = Real4(Real(coupling.mass) * force(node), Real(0.0));
    }
}
