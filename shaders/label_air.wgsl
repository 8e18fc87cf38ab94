// liquid_components: one layer of cells without a label gets the smallest label across an open face. The number of the
// layer stands in the upper two bits of a label until component_volumes removes it; labels of the same layer do not count,
// so the order of the threads does not matter.
// One thread per quad of the band; no cell outside it has a label.
// level. layer: number, 1 to 3, in its first word. band_args, band_list: the band. open: face apertures. labels: in place.
#import dispatch
#import lanes
#import layout

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> layer: vec4<u32>;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read_write> labels: array<atomic<u32>>;

// First bit of the layer.
const LAYER = 30u;

// The smaller of a label and that of a cell beyond a face.
fn smaller(label: u32, face: u32, cell: u32) -> u32 {
    let there = atomicLoad(&labels[cell]);
    if there == 0u || there >> LAYER >= layer.x || open[face] <= 0.0 {
        return label;
    }
    return min(label, there & ((1u << LAYER) - 1u));
}

@compute @workgroup_size(WG_SIZE)
fn label_air(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    let y = 4u * level.quads;
    let z = 8u * level.quads;
    let sy = 4u * level.stride_y;
    let sz = 4u * level.stride_z;
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * quad + l;
        if !exists[l] || atomicLoad(&labels[cell]) != 0u {
            continue;
        }
        let none = 0xffffffffu;
        var label = smaller(none, cell, cell - 1u);
        label = smaller(label, cell + 1u, cell + 1u);
        label = smaller(label, y + cell, cell - sy);
        label = smaller(label, y + cell + sy, cell + sy);
        label = smaller(label, z + cell, cell - sz);
        label = smaller(label, z + cell + sz, cell + sz);
        if label != none {
            atomicStore(&labels[cell], label | layer.x << LAYER);
        }
    }
}
