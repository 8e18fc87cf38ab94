// redistance, first: the distance at interface cells, |phi|, at the others its cap. An interface cell has an open
// neighbour of the other sign; its distance stays and is stored with a minus. One thread per quad of the band; outside
// it there is air.
// level. band_args, band_list, band_flags: the band. open, solid_distance: see level_cells. new_level: cells, unknown
// deep in bodies. eikonal_now, eikonal_next: the distance, cells, out.
#import dispatch
#import layout
#import lanes
#import level_cells

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(6) var<storage, read> new_level: array<f32>;
@group(0) @binding(7) var<storage, read_write> eikonal_now: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> eikonal_next: array<vec4<f32>>;

// In place of zero, which has no sign.
const LEAST = 1e-30;

fn is_liquid(cell: u32) -> bool {
    return band_flags[cell / 4u] != 0u && new_level[cell] < 0.0;
}

fn liquid_lanes(quad: u32) -> u32 {
    let first = 4u * quad;
    if band_flags[quad] == 0u {
        return 0u;
    }
    let phi = vec4<f32>(new_level[first], new_level[first + 1u], new_level[first + 2u], new_level[first + 3u]);
    return lane_bits(phi < vec4<f32>());
}

// Whether the lanes of a quad and their neighbours all have liquid or all have none.
fn is_uniform(quad: u32) -> bool {
    let here = liquid_lanes(quad);
    if here != 0u && here != 15u {
        return false;
    }
    let rows = vec4<u32>(liquid_lanes(quad - level.stride_y), liquid_lanes(quad + level.stride_y),
        liquid_lanes(quad - level.stride_z), liquid_lanes(quad + level.stride_z));
    let liquid = here != 0u;
    return all(rows == vec4<u32>(here)) && is_liquid(4u * quad - 1u) == liquid && is_liquid(4u * quad + 4u) == liquid;
}

fn at_interface(cell: u32) -> bool {
    if !is_open(cell) {
        return false;
    }
    let liquid = new_level[cell] < 0.0;
    for (var face = 0u; face < 6u; face++) {
        let other = beside(cell, face / 2u, face % 2u);
        if is_liquid(other) != liquid {
            return true;
        }
    }
    return false;
}

@compute @workgroup_size(WG_SIZE)
fn start_redistance(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var distance = vec4<f32>(REACH);
    if !is_uniform(quad) {
        let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
        for (var n = 0u; n < 4u; n++) {
            let cell = 4u * quad + n;
            if exists[n] && at_interface(cell) {
                distance[n] = -clamp(abs(new_level[cell]), LEAST, REACH);
            }
        }
    }
    eikonal_now[quad] = distance;
    eikonal_next[quad] = distance;
}
