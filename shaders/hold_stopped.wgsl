// solve, for solids, active-set search: constrains nodes on surfaces touched at the best velocity and penetrated at
// the minimiser, or all touched ones.
// One thread per node.
// step. gaps: see contact. best, velocity: m/s. freedom: see freedom, in place. answer: see ask; parameter: 1 to
// constrain all touched surfaces.
#import ask
#import contact
#import dispatch
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> best: array<Real4>;
@group(0) @binding(3) var<storage, read> velocity: array<Real4>;
@group(0) @binding(4) var<storage, read_write> freedom: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> answer: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn hold_stopped(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let here = freedom[node];
    let walls = gaps[node];
    let dt = Real(step.dt);
    let near = Real(f32(NEAR) * step.dx);
    let all_touching = answer[TOLD] > 0u;
    let v = best[node].xyz;
    let w = velocity[node].xyz;

    let goes_on = (wall_gaps(walls, w, dt) < Real3(-near)) | vec3<bool>(all_touching);
    let stopped = (wall_gaps(walls, v, dt) < Real3(near)) & goes_on;
    let walls_only = vec4<f32>(vec3<f32>(), f32(flags_of(free_components(here) & !stopped)));
    var next = walls_only;
    if arrayLength(&gaps) > step.n_nodes {
        let surface = gaps[step.n_nodes + node];
        let n = Real3(surface.xyz);
        let gap = Real(surface.w);
        let goes_on = gap + dt * dot(w, n) < -near || all_touching;
        if held_by_obstacle(here) || (gap + dt * dot(v, n) < near && goes_on) {
            next = held_along(walls_only, surface.xyz);
        }
    }
    freedom[node] = next;
}
