// bound_level, first of three: lanes in thin liquid (definition in the twin, reference/bound_level.rs), and the level to be bounded, air
// in spare lanes. One thread per quad of the band; outside it there is air.
// level. band_args, band_list, band_flags: the band. carried_level: cells. thin: per quad the lanes, out. new_level:
// cells, out.
#import corner
#import dispatch
#import lanes
#import layout
#import level_values

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> band_flags: array<u32>;
@group(0) @binding(4) var<storage, read> carried_level: array<f32>;
@group(0) @binding(5) var<storage, read_write> thin: array<u32>;
@group(0) @binding(6) var<storage, read_write> new_level: array<vec4<f32>>;

// The constants of reference/bound_level.rs.
// Depth at which liquid is thick, cells.
const THICK = 1.5;
// Level at that depth from which liquid is thin, cells.
const THIN = -1.25;
// Slope below which the level has no direction.
const LEAST_SLOPE = 0.1;

fn value(cell: u32) -> f32 {
    return select(REACH, carried_level[cell], band_flags[cell / 4u] != 0u);
}
fn values(cells: vec4<u32>) -> vec4<f32> {
    return vec4<f32>(value(cells.x), value(cells.y), value(cells.z), value(cells.w));
}

// Half the difference of the level on both sides of a cell, number `at` of n along an axis with a stride.
fn slope(cell: u32, at: i32, n: u32, stride: u32) -> f32 {
    let low = select(cell, cell - stride, at > 0);
    let high = select(cell, cell + stride, at + 1 < i32(n));
    return 0.5 * (value(high) - value(low));
}

// Whether liquid is thin around a cell with the level phi, at most 1.5 cells deep. index: of its value.
fn thin_around(index: u32, cell: vec3<i32>, phi: f32) -> bool {
    let gradient = vec3<f32>(slope(index, cell.x, level.cells.x, 1u),
        slope(index, cell.y, level.cells.y, 4u * level.stride_y), slope(index, cell.z, level.cells.z, 4u * level.stride_z));
    let steepness = length(gradient);
    if steepness < LEAST_SLOPE {
        return true;
    }
    let below = centres_around(vec3<f32>(cell) + 0.5 - (phi + THICK) / steepness * gradient);
    let points = corner_points(below);
    return mix_points(values(points[0]), values(points[1]), below.f) >= THIN;
}

@compute @workgroup_size(WG_SIZE)
fn mark_thin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let first = 4u * quad;
    let exists = lanes_inside(cell, vec3<i32>(level.cells));
    let carried = vec4<f32>(carried_level[first], carried_level[first + 1u], carried_level[first + 2u], carried_level[first + 3u]);
    let phi = select(vec4<f32>(REACH), carried, exists);
    var bits = 0u;
    var shallow = lane_bits(exists & (phi >= vec4<f32>(-THICK)));
    while shallow != 0u {
        let n = firstTrailingBit(shallow);
        shallow &= shallow - 1u;
        bits |= u32(thin_around(first + n, cell + vec3<i32>(i32(n), 0, 0), phi[n])) << n;
    }
    thin[quad] = bits;
    new_level[quad] = phi;
}
