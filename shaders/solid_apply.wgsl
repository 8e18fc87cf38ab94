// PCG for solids: q = P S s, P on the free directions, and per thread s . q, r . q, q . q and r . r. One thread per node.
// rows. freedom: see freedom. incidence, products: see gather, zeta_K K s. masses: zeta_M m (and more). x: search direction s. r: residual.
// q_out: q. partials: sums.
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
@group(0) @binding(6) var<storage, read> r: array<Real4>;
@group(0) @binding(7) var<storage, read_write> q_out: array<Real4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_apply(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let s = x[node].xyz;
    let q = free_part(freedom[node], masses[node] * s + gather(node, rows.n_elements));
    let residual = r[node].xyz;
    q_out[node] = Real4(q, Real(0.0));
    partials[node] = Real4(dot(s, q), dot(residual, q), dot(q, q), dot(residual, residual));
}
