// right_hand_side, for solids, fourth part: velocity of constrained nodes along the normal, v . n = -gap / dt, which
// closes the gap.
// One thread per node.
// step. gaps: see contact. freedom: see freedom. velocity: m/s, in place.
#import contact
#import dispatch
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> velocity: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn hold_nodes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let here = freedom[node];
    let walls = gaps[node];
    let held = held_by_walls(walls, here);
    let by_obstacle = held_by_obstacle(here);
    if !(any(held) || by_obstacle) {
        return;
    }
    let dt = Real(step.dt);
    var v = select(velocity[node].xyz, -outwards(walls) * Real3(walls.xyz) / dt, held);
    if by_obstacle {
        let surface = gaps[step.n_nodes + node];
        let normal = Real3(surface.xyz);
        let direction = Real3(here.xyz);
        v += direction * ((-Real(surface.w) / dt - dot(v, normal)) / dot(direction, normal));
    }
    velocity[node] = Real4(v, Real());
}
