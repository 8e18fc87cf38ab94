// forces, for solids: v* += dt g in free components; prescribed components are set to the prescribed velocity. One
// thread per node.
// step. flags: see node_flags. prescribed: m/s, a single zero for all nodes if no prescribed node moves. velocity:
// m/s, in place.
#import dispatch
#import node_flags
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read> prescribed: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> velocity: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn node_forces(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let falling = velocity[node].xyz + Real(step.dt) * Real3(step.gravity);
    let held = prescribed[min(node, arrayLength(&prescribed) - 1u)].xyz;
    velocity[node] = Real4(select(Real3(held), falling, is_free(flags[node])), Real());
}
