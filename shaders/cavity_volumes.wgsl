// Stage right_hand_side, after cavity_roots: the open volume of the component in each cavity, as an integer, so that the order of the atomics does
// not matter. One thread per active quad where some component has no free surface.
// step. list: active quads. state, labels: see components. flags: see active. cavities: words of Cavity; volumes are 0 before. solid_distance: m.
#import active
#import component_sums
#import components
#import dispatch
#import filled

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> list: array<u32>;
@group(0) @binding(2) var<storage, read> state: array<u32>;
@group(0) @binding(3) var<storage, read> labels: array<u32>;
@group(0) @binding(4) var<storage, read> flags: array<u32>;
@group(0) @binding(5) var<storage, read_write> cavities: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read> solid_distance: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn cavity_volumes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= state[QUADS] {
        return;
    }
    let quad = active_quad(list[index]);
    let sealed = sealed_lanes(flags[quad]);
    if sealed == 0u {
        return;
    }
    let open = vec4<f32>(open_volume(quad));
    for (var l = 0u; l < 4u; l++) {
        let root = labels[4u * quad + l] & ~MARKS;
        for (var k = 0u; (sealed & (1u << l)) != 0u && k < arrayLength(&cavities) / 6u; k++) {
            if atomicLoad(&cavities[6u * k]) == root {
                // At most one cell: the high word is 0.
                let volume = fixed(open[l]).x;
                // The word before the addition tells whether it overflows; carries are as many in any order.
                let carry = u32(atomicAdd(&cavities[6u * k + 1u], volume) > ~volume);
                atomicAdd(&cavities[6u * k + 2u], carry);
            }
        }
    }
}
