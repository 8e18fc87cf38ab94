// filter_level, first of two: damps ripples along the surface (equation in the twin, reference/filter_level.rs). One
// thread per quad of the band; outside it there is air. Quads away from the surface are left out.
// level, step, level_step. band_args, band_list, band_flags: the band. valid, occupied: see level_cells. thin: per quad the lanes in
// thin liquid. new_level: cells. next_level: cells, out.
#import dispatch
#import layout
#import lanes
#import level_cells
#import level_step
#import filter_width
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> band_flags: array<u32>;
@group(0) @binding(5) var<storage, read> valid: array<u32>;
@group(0) @binding(6) var<storage, read> occupied: array<u32>;
@group(0) @binding(7) var<storage, read> thin: array<u32>;
@group(0) @binding(8) var<storage, read> new_level: array<f32>;
@group(0) @binding(9) var<storage, read_write> next_level: array<vec4<f32>>;
@group(0) @binding(10) var<uniform> level_step: LevelStep;

// The constants of reference/filter_level.rs.
// Level up to which a stencil is valid, cells.
const VALID_LEVEL = 3.5;
// Squared gradient below which there is no direction.
const LEAST_GRADIENT_SQUARED = 0.25;
// Weight below which an axis counts as normal to the surface.
const LEAST_WEIGHT = 0.02;
const STRENGTH = 0.015625;
// Largest change, cells.
const LARGEST = 0.05;

fn value(cell: u32) -> f32 {
    if band_flags[cell / 4u] == 0u {
        return REACH;
    }
    return new_level[cell];
}

// The change at a cell, cells; 0 where the stencil leaves the valid level or the gradient has no direction.
fn change(cell: u32) -> f32 {
    var minus: vec3<f32>;
    var plus: vec3<f32>;
    for (var axis = 0u; axis < 3u; axis++) {
        minus[axis] = value(beside(cell, axis, 0u));
        plus[axis] = value(beside(cell, axis, 1u));
    }
    let slope = 0.5 * (plus - minus);
    let squared = dot(slope, slope);
    if squared < LEAST_GRADIENT_SQUARED {
        return 0.0;
    }
    let weights = 1.0 - slope * slope / squared;
    var sum = 0.0;
    for (var axis = 0u; axis < 3u; axis++) {
        if weights[axis] < LEAST_WEIGHT {
            continue;
        }
        let near = vec2<f32>(minus[axis], plus[axis]);
        let far = vec2<f32>(value(beyond(cell, axis, 0u)), value(beyond(cell, axis, 1u)));
        if any(max(abs(near), abs(far)) > vec2<f32>(VALID_LEVEL)) {
            return 0.0;
        }
        sum += weights[axis] * (6.0 * new_level[cell] - 4.0 * (near.x + near.y) + far.x + far.y);
    }
    return clamp(STRENGTH * sum, -LARGEST, LARGEST);
}

@compute @workgroup_size(WG_SIZE)
fn filter_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let first = 4u * quad;
    var phi = vec4<f32>(new_level[first], new_level[first + 1u], new_level[first + 2u], new_level[first + 3u]);
    let near = near_surface(phi);
    if !any(near) {
        return;
    }
    var wanted = lane_bits(near) & ~thin[quad] & ~occupied[quad];
    while wanted != 0u {
        let n = firstTrailingBit(wanted);
        wanted &= wanted - 1u;
        phi[n] -= min(level_step.courant, 1.0) * change(first + n);
    }
    next_level[quad] = phi;
}
