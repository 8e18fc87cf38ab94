// excess: one pass of (1/4, 1/2, 1/4) along an axis, mirrored at walls and bodies. One thread per quad of the band;
// outside it both numbers are 0.
// level. axis: in the first word. band_args, band_list, band_flags: the band. open, solid_distance: see level_cells.
// density_in, density_out: (F - 1) w and w.
#import dispatch
#import lanes
#import layout
#import level_cells

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> axis: vec4<u32>;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> open: array<f32>;
@group(0) @binding(6) var<storage, read> solid_distance: array<f32>;
@group(0) @binding(7) var<storage, read> density_in: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read_write> density_out: array<vec2<f32>>;

fn density_of(cell: u32) -> vec2<f32> {
    if band_flags[cell / 4u] == 0u {
        return vec2<f32>();
    }
    return density_in[cell];
}

@compute @workgroup_size(WG_SIZE)
fn smooth_density(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    for (var l = 0u; l < 4u; l++) {
        let cell = 4u * quad + l;
        var density = vec2<f32>();
        if exists[l] {
            let beside_it = density_of(beside(cell, axis.x, 0u)) + density_of(beside(cell, axis.x, 1u));
            density = 0.5 * density_in[cell] + 0.25 * beside_it;
        }
        density_out[cell] = density;
    }
}
