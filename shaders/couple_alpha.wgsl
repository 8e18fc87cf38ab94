// Two-field PCG, one workgroup, before pcg_alpha: sums over wet quads and nodes become the last of the partials of the active quads. The
// norm that ends a refinement step is that of g_p and of what is left of r_v, and not of g_v = Z2 Z1^-1 r_v, in which stiff modes hide the others.
// coupling. args: dispatch sizes and lengths. partials: those of the wet quads: s . q, r . q, q . q; then of the nodes: s . q.
// scalars: see pcg_slots. all_partials: out, one number.
#import coupling
#import fold
#import inner
#import pcg_slots
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read> scalars: array<Inner>;
@group(0) @binding(4) var<storage, read_write> all_partials: array<Inner4>;

@compute @workgroup_size(FOLD_SIZE)
fn couple_alpha(@builtin(local_invocation_index) lane: u32) {
    let of_quads = fold_from(0u, coupling.n_wet, lane);
    workgroupBarrier();
    let of_nodes = fold_from(coupling.n_wet, coupling.n_nodes, lane);
    if lane == 0u {
        let left = Real(scalars[WEIGHT]) * Real(scalars[LEFT_V]);
        all_partials[args[3]] = Inner4(Real4(of_quads.x + of_nodes.x, of_quads.y, of_quads.z, left));
    }
}
