// liquid_components: volumes of the cells with a label and their sum per component, with a mark where liquid is beside
// air or an open side. Removes the layers from the labels.
// One thread per quad of the band.
// level, step. band_args, band_list: the band. liquid_distance, solid_distance: m. open: face apertures. component:
// labels, in place. liquid_volumes: out, volumes of a cell. sums: see component_sums.
#import dispatch
#import filled
#import interpolant_part
#import layout
#import liquid_lanes
#import tally

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> component: array<vec4<u32>>;
@group(0) @binding(8) var<storage, read_write> liquid_volumes: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> sums: array<atomic<u32>>;

// The bits of a label below those of its layer.
const LABEL = 0x3fffffffu;

// Liquid lanes with an open face to a cell without liquid or out of the domain.
fn at_surface(quad: u32, cell: vec3<i32>) -> vec4<bool> {
    let liquid = liquid_lanes(quad, cell);
    var found = vec4<bool>();
    if any(liquid) {
        for (var axis = 0u; axis < 3u; axis++) {
            found |= open_lanes(axis, quad) & !liquid_before(axis, quad, cell);
            found |= open_after(axis, quad) & !liquid_after(axis, quad, cell);
        }
    }
    return liquid & found;
}

fn mark(label: u32) {
    if (atomicLoad(&sums[2u * label + 1u]) & SURFACE) == 0u {
        atomicOr(&sums[2u * label + 1u], SURFACE);
    }
}

@compute @workgroup_size(WG_SIZE)
fn component_volumes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    var label = vec4<u32>();
    var volume = vec4<f32>();
    if index < band_args[3] {
        let quad = band_list[index];
        label = component[quad] & vec4<u32>(LABEL);
        if any(label != vec4<u32>()) {
            component[quad] = label;
            let cell = quad_cell(level, quad);
            let filled = vec4<f32>(open_volume(quad)) * interpolant_parts(quad);
            volume = select(vec4<f32>(), filled, label != vec4<u32>());
            let marked = at_surface(quad, cell) & (label != vec4<u32>());
            var last = 0u;
            for (var l = 0u; l < 4u; l++) {
                if marked[l] && label[l] != last {
                    last = label[l];
                    mark(last);
                }
            }
        }
        liquid_volumes[quad] = volume;
    }
    tally(label, volume, lane);
}
