// solve, for solids, after a solve: holds nodes that are beyond a wall or obstacle with the velocities found, and lets those go that it
// would have to pull, as long as any may be let go. The push of what holds a node is S v - F; over the mean of the diagonal of S,
// times dt, it is a length. One thread per node.
// step. gaps: see contact. incidence, products: see gather, zeta_K K v. masses: zeta_M m, then the mean of the diagonal of D, kg/s.
// rhs: F, in liquid F + J^T p, N. velocity: v, m/s. freedom: see freedom, in place. changes: how many, added; then 1 if nodes may be let go.
#import contact
#import dispatch
#import gather
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> incidence: array<u32>;
@group(0) @binding(3) var<storage, read> products: array<Real4>;
@group(0) @binding(4) var<storage, read> masses: array<Real>;
@group(0) @binding(5) var<storage, read> rhs: array<Real4>;
@group(0) @binding(6) var<storage, read> velocity: array<Real4>;
@group(0) @binding(7) var<storage, read_write> freedom: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> changes: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn update_contacts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let here = freedom[node];
    let walls = gaps[node];
    let dt = Real(step.dt);
    let near = Real(f32(NEAR) * step.dx);
    let v = velocity[node].xyz;
    let push = (masses[node] * v + gather(node, step.n_elements)) - rhs[node].xyz;
    let softness = dt / masses[step.n_nodes + node];

    let held = held_by_walls(walls, here);
    let sign = outwards(walls);
    let way = select(Real3(walls.xyz) + dt * sign * v, softness * sign * push, held);
    let lets_go = atomicLoad(&changes[1]) > 0u;
    let changed = is_free(u32(walls.w)) & (way < Real3(-near)) & (!held | vec3<bool>(lets_go));
    var count = countOneBits(flags_of(changed));
    let walls_only = vec4<f32>(vec3<f32>(), f32(flags_of(free_components(here) != changed)));
    var next = walls_only;

    if arrayLength(&gaps) > step.n_nodes {
        let surface = gaps[step.n_nodes + node];
        let direction = held_along(vec4<f32>(vec3<f32>(), here.w), surface.xyz).xyz;
        var by_obstacle = any(here.xyz != vec3<f32>());
        if any(direction != vec3<f32>()) {
            let beyond = Real(surface.w) + dt * dot(v, Real3(surface.xyz));
            let pushed = softness * dot(push, Real3(direction));
            if select(beyond, pushed, by_obstacle) < -near && (lets_go || !by_obstacle) {
                by_obstacle = !by_obstacle;
                count++;
            }
        }
        if by_obstacle {
            next = held_along(walls_only, surface.xyz);
        }
    }
    if count > 0u {
        freedom[node] = next;
        atomicAdd(&changes[0], count);
    }
}
