// landing, last of four: u_f := (M_f u_f + m P_f) / (M_f + m W_f) (see the twin, reference/landing.rs). One thread per quad of the band.
// level, step. band_args, band_list: the band. marker_counts: see marker_counts. liquid_distance, solid_distance: m. landing_momentum,
// landing_weight: P and W, see landing. velocity_next: faces, m/s; in place.
#import dispatch
#import filled
#import interpolant_part
#import landing
#import lanes
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

// Liquid in the cells of a quad, volumes of a cell; none beyond the domain.
fn liquid_in(quad: u32) -> vec4<f32> {
    let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
    if !any(exists) {
        return vec4<f32>();
    }
    return select(vec4<f32>(), vec4<f32>(open_volume(quad)) * interpolant_parts(quad), exists);
}

@compute @workgroup_size(WG_SIZE)
fn take_landing(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] || marker_counts[LANDED] == 0u {
        return;
    }
    let quad = band_list[index];
    for (var axis = 0u; axis < 3u; axis++) {
        let own = axis * level.quads + quad;
        let weights = landing_weight[own];
        if all(weights == vec4<i32>()) {
            continue;
        }
        let here = liquid_in(quad);
        var before = liquid_in(quad - vec3<u32>(1u, level.stride_y, level.stride_z)[axis]);
        if axis == 0u {
            before = shift_up(before, here);
        }
        let mass = 0.5 * (before + here);
        let weight = MARKER_VOLUME / ONE * vec4<f32>(weights);
        let momentum = MARKER_VOLUME / ONE * (step.dx / step.dt) * vec4<f32>(landing_momentum[own]);
        let u = velocity_next[own];
        velocity_next[own] = select(u, (mass * u + momentum) / (mass + weight), weights != vec4<i32>());
    }
}
