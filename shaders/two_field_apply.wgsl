// Two-field operator, for nodes, second half: q = Z2 (v - t).
// coupling, rows. freedom: see freedom. incidence, products: see gather, zeta_K K (v - t). masses: zeta_M m, kg/s. difference: v - t.
// q_out: q.
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
@group(0) @binding(6) var<storage, read> difference: array<Real4>;
@group(0) @binding(7) var<storage, read_write> q_out: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_apply(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let rest = (Real(1.0) - Real(coupling.share)) * masses[node] * difference[node].xyz;
    let q = free_part(freedom[node], rest + gather(node, rows.n_elements)) / Real(coupling.mass);
    q_out[node] = Real4(q, Real(0.0));
}
