// Outer loop: r = P (rhs - S v), P on the free directions, from the elements and not from the blocks. One thread per node.
// rows. freedom: see freedom. incidence, products: see gather, zeta_K K v. masses: zeta_M m, then the mean of the
// diagonal of D, kg/s. x: v, m/s. rhs: N.
// outer: r, N, out. partials: |r|^2, squared norm of the terms that rhs sums, free directions, |D v|^2 (see refine_accept).
#import dispatch
#import freedom
#import gather
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> freedom: array<vec4<f32>>;
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
    let here = freedom[node];
    let scaled = free_part(here, masses[rows.n_nodes + node] * x[node].xyz);
    let residual = free_part(here, rhs[node].xyz - product);
    outer[node] = Real4(residual, Real(0.0));
    partials[node] = Real4(dot(residual, residual), rhs[node].w, Real(n_free(here)), dot(scaled, scaled));
}
