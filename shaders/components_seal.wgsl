// Stage closed_components, with solids only, before the roots are counted for good: marks the root of every component that a patch joins
// to a node that gives way, which fixes the level of its pressure, and notes whether any patch touches the liquid. One thread per wet quad.
// coupling, words, quad_pairs: see coupling_flux. node_flags: see node_flags. flags: active lanes. labels, state: see components.
// report: touching, 0 or 1, in its first word.
#import components
#import coupling
#import dispatch
#import find
#import node_flags

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> node_flags: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> state: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> report: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_seal(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let is_active = flags[quad];
    var touching = 0u;
    var gives_way = 0u;
    let last = words[coupling.quad_starts + wet + 1u];
    for (var at = words[coupling.quad_starts + wet]; at < last; at++) {
        let pair = quad_pairs[at];
        let of_lane = 1u << (pair.w % 4u);
        if (is_active & of_lane) == 0u {
            continue;
        }
        touching |= of_lane;
        if any(is_free(node_flags[pair.w / 4u]) & (bitcast<vec3<f32>>(pair.xyz) != vec3<f32>())) {
            gives_way |= of_lane;
        }
    }
    if touching != 0u {
        atomicStore(&report[0], 1u);
    }
    var left_over = 0u;
    while gives_way != 0u {
        let l = firstTrailingBit(gives_way);
        gives_way &= gives_way - 1u;
        let root = find(4u * quad + l);
        if (atomicLoad(&labels[root]) & OPEN) == 0u && (atomicOr(&labels[root], MARKS) & OPEN) == 0u {
            left_over--;
        }
    }
    if left_over != 0u {
        // Modulo 2^32, as in components_open.
        atomicAdd(&state[COUNTER], left_over);
        atomicAdd(&state[SEALS], 0u - left_over);
    }
}
