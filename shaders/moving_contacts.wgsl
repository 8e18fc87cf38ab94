// right_hand_side, for solids, with moving obstacles: gap that a node at rest has after the next move, and whether the
// obstacle initially constrains the node (twin: reference/solid_contacts.rs).
// One thread per node.
// level, step. rest: m, kg. displacement: larger parts, then smaller, m. obstacle_of_cell: number of the nearest moving
// obstacle, from 1, or 0. obstacle_motions: velocity of the centre, m/s, angular velocity, rad/s, centre, m. rhs: forces,
// N. gaps: see contact, second section, in place; third, out. freedom: see freedom, in place.
#import contact
#import dispatch
#import layout
#import pair
#import real
#import solid_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: SolidStep;
@group(0) @binding(2) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> obstacle_of_cell: array<u32>;
@group(0) @binding(5) var<storage, read> obstacle_motions: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> rhs: array<Real4>;
@group(0) @binding(7) var<storage, read_write> gaps: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> freedom: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn moving_contacts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let u = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
    let x = vec3<f32>(Real3(rest[node].xyz) + pair_value(u));
    let number = obstacle_of_cell[cell_index(level, cell_of(level, x * step.inv_dx))];
    gaps[2u * step.n_nodes + node] = vec4<f32>();
    if number == 0u {
        return;
    }
    let first = 3u * (number - 1u);
    let arm = x - obstacle_motions[first + 2u].xyz;
    let velocity = obstacle_motions[first].xyz + cross(obstacle_motions[first + 1u].xyz, arm);
    let surface = gaps[step.n_nodes + node];
    let rate = dot(velocity, surface.xyz);
    let gap = surface.w - step.dt * rate;
    gaps[step.n_nodes + node].w = gap;
    gaps[2u * step.n_nodes + node].x = rate;
    let walls_only = vec4<f32>(vec3<f32>(), freedom[node].w);
    let force = free_part(walls_only, rhs[node].xyz);
    var next = walls_only;
    if gap <= SKIN * step.dx && dot(force, Real3(surface.xyz)) < Real(rate * rest[node].w / step.dt) {
        next = held_along(walls_only, surface.xyz);
    }
    freedom[node] = next;
}
