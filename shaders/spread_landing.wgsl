// landing, third of four: adds the momentum and the weight of markers that land to the open faces around them with liquid on a side, and ends their
// flight. One thread per used slot.
// level, step. open: face apertures. liquid_distance: cell centres, m. markers: x, y, z (m). marker_velocity: m/s, w = 2 for spray that lands, 0
// afterwards; in place. marker_args: see plan_band_seeds. marker_counts: see marker_counts. landing_momentum, landing_weight: see landing; in place.
#import corner
#import dispatch
#import landing
#import layout
#import marker_counts
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> open: array<f32>;
@group(0) @binding(3) var<storage, read> liquid_distance: array<f32>;
@group(0) @binding(4) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marker_velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> marker_args: array<u32>;
@group(0) @binding(7) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(8) var<storage, read_write> landing_momentum: array<atomic<i32>>;
@group(0) @binding(9) var<storage, read_write> landing_weight: array<atomic<i32>>;

// The constants of reference/landing.rs: largest velocity that counts, cells per sub-step, and least sum of the weights.
const LARGEST = 64.0;
const LEAST_WEIGHT = 1.0 / 256.0;

// Whether a face takes momentum. cell: index of the cell on its plus side.
fn takes(axis: u32, cell: u32) -> bool {
    let before = cell - vec3<u32>(1u, 4u * level.stride_y, 4u * level.stride_z)[axis];
    let wet = liquid_distance[cell] < 0.0 || liquid_distance[before] < 0.0;
    return wet && open[4u * axis * level.quads + cell] > 0.0;
}

@compute @workgroup_size(WG_SIZE)
fn spread_landing(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= marker_args[3] || marker_counts[LANDED] == 0u || marker_velocity[index].w != 2.0 {
        return;
    }
    marker_velocity[index].w = 0.0;
    let at = markers[index].xyz * step.inv_dx;
    let ways = clamp(marker_velocity[index].xyz * (step.dt * step.inv_dx), vec3<f32>(-LARGEST), vec3<f32>(LARGEST));
    for (var axis = 0u; axis < 3u; axis++) {
        let around = faces_around(axis, at);
        var cells: array<u32, 8>;
        var weights: array<f32, 8>;
        var sum = 0.0;
        for (var point = 0u; point < 8u; point++) {
            let upper = (vec3<u32>(point) >> vec3<u32>(0u, 1u, 2u) & vec3<u32>(1u)) == vec3<u32>(1u);
            let steps = select(vec3<u32>(), around.up, upper);
            let parts = select(1.0 - around.f, around.f, upper);
            let cell = around.low + steps.x + steps.y + steps.z;
            cells[point] = cell;
            weights[point] = select(0.0, parts.x * parts.y * parts.z, takes(axis, cell));
            sum += weights[point];
        }
        if sum < LEAST_WEIGHT {
            continue;
        }
        for (var point = 0u; point < 8u; point++) {
            let weight = weights[point] / sum;
            if weight > 0.0 {
                let face = 4u * axis * level.quads + cells[point];
                atomicAdd(&landing_momentum[face], i32(round(ONE * weight * ways[axis])));
                atomicAdd(&landing_weight[face], i32(round(ONE * weight)));
            }
        }
    }
}
