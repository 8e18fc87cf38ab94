// Two-field operator, for nodes, first half: t = Z1^-1 (J^T p - Z2 v) and v - t of a direction (p, v).
// coupling, rows. freedom: see freedom. incidence, products: see gather, zeta_K K v. masses: zeta_M m, kg/s. search: v, m/s.
// t: J^T p in, t out. difference: v - t, out. partials: those of the wet quads, then of the nodes: v . q = Z2 v . (v - t).
#import coupling
#import dispatch
#import freedom
#import gather
#import real
#import rows

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<uniform> rows: Rows;
@group(0) @binding(2) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> incidence: array<u32>;
@group(0) @binding(4) var<storage, read> products: array<Real4>;
@group(0) @binding(5) var<storage, read> masses: array<Real>;
@group(0) @binding(6) var<storage, read> search: array<Real4>;
@group(0) @binding(7) var<storage, read_write> t: array<Real4>;
@group(0) @binding(8) var<storage, read_write> difference: array<Real4>;
@group(0) @binding(9) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_half(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let v = search[node].xyz;
    let z1 = Real(coupling.share) * masses[node];
    let z2v = (masses[node] - z1) * v + gather(node, rows.n_elements);
    let mass = Real(coupling.mass);
    let half = free_part(freedom[node], mass * t[node].xyz - z2v) / z1;
    let difference_here = v - half;
    t[node] = Real4(half, Real(0.0));
    difference[node] = Real4(difference_here, Real(0.0));
    partials[coupling.n_wet + node] = Real4(dot(z2v, difference_here) / mass, Real(0.0), Real(0.0), Real(0.0));
}
