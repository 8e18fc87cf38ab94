// diagnose with a level, before the volumes: sums over the markers that fly. One thread per used slot.
// step. markers: x, y, z (m), w = 1 alive. marker_velocity: m/s, w = 1 for spray. marker_args: used slots. spray_sums: see spray_sums; zero before.
#import dispatch
#import spray_sums
#import step

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> markers: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> marker_velocity: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> marker_args: array<u32>;
@group(0) @binding(4) var<storage, read_write> spray_sums: array<atomic<u32>>;

fn add(sum: u32, value: f32) {
    let quanta = bitcast<u32>(i32(round(clamp(QUANTA * value, -2e9, 2e9))));
    let carry = u32(atomicAdd(&spray_sums[2u * sum], quanta) > ~quanta);
    // The upper word of a negative number is that of -1.
    let upper = select(0u, 0xffffffffu, (quanta >> 31u) == 1u) + carry;
    if upper != 0u {
        atomicAdd(&spray_sums[2u * sum + 1u], upper);
    }
}

@compute @workgroup_size(WG_SIZE)
fn sum_spray(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= marker_args[3] {
        return;
    }
    let marker = markers[index];
    let velocity = marker_velocity[index];
    if marker.w == 0.0 || velocity.w == 0.0 {
        return;
    }
    let way = step.dt * step.inv_dx * velocity.xyz;
    add(0u, 1.0);
    add(1u, way.x);
    add(2u, way.y);
    add(3u, way.z);
    add(4u, dot(way, way));
    let strength = length(step.gravity);
    add(5u, dot(step.gravity, marker.xyz) * step.inv_dx / max(strength, 1e-30));
}
