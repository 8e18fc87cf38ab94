// Outer loop of the coupled solve, one workgroup: sums over the nodes into the norms.
// coupling. partials: those of the wet quads, then of the nodes. norms: see refine.
#import coupling
#import fold
#import refine

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> partials: array<Real4>;
@group(0) @binding(2) var<storage, read_write> norms: array<Real>;

@compute @workgroup_size(FOLD_SIZE)
fn coupled_sums(@builtin(local_invocation_index) lane: u32) {
    let of_nodes = fold_from(coupling.n_wet, coupling.n_nodes, lane);
    if lane == 0u {
        let at = evaluation_slot(1u, 2u);
        norms[at] = of_nodes.x;
        norms[at + 1u] = of_nodes.y;
        norms[at + 2u] = of_nodes.z;
        norms[at + 3u] = of_nodes.w;
    }
}
