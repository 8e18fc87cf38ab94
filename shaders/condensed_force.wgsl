// Condensed solve, end of a refinement step, for nodes: J^T of the correction of the potential.
// coupling, words, node_pairs: see coupling_force. flags: active lanes. level: level 0. search: direction, then correction. force: out.
#import coupling
#import dispatch
#import inner
#import level
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> level: Level;
@group(0) @binding(2) var<storage, read> words: array<u32>;
@group(0) @binding(3) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> search: array<Inner4>;
@group(0) @binding(6) var<storage, read_write> force: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn condensed_force(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    var sum = Real3();
    let last = words[coupling.node_starts + node + 1u];
    for (var at = words[coupling.node_starts + node]; at < last; at++) {
        let pair = node_pairs[at];
        let quad = pair.w / 4u;
        let lane = pair.w % 4u;
        if (flags[quad] >> lane & 1u) == 1u {
            sum += Real3(bitcast<vec3<f32>>(pair.xyz)) * Real(search[level.shape.quads + quad][lane]);
        }
    }
    force[node] = Real4(sum, Real(0.0));
}
