// move_solid, last part: u += dt v, and dt^2 g / 2 for ballistic bodies, as the sum of two f32, then projection of nodes beyond a domain wall onto it,
// with the velocity into it removed.
// Walls do not stop prescribed components. One thread per node.
// step. rest: m. flags: see node_flags. ballistic: 0 or 1. displacement: larger parts, then smaller, m; velocity: m/s; both in place.
#import dispatch
#import domain_walls
#import node_flags
#import pair
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read_write> displacement: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> velocity: array<Real4>;
@group(0) @binding(5) var<storage, read> ballistic: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn move_solid(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let rest_position = rest[node].xyz;
    let free = is_free(flags[node]);
    let v = velocity[node].xyz;
    let before = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
    var way = Real(step.dt) * v;
    if ballistic[node] != 0u {
        way += Real(0.5) * Real(step.dt) * Real(step.dt) * Real3(step.gravity);
    }
    let after = pair_plus(before, way, step.zero);
    let end = out_of_walls(rest_position, free, after, v, step.size, step.zero);
    displacement[node] = vec4<f32>(end.displacement.hi, 0.0);
    displacement[step.n_nodes + node] = vec4<f32>(end.displacement.lo, 0.0);
    if end.stopped {
        velocity[node] = Real4(end.velocity, Real());
    }
}
