// Two-field PCG, start of a refinement step, first of four, for nodes: t = -Z1^-1 r_v of the scaled residual; direction and correction start from
// zero.
// coupling. norms: see refine. masses: zeta_M m, kg/s. outer: r_v, m/s. t: m/s, out. search: direction, then correction, out.
#import coupling
#import dispatch
#import real
#import refine

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> norms: array<Real>;
@group(0) @binding(2) var<storage, read> masses: array<Real>;
@group(0) @binding(3) var<storage, read> outer: array<Real4>;
@group(0) @binding(4) var<storage, read_write> t: array<Real4>;
@group(0) @binding(5) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_begin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    t[node] = -outer[node] * (Real(coupling.mass) / (norms[SCALE] * Real(coupling.share) * masses[node]));
    search[node] = Real4();
    search[coupling.n_nodes + node] = Real4();
}
