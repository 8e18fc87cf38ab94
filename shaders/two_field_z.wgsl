// Two-field preconditioner, for nodes, last: z_v in the units of the system, and per thread g_v . z_v and |Z1 t|^2 with t = Sh g_v.
// coupling. r: g_v. masses: zeta_M m, kg/s. t: over the mass rate of a cell. z: over the mass rate of a cell in, z_v out. partials: those of the wet quads, then of the nodes.
#import coupling
#import dispatch
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> r: array<Real4>;
@group(0) @binding(2) var<storage, read> masses: array<Real>;
@group(0) @binding(3) var<storage, read> t: array<Real4>;
@group(0) @binding(4) var<storage, read_write> z: array<Real4>;
@group(0) @binding(5) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn two_field_z(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    let here = Real(coupling.mass) * z[node];
    z[node] = here;
    let inertia = Real(coupling.share) * masses[node] * t[node].xyz;
    partials[coupling.n_wet + node] = Real4(dot(r[node], here), dot(inertia, inertia), Real(0.0), Real(0.0));
}
