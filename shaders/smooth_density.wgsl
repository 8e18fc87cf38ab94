// excess: one pass of (1/4, 1/2, 1/4) along an axis, mirrored at walls and bodies. One thread per quad of the band;
// outside it both numbers are 0.
// level. axis: in the first word. band_args, band_list, band_flags: the band. valid, occupied: see level_cells.
// density_in, density_out: (F - 1) w and w of two cells.
#import dispatch
#import lanes
#import layout
#import quad_rooms

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> axis: vec4<u32>;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> valid: array<u32>;
@group(0) @binding(6) var<storage, read> occupied: array<u32>;
@group(0) @binding(7) var<storage, read> density_in: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> density_out: array<vec4<f32>>;

// Both numbers of four cells.
struct Densities {
    low: vec4<f32>,
    high: vec4<f32>,
}

fn densities(quad: u32) -> Densities {
    if band_flags[quad] == 0u {
        return Densities();
    }
    return Densities(density_in[2u * quad], density_in[2u * quad + 1u]);
}

// The others on a side where there is a cell, else the cells themselves.
fn mirrored(here: Densities, others: Densities, has: vec4<bool>) -> Densities {
    return Densities(select(here.low, others.low, has.xxyy), select(here.high, others.high, has.zzww));
}

@compute @workgroup_size(WG_SIZE)
fn smooth_density(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let along_x = axis.x == 0u;
    let stride = select(select(level.stride_z, level.stride_y, axis.x == 1u), 1u, along_x);
    let here = densities(quad);
    var minus = densities(quad - stride);
    var plus = densities(quad + stride);
    if along_x {
        minus = Densities(vec4<f32>(minus.high.zw, here.low.xy), vec4<f32>(here.low.zw, here.high.xy));
        plus = Densities(vec4<f32>(here.low.zw, here.high.xy), vec4<f32>(here.high.zw, plus.low.xy));
    }
    let sides = rooms_along(axis.x, stride, quad);
    minus = mirrored(here, minus, side_lanes(sides, 0u));
    plus = mirrored(here, plus, side_lanes(sides, 1u));
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    let low = 0.5 * here.low + 0.25 * (minus.low + plus.low);
    let high = 0.5 * here.high + 0.25 * (minus.high + plus.high);
    density_out[2u * quad] = select(vec4<f32>(), low, exists.xxyy);
    density_out[2u * quad + 1u] = select(vec4<f32>(), high, exists.zzww);
}
