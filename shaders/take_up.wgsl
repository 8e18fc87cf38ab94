// right_hand_side, second, with moving obstacles: subtracts their prescribed boundary flux from b. One thread per
// active quad.
// args, list: active quads. flags: see active. obstacle_flux: J v over dx^2, m/s. rhs: b, m/s; in place.
#import dispatch
#import lanes
#import active
#import real

@group(0) @binding(0) var<storage, read> args: array<u32>;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> obstacle_flux: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn take_up(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= args[3] {
        return;
    }
    let quad = active_quad(list[index]);
    let taken = obstacle_flux[quad];
    if any(taken != vec4<f32>()) {
        rhs[quad] -= select(Real4(), Real4(taken), bit_lanes(flags[quad]));
    }
}
