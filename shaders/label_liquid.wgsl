// liquid_components: the first labels, trees whose links are open faces between liquid cells: to the cell before in z,
// else in y, else in x, else to itself (as components_init). Also no overlap yet with the components before the sub-step.
// A label is the index of a cell; index 0 is none in the domain and stands for no label. Liquid without an open face has
// none.
// One thread per quad of the band.
// level. band_args, band_list: the band. liquid_distance: m. open: face apertures. component_origin: see
// component_origins. component: labels, out. overlaps: see component_sums; out, at the old labels.
#import component_sums
#import dispatch
#import layout
#import liquid_lanes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> component_origin: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> component: array<vec4<u32>>;
@group(0) @binding(7) var<storage, read_write> overlaps: array<atomic<u32>>;

// Most cells of a component find the word cleared.
fn clear(word: u32) {
    if atomicLoad(&overlaps[word]) != 0u {
        atomicStore(&overlaps[word], 0u);
    }
}

@compute @workgroup_size(WG_SIZE)
fn label_liquid(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let origins = component_origin[quad];
    var last = 0u;
    for (var l = 0u; l < 4u; l++) {
        if origins[l] != last && origins[l] > 0u {
            last = origins[l];
            clear(2u * last);
            clear(2u * last + 1u);
        }
    }
    let cell = quad_cell(level, quad);
    let liquid = liquid_lanes(quad, cell);
    if !any(liquid) {
        component[quad] = vec4<u32>();
        return;
    }
    let before = open_lanes(0u, quad) | open_lanes(1u, quad) | open_lanes(2u, quad);
    let after = open_after(0u, quad) | open_after(1u, quad) | open_after(2u, quad);
    let own = vec4<u32>(4u * quad) + vec4<u32>(0u, 1u, 2u, 3u);
    var label = select(own, own - vec4<u32>(1u), joined(0u, quad, cell));
    label = select(label, own - vec4<u32>(4u * level.stride_y), joined(1u, quad, cell));
    label = select(label, own - vec4<u32>(4u * level.stride_z), joined(2u, quad, cell));
    component[quad] = select(vec4<u32>(), label, liquid & (before | after));
}
