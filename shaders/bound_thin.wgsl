// bound_level, fourth of five: bounds of thin liquid by the occupancy F and the curvature of the level (equations in the twin,
// reference/bound_level.rs). One thread per quad of the band.
// level, step. band_args, band_list: the band. valid, occupied: see level_cells. carried_level: cells. occupancy: F. thin: per
// quad the lanes in thin liquid. new_level: cells, out in those.
#import dispatch
#import lanes
#import layout
#import level_cells
#import level_values
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> valid: array<u32>;
@group(0) @binding(5) var<storage, read> occupied: array<u32>;
@group(0) @binding(6) var<storage, read> carried_level: array<f32>;
@group(0) @binding(7) var<storage, read> occupancy: array<f32>;
@group(0) @binding(8) var<storage, read> thin: array<u32>;
@group(0) @binding(9) var<storage, read_write> new_level: array<f32>;

// The constants of reference/bound_level.rs.
// Occupancy at the surface of thin liquid.
const THIN_LEVEL = 0.47;
// Depth that a surface loses per curvature, cells^2.
const PER_CURVATURE = 1.0 / 6.0;
// Largest curvature that counts, 1 / cells.
const LARGEST_CURVATURE = 1.0;
// Level up to which it does, cells.
const CURVED = 2.0;

// Distance of a flat surface normal to an axis from cells of the occupancy, cells.
fn flat_distance(fraction: vec4<f32>) -> vec4<f32> {
    let q = clamp(2.0 * (fraction - THIN_LEVEL), vec4<f32>(-1.0), vec4<f32>(1.0));
    return -sign(q) * (1.0 - sqrt(1.0 - abs(q)));
}

// The Laplacian of the level near the surface, 1 / cells.
fn curvature(cell: u32) -> f32 {
    let phi = carried_level[cell];
    if abs(phi) >= CURVED {
        return 0.0;
    }
    var sum = 0.0;
    for (var n = 0u; n < 6u; n++) {
        sum += carried_level[across(cell, n / 2u, n % 2u)] - phi;
    }
    return clamp(sum, -LARGEST_CURVATURE, LARGEST_CURVATURE);
}

@compute @workgroup_size(WG_SIZE)
fn bound_thin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let lanes = thin[quad] & ~occupied[quad] & 15u;
    if lanes == 0u {
        return;
    }
    let first = 4u * quad;
    let fraction = vec4<f32>(occupancy[first], occupancy[first + 1u], occupancy[first + 2u], occupancy[first + 3u]);
    let phi = vec4<f32>(carried_level[first], carried_level[first + 1u], carried_level[first + 2u], carried_level[first + 3u]);
    let flat = flat_distance(fraction);
    // Most cells are far from the surface: no curvature moves them.
    let least = flat - PER_CURVATURE * LARGEST_CURVATURE;
    let largest = flat + PER_CURVATURE * LARGEST_CURVATURE;
    let zero = vec4<f32>();
    let moves = ((largest > zero) & (phi < largest)) | ((least < zero) & (phi > least));
    var wanted = lanes & lane_bits(moves & (fraction != vec4<f32>(UNKNOWN_OCCUPANCY)));
    while wanted != 0u {
        let n = firstTrailingBit(wanted);
        wanted &= wanted - 1u;
        let t = flat[n] - PER_CURVATURE * curvature(first + n);
        if t > 0.0 {
            new_level[first + n] = max(phi[n], t);
        } else if t < 0.0 {
            new_level[first + n] = min(phi[n], t);
        }
    }
}
