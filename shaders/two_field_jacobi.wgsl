// Jacobi preconditioner of the two-field system, for nodes: z_v, and per thread g_v . z_v and |Z1 t|^2 with t = Sh g_v, by which rounds end.
// coupling. r: g_v. diagonal: see two_field_diagonal. freedom: see freedom. masses: zeta_M m, kg/s. t: over the mass rate of a cell. z: out.
// partials: those of the wet quads, then of the nodes.
#import coupling
#import dispatch
#import freedom
#import real
#import symmetric

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> r: array<Real4>;
@group(0) @binding(2) var<storage, read> diagonal: array<Real4>;
@group(0) @binding(3) var<storage, read> freedom: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> masses: array<Real>;
@group(0) @binding(5) var<storage, read> t: array<Real4>;
@group(0) @binding(6) var<storage, read_write> z: array<Real4>;
@group(0) @binding(7) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_jacobi(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let inverse = Symmetric(diagonal[node].xyz, diagonal[coupling.n_nodes + node].xyz);
    let here = free_part(freedom[node], times(inverse, r[node].xyz));
    z[node] = Real4(here, Real(0.0));
    let inertia = Real(coupling.share) * masses[node] * t[node].xyz;
    partials[coupling.n_wet + node] = Real4(dot(r[node].xyz, here), dot(inertia, inertia), Real(0.0), Real(0.0));
}
