// solve, for solids, active-set search: contribution of a node to phi(next) - phi(best), phi(v) = v . S v / 2 - F .
// v. It is evaluated as (next - best) . (S (best + next) / 2 - F), which does not cancel.
// One thread per node.
// step. incidence, products: see gather, zeta_K K (best + next). masses: zeta_M m, kg/s. rhs: F, in liquid F + J^T p,
// N. best, next: m/s. partials: the change in W, and three zeros, out.
#import dispatch
#import gather
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> incidence: array<u32>;
@group(0) @binding(2) var<storage, read> products: array<Real4>;
@group(0) @binding(3) var<storage, read> masses: array<Real>;
@group(0) @binding(4) var<storage, read> rhs: array<Real4>;
@group(0) @binding(5) var<storage, read> best: array<Real4>;
@group(0) @binding(6) var<storage, read> next: array<Real4>;
@group(0) @binding(7) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn measure_gain(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let start = best[node].xyz;
    let end = next[node].xyz;
    let product = masses[node] * (start + end) + gather(node, step.n_elements);
    partials[node] = Real4(dot(end - start, Real(0.5) * product - rhs[node].xyz), Real(), Real(), Real());
}
