// Two-field preconditioner, for nodes: y = J^T z_p + Z1 t with t = Sh g_v, of which Sh y is z_v.
// coupling, words, node_pairs, flags: see coupling_force. freedom: see freedom. p: z_p, m/s. masses: zeta_M m, kg/s. t: over the mass rate of
// a cell. y: out.
#import coupling_force
#import dispatch
#import freedom
#import inner
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> p: array<Inner4>;
@group(0) @binding(6) var<storage, read> masses: array<Real>;
@group(0) @binding(7) var<storage, read> t: array<Real4>;
@group(0) @binding(8) var<storage, read_write> y: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_nodes(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let push = free_part(freedom[node], force(node));
    y[node] = Real4(push + Real(coupling.share) * masses[node] * t[node].xyz, Real(0.0));
}
