// landing, last of four: u_f := (M_f u_f + m P_f) / (M_f + m W_f) (see the twin, reference/landing.rs). One thread per quad of the band.
// level, step. band_args, band_list: the band. marker_counts: see marker_counts. liquid_distance, solid_distance: m. landing_momentum,
// landing_weight: P and W, see landing. velocity_next: faces, m/s; in place.
#import dispatch
#import face_index
#import filled
#import interpolant_part
#import landing
#import layout
#import marker_counts
#import spray_sums
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> marker_counts: array<u32>;
@group(0) @binding(5) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> landing_momentum: array<vec4<i32>>;
@group(0) @binding(8) var<storage, read> landing_weight: array<vec4<i32>>;
@group(0) @binding(9) var<storage, read_write> velocity_next: array<vec4<f32>>;

// Liquid in a cell, volumes of a cell; none beyond the domain.
fn liquid_in(cell: vec3<i32>) -> f32 {
    if any(cell < vec3<i32>()) || any(cell >= vec3<i32>(level.cells)) {
        return 0.0;
    }
    let quad = level.stride_z * (u32(cell.z) + 1u) + level.stride_y * u32(cell.y) + u32(cell.x) / 4u;
    return f32(open_volume(quad)[u32(cell.x) % 4u]) * interpolant_part(cell);
}

@compute @workgroup_size(WG_SIZE)
fn take_landing(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] || marker_counts[LANDED] == 0u {
        return;
    }
    let quad = band_list[index];
    let first = quad_cell(level, quad);
    for (var axis = 0u; axis < 3u; axis++) {
        let own = axis * level.quads + quad;
        let weights = landing_weight[own];
        if all(weights == vec4<i32>()) {
            continue;
        }
        var u = velocity_next[own];
        for (var l = 0; l < 4; l++) {
            if weights[l] == 0 {
                continue;
            }
            let cell = first + vec3<i32>(l, 0, 0);
            let mass = 0.5 * (liquid_in(cell - along(axis)) + liquid_in(cell));
            let weight = MARKER_VOLUME * f32(weights[l]) / ONE;
            let momentum = MARKER_VOLUME * f32(landing_momentum[own][l]) / ONE * (step.dx / step.dt);
            u[l] = (mass * u[l] + momentum) / (mass + weight);
        }
        velocity_next[own] = u;
    }
}
