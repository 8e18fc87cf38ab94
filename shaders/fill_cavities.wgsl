// Stage right_hand_side, with cavities of solids: the source that keeps the volume of the liquid that fills one, V_c rate over dx^2, m/s. One thread
// per active quad where some component has no free surface.
// step. list: active quads. state, labels: see components. flags: see active. cavities: see cavity_roots. solid_distance: m. rhs: b, m/s; in place.
#import active
#import components
#import dispatch
#import filled
#import real

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> state: array<u32>;
@group(0) @binding(3) var<storage, read> labels: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read> cavities: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn fill_cavities(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= state[QUADS] {
        return;
    }
    let quad = active_quad(list[index]);
    let flag = flags[quad];
    let sealed = (flag >> SURFACELESS) & ~(flag >> CLOSED) & 0xfu;
    if sealed == 0u {
        return;
    }
    var rate = vec4<f32>();
    for (var l = 0u; l < 4u; l++) {
        let root = labels[4u * quad + l] & ~MARKS;
        for (var k = 0u; (sealed & (1u << l)) != 0u && k < arrayLength(&cavities); k++) {
            rate[l] += select(0.0, bitcast<f32>(cavities[k].y), cavities[k].x == root);
        }
    }
    if any(rate != vec4<f32>()) {
        rhs[quad] += Real4(rate) * open_volume(quad) * Real(step.dx);
    }
}
