// bound_level, last of five: bounds of thick liquid by the smoothed occupancy G (equations in the twin,
// reference/bound_level.rs). Cells whose own occupancy and those beside exclude a bound that counts do not compute G: they
// are most of the band. One thread per quad of the band; outside it F = 0.
// level, step. band_args, band_list, band_flags: the band. valid, occupied: see level_cells. occupancy: F. thin: per
// quad the lanes in thin liquid. new_level: cells, in place.
#import dispatch
#import lanes
#import layout
#import level_values
#import smooth_cells
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> valid: array<u32>;
@group(0) @binding(6) var<storage, read> occupied: array<u32>;
@group(0) @binding(7) var<storage, read> occupancy: array<f32>;
@group(0) @binding(8) var<storage, read> thin: array<u32>;
@group(0) @binding(9) var<storage, read_write> new_level: array<f32>;

// The constants of reference/bound_level.rs.
// Slope of the distance over the smoothed occupancy, cells.
const SLOPE = 1.6;
// Tolerance of the bounds in thick liquid, cells.
const TOLERANCE = 0.5;

// Only G or 1 - G below this bounds the level of thick liquid, with a margin for rounding.
const LEAST_DIFFERENCE = 0.5 - TOLERANCE / SLOPE + 0.01;
// Largest magnitude of such a bound, cells, with a margin.
const LARGEST_BOUND = 0.5 * SLOPE - TOLERANCE + 0.01;

// The occupancy for the smoothing and whether it is known.
fn tap(cell: u32) -> vec2<f32> {
    if band_flags[cell / 4u] == 0u {
        return vec2<f32>(0.0, 1.0);
    }
    let fraction = occupancy[cell];
    return vec2<f32>(clamp(fraction, 0.0, 1.0), f32(fraction != UNKNOWN_OCCUPANCY));
}

fn occupancies(quad: u32) -> vec4<f32> {
    let first = 4u * quad;
    let here = vec4<f32>(occupancy[first], occupancy[first + 1u], occupancy[first + 2u], occupancy[first + 3u]);
    return select(vec4<f32>(UNKNOWN_OCCUPANCY), here, band_flags[quad] != 0u);
}

fn known_occupancy(cell: u32) -> f32 {
    return select(UNKNOWN_OCCUPANCY, occupancy[cell], band_flags[cell / 4u] != 0u);
}

// Lanes where G may bound the level phi. The weight of a cell in its G is at least 1/8, that of a neighbour across a face
// 1/16; one that is unknown or beyond a closed face counts as the worse of itself and none. The weights sum to 1 at
// most.
fn may_bound(quad: u32, here: vec4<f32>, phi: vec4<f32>) -> vec4<bool> {
    var sides = array<vec4<f32>, 6>(
        vec4<f32>(known_occupancy(4u * quad - 1u), here.xyz), vec4<f32>(here.yzw, known_occupancy(4u * quad + 4u)),
        occupancies(quad - level.stride_y), occupancies(quad + level.stride_y),
        occupancies(quad - level.stride_z), occupancies(quad + level.stride_z));
    let unknown = vec4<f32>(UNKNOWN_OCCUPANCY);
    let full = clamp(here, vec4<f32>(), vec4<f32>(1.0));
    // Least weighted occupancy, and least weighted lack of it.
    var occupied_part = 0.125 * full;
    var empty_part = 0.125 * (1.0 - full);
    for (var side = 0; side < 6; side++) {
        let beside = sides[side];
        let fraction = clamp(beside, vec4<f32>(), vec4<f32>(1.0));
        occupied_part += 0.0625 * min(full, fraction);
        empty_part += 0.0625 * select(vec4<f32>(), min(1.0 - full, 1.0 - fraction), beside != unknown);
    }
    let low = (phi < vec4<f32>(LARGEST_BOUND)) & (occupied_part < vec4<f32>(LEAST_DIFFERENCE));
    let high = (phi > vec4<f32>(-LARGEST_BOUND)) & (empty_part < vec4<f32>(LEAST_DIFFERENCE));
    return low | high;
}

fn bounded(phi: f32, t: f32) -> f32 {
    if t > TOLERANCE {
        return max(phi, t - TOLERANCE);
    }
    if t < -TOLERANCE {
        return min(phi, t + TOLERANCE);
    }
    return phi;
}

@compute @workgroup_size(WG_SIZE)
fn bound_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = 4u * quad;
    let phi = vec4<f32>(new_level[first], new_level[first + 1u], new_level[first + 2u], new_level[first + 3u]);
    let fraction = occupancies(quad);
    let known = bit_lanes(~occupied[quad]) & (fraction != vec4<f32>(UNKNOWN_OCCUPANCY));
    var thick = lane_bits(known & !bit_lanes(thin[quad]) & may_bound(quad, fraction, phi));
    while thick != 0u {
        let n = firstTrailingBit(thick);
        thick &= thick - 1u;
        let smoothed = smooth_cells(first + n);
        new_level[first + n] = bounded(phi[n], SLOPE * (0.5 - smoothed.x / smoothed.y));
    }
}
