// right_hand_side, with volume_shift: adds the source of an excess e of markers, V_c clamp(e, +-1) / t over dx^2, m/s,
// t = max(2.5 t_f, 1.5 dt). One thread per active quad.
// step. args, list: active quads. flags: see active. excess: e. solid_distance: m. rhs: b, m/s; in place.
#import active
#import dispatch
#import filled
#import lanes
#import real

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> list: array<u32>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> excess: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> rhs: array<Real4>;

// The constants of reference/excess.rs: time in which an excess expands, in times of control and in sub-steps.
const TIMES = vec2<f32>(2.5, 1.5);

@compute @workgroup_size(WG_SIZE)
fn add_excess(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    let e = clamp(excess[quad], vec4<f32>(-1.0), vec4<f32>(1.0));
    if any(e != vec4<f32>()) {
        let time = max(TIMES.x * step.control_time, TIMES.y * step.dt);
        let source = Real4(e) * open_volume(quad) * (Real(step.dx) / Real(time));
        rhs[quad] += select(Real4(), source, bit_lanes(flags[quad]));
    }
}
