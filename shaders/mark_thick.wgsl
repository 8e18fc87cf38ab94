// bound_level, first of five: marks cells with a cell of thick liquid, deeper than 1.5 cells, within three along x.
// Also the level to be bounded, air in spare lanes. One thread per quad of the band; there is none outside it.
// level. band_args, band_list, band_flags: the band. carried_level: cells. thick: per quad the lanes, out. new_level:
// cells, out.
#import dispatch
#import lanes
#import layout
#import level_values

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> carried_level: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> thick: array<u32>;
@group(0) @binding(6) var<storage, read_write> new_level: array<vec4<f32>>;

// Depth of thick liquid, cells.
const THICK = 1.5;

// The lanes in thick liquid of the quad at a cell, which may be beyond the row.
fn thick_lanes(quad: u32, cell: vec3<i32>) -> u32 {
    let exists = lanes_inside(cell, vec3<i32>(level.cells));
    if !any(exists) || band_flags[quad] == 0u {
        return 0u;
    }
    return lane_bits(exists & (carried_level[quad] < vec4<f32>(-THICK)));
}

@compute @workgroup_size(WG_SIZE)
fn mark_thick(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let ahead = vec3<i32>(4, 0, 0);
    // The lanes of three quads.
    var bits = thick_lanes(quad - 1u, cell - ahead) | thick_lanes(quad, cell) << 4u
        | thick_lanes(quad + 1u, cell + ahead) << 8u;
    for (var n = 0; n < 3; n++) {
        bits |= bits << 1u | bits >> 1u;
    }
    thick[quad] = bits >> 4u & 15u;
    let exists = lanes_inside(cell, vec3<i32>(level.cells));
    new_level[quad] = select(vec4<f32>(REACH), carried_level[quad], exists);
}
