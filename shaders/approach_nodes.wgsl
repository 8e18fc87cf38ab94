// solve, for solids, active-set search: a fraction of the step from the best velocity to the minimiser, with each
// node projected to feasibility.
// One thread per node.
// step. gaps: see contact. answer: see ask; parameter: bits of the fraction. best, velocity: from and to, m/s. next:
// m/s, out. sums: best + next, m/s, out.
#import ask
#import dispatch
#import put_back
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> gaps: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> answer: array<u32>;
@group(0) @binding(3) var<storage, read> best: array<Real4>;
@group(0) @binding(4) var<storage, read> velocity: array<Real4>;
@group(0) @binding(5) var<storage, read_write> next: array<Real4>;
@group(0) @binding(6) var<storage, read_write> sums: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn approach_nodes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let share = Real(bitcast<f32>(answer[TOLD]));
    let start = best[node].xyz;
    let way = velocity[node].xyz - start;
    let back = put_back(node, step.n_nodes, start + share * way, Real(step.dt));
    next[node] = Real4(back, Real());
    sums[node] = Real4(start + back, Real());
}
