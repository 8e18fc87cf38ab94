// Two-field PCG, one workgroup, before pcg_beta: r . z of wet quads and nodes becomes the last of the partials of the active quads, and
// what the refinement step would leave of r_v if it ended here is estimated: with t = Sh g_v it is Z1 t, up to a factor of 1 / (1 - sigma).
// coupling. args: dispatch sizes and lengths. partials: those of the wet quads, then of the nodes: r . z, |Z1 t|^2. scalars: see
// pcg_slots. all_partials: out, one number.
#import coupling
#import fold
#import inner
#import pcg_slots
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> args: array<u32>;
@group(0) @binding(2) var<storage, read> partials: array<Real4>;
@group(0) @binding(3) var<storage, read_write> scalars: array<Inner>;
@group(0) @binding(4) var<storage, read_write> all_partials: array<Inner4>;

@compute @workgroup_size(FOLD_SIZE)
fn couple_beta(@builtin(local_invocation_index) lane: u32) {
    let of_quads = fold_from(0u, coupling.n_wet, lane);
    workgroupBarrier();
    let of_nodes = fold_from(coupling.n_wet, coupling.n_nodes, lane);
    if lane == 0u {
        all_partials[args[3]] = Inner4(Inner(of_quads.x + of_nodes.x), Inner(0.0), Inner(0.0), Inner(0.0));
        scalars[LEFT_V] = Inner(of_nodes.y);
    }
}
