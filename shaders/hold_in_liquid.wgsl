// move_solid, before the motion, with liquid: bodies with a patch in a cell that was filled in the last sub-step are not
// ballistic. One workgroup per body.
// coupling, words, node_pairs: see coupling_force. free_bodies: see ballistic_body. flags: see active. ballistic: per node, 0
// or 1; in place.
#import active
#import ballistic_body
#import coupling

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> free_bodies: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read_write> ballistic: array<u32>;

fn touches(node: u32) -> bool {
    let last = words[coupling.node_starts + node + 1u];
    for (var at = words[coupling.node_starts + node]; at < last; at++) {
        let cell = node_pairs[at].w;
        if (flags[cell / 4u] >> (FILLED + cell % 4u) & 1u) == 1u {
            return true;
        }
    }
    return false;
}

@compute @workgroup_size(FOLD_SIZE)
fn hold_in_liquid(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let nodes = nodes_of(group_index(workgroup));
    if body_touches(nodes, lane) {
        mark(nodes, lane, 0u);
    }
}
