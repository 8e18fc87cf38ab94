// Outer loop: r = rhs - S v on free components, 0 on prescribed ones, from the elements and not from the blocks. One thread per node.
// rows. flags: see node_flags. incidence, products: see gather, zeta_K K v. masses: zeta_M m, then the mean of the
// diagonal of D, kg/s. x: v, m/s. rhs: N.
// outer: r, N, out. partials: |r|^2, squared norm of the terms that rhs sums, free components, |D v|^2 (see refine_turn).
#import dispatch
#import gather
#import node_flags
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read> incidence: array<u32>;
@group(0) @binding(3) var<storage, read> products: array<Real4>;
@group(0) @binding(4) var<storage, read> masses: array<Real>;
@group(0) @binding(5) var<storage, read> x: array<Real4>;
@group(0) @binding(6) var<storage, read> rhs: array<Real4>;
@group(0) @binding(7) var<storage, read_write> outer: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_residual(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let product = masses[node] * x[node].xyz + gather(node, rows.n_elements);
    let free = is_free(flags[node]);
    let scaled = select(Real3(), masses[rows.n_nodes + node] * x[node].xyz, free);
    let residual = select(Real3(), rhs[node].xyz - product, free);
    outer[node] = Real4(residual, Real(0.0));
    partials[node] = Real4(dot(residual, residual), rhs[node].w, Real(countOneBits(flags[node] & 7u)), dot(scaled, scaled));
}
