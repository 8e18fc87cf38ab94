// Two-field PCG, start of a refinement step, second, for nodes: g_v = -Z2 t with t = -Z1^-1 r_v.
// coupling. freedom: see freedom. incidence, products: see gather, zeta_K K t. masses: zeta_M m, kg/s. t: m/s. r: g_v, out.
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
@group(0) @binding(6) var<storage, read> t: array<Real4>;
@group(0) @binding(7) var<storage, read_write> r: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_rhs(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    // S t less Z1 t.
    let rest = (Real(1.0) - Real(coupling.share)) * masses[node] * t[node].xyz;
    let z2t = free_part(freedom[node], rest + gather(node, rows.n_elements)) / Real(coupling.mass);
    r[node] = Real4(-z2t, Real(0.0));
}
