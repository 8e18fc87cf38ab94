// solve, for solids, after a solve: counts penetrating nodes and adhering contacts at the velocities v, and with the
// parameter 1 releases the adhering ones.
// The contact force is S v - F; over the mean diagonal of S, times dt, it is a length. One thread per node.
// step. gaps: see contact. incidence, products: see gather, zeta_K K v. masses: zeta_M m, then the mean of the
// diagonal of D, kg/s. rhs: F, in liquid F + J^T p, N. velocity: v, m/s. freedom: see freedom, in place. answer: see
// ask; both counts, incremented.
#import ask
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
@group(0) @binding(8) var<storage, read_write> answer: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn judge_contacts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let here = freedom[node];
    let walls = gaps[node];
    let dt = Real(step.dt);
    let near = Real(f32(NEAR) * step.dx);
    let v = velocity[node].xyz;
    let push = (dt / masses[step.n_nodes + node]) * ((masses[node] * v + gather(node, step.n_elements)) - rhs[node].xyz);
    let with_obstacles = arrayLength(&gaps) > step.n_nodes;

    // The walls' share of the contact force: the remainder of the obstacle's.
    var left = push;
    var beyond = 0u;
    var pulled = 0u;
    var obstacle_pulls = false;
    if with_obstacles {
        let surface = gaps[step.n_nodes + node];
        let n = Real3(surface.xyz);
        let direction = Real3(held_along(vec4<f32>(vec3<f32>(), here.w), surface.xyz).xyz);
        if any(direction != Real3()) {
            if held_by_obstacle(here) {
                let share = dot(push, direction) / dot(direction, n);
                left -= share * n;
                obstacle_pulls = share < -near;
                pulled += u32(obstacle_pulls);
            } else {
                beyond += u32(Real(surface.w) + dt * dot(v, n) < -near);
            }
        }
    }
    let held = held_by_walls(walls, here);
    let walls_pull = held & (outwards(walls) * left < Real3(-near));
    let walls_passed = is_free(u32(walls.w)) & !held & (wall_gaps(walls, v, dt) < Real3(-near));
    pulled += countOneBits(flags_of(walls_pull));
    beyond += countOneBits(flags_of(walls_passed));
    if beyond > 0u {
        atomicAdd(&answer[BEYOND], beyond);
    }
    if pulled == 0u {
        return;
    }
    atomicAdd(&answer[PULLED], pulled);
    if atomicLoad(&answer[TOLD]) > 0u {
        let walls_only = vec4<f32>(vec3<f32>(), f32(flags_of(free_components(here) | walls_pull)));
        if held_by_obstacle(here) && !obstacle_pulls {
            freedom[node] = held_along(walls_only, gaps[step.n_nodes + node].xyz);
        } else {
            freedom[node] = walls_only;
        }
    }
}
