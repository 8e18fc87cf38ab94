// advect_level, second of three: the component at the departure point of every cell, see level_origin. Where all cells around that point
// with a label have the same, it is theirs, wherever the point is among them.
// One thread per quad of the band.
// level, step. band_args, band_list: the band. velocity: faces before the sub-step, m/s. flags: see active. labels:
// components before the sub-step, 0 for none and outside the band of then. departures: see departure_words. component_origin: out.
#import corner
#import departure_words
#import dispatch
#import label_at
#import lanes
#import layout
#import level_origin
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> velocity: array<f32>;
@group(0) @binding(5) var<storage, read> flags: array<u32>;
@group(0) @binding(6) var<storage, read> labels: array<u32>;
@group(0) @binding(7) var<storage, read> departures: array<vec4<u32>>;
@group(0) @binding(8) var<storage, read_write> component_origin: array<vec4<u32>>;

// Smallest label around a departure point by its word but 0 for none, the largest one, and the smallest one.
fn labels_around(word: u32) -> vec3<u32> {
    let points = corner_points(corner_of(word & LOWEST_POINT, cell_tops()));
    let near = points[0];
    let far = points[1];
    let a = vec4<u32>(labels[near.x], labels[near.y], labels[near.z], labels[near.w]);
    let b = vec4<u32>(labels[far.x], labels[far.y], labels[far.z], labels[far.w]);
    let most = max(a, b);
    let least = min(a, b);
    // None is the largest of all.
    let least_known = min(a - 1u, b - 1u);
    return vec3<u32>(
        min(min(least_known.x, least_known.y), min(least_known.z, least_known.w)) + 1u,
        max(max(most.x, most.y), max(most.z, most.w)),
        min(min(least.x, least.y), min(least.z, least.w)));
}

@compute @workgroup_size(WG_SIZE)
fn component_origins(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let exists = lanes_inside(cell, vec3<i32>(level.cells));
    let words = departures[quad];
    var origins = vec4<u32>();
    var mixed = 0u;
    for (var l = 0u; l < 4u; l++) {
        if !exists[l] {
            continue;
        }
        let around = labels_around(words[l]);
        origins[l] = around.x;
        // Beyond the outermost centres not all of the cells count.
        let unsure = around.x != around.y || ((words[l] & AT_SIDE) != 0u && around.x != around.z);
        mixed |= u32(unsure) << l;
    }
    while mixed != 0u {
        let l = firstTrailingBit(mixed);
        mixed &= mixed - 1u;
        let at = vec3<f32>(cell) + vec3<f32>(0.5 + f32(l), 0.5, 0.5);
        origins[l] = label_at(level_origin(at, velocity_in(4u * quad + l)));
    }
    component_origin[quad] = origins;
}
