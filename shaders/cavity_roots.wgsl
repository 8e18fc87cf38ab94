// Stage right_hand_side, with cavities of solids: the smallest root of the sealed components that touch each cavity, in a cell whose patches belong to
// it alone. One thread per wet quad.
// coupling, words, quad_pairs: see coupling_flux. flags, labels: see active, components. cavity_of_node: from 1, 0 for none. cavities: words of
// Cavity, six each; roots are NONE before.
#import active
#import components
#import coupling
#import dispatch

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> labels: array<u32>;
@group(0) @binding(5) var<storage, read> cavity_of_node: array<u32>;
@group(0) @binding(6) var<storage, read_write> cavities: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn cavity_roots(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let sealed = sealed_lanes(flags[quad]);
    if sealed == 0u {
        return;
    }
    // Cavity of all pairs of a lane: NONE without pairs, 0 with several.
    var cavity = vec4<u32>(NONE);
    let last = words[coupling.quad_starts + wet + 1u];
    for (var at = words[coupling.quad_starts + wet]; at < last; at++) {
        let node = quad_pairs[at].w / 4u;
        let l = quad_pairs[at].w % 4u;
        let own = cavity_of_node[node];
        cavity[l] = select(0u, own, cavity[l] == NONE || cavity[l] == own);
    }
    for (var l = 0u; l < 4u; l++) {
        if (sealed & (1u << l)) != 0u && cavity[l] != NONE && cavity[l] != 0u {
            atomicMin(&cavities[6u * (cavity[l] - 1u)], labels[4u * quad + l] & ~MARKS);
        }
    }
}
