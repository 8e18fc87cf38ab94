// Stage right_hand_side, after cavity_volumes: the source that keeps the volume of filled cavities, shared by open volume, over dx^2, m/s. One
// thread per active quad where some component has no free surface.
// step. list: active quads. state, labels: see components. flags: see active. cavities. solid_distance: m. rhs: b, m/s; in place.
#import active
#import components
#import cavities
#import dispatch
#import filled
#import real

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> state: array<u32>;
@group(0) @binding(3) var<storage, read> labels: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> cavities: array<Cavity>;
@group(0) @binding(6) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn fill_cavities(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= state[QUADS] {
        return;
    }
    let quad = active_quad(list[index]);
    let sealed = sealed_lanes(flags[quad]);
    if sealed == 0u {
        return;
    }
    // 1/s
    var rate = vec4<f32>();
    for (var l = 0u; l < 4u; l++) {
        let root = labels[4u * quad + l] & ~MARKS;
        for (var k = 0u; (sealed & (1u << l)) != 0u && k < arrayLength(&cavities); k++) {
            if cavities[k].root == root && is_filled(cavities[k]) {
                rate[l] += cavities[k].source / open_cells(cavities[k]);
            }
        }
    }
    if any(rate != vec4<f32>()) {
        rhs[quad] += Real4(rate) * open_volume(quad) * Real(step.dx);
    }
}
