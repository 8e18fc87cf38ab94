// solve, for solids, before the first iteration of the active-set search: a feasible initial velocity, zero except
// for prescribed components and penetrating nodes.
// One thread per node.
// step. gaps: see contact. velocity: with prescribed components, m/s. best: m/s, out.
#import dispatch
#import put_back
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> velocity: array<Real4>;
@group(0) @binding(3) var<storage, read_write> best: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn rest_nodes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let free = is_free(u32(gaps[node].w));
    let rest = select(velocity[node].xyz, Real3(), free);
    best[node] = Real4(put_back(node, step.n_nodes, rest, Real(step.dt)), Real());
}
