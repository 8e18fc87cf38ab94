// Coupled solve, one thread, once the active cells are known: dispatch sizes and lengths of all its lists. The first slot, whose list is
// the active quads, is made as large as the largest of the lists that updates, evaluations and starts of refinement steps work on; their kernels look at
// lengths.
// coupling. from: dispatch size and length of the list of each level. sizes: what does not change, after the levels: nodes, solids,
// wet quads, a slot for the partials, the length of folded partials. args: out.
#import coupling

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> from_args: array<u32>;
@group(0) @binding(2) var<storage, read> sizes: array<u32>;
@group(0) @binding(3) var<storage, read_write> args: array<u32>;

// Slots in sizes.
const NODES = 0u;
const WET = 2u;
const PARTIALS = 3u;
const N_SIZES = 5u;

fn workgroups(slot: u32) -> u32 {
    return sizes[4u * slot] * sizes[4u * slot + 1u] * sizes[4u * slot + 2u];
}

@compute @workgroup_size(1)
fn coupled_args() {
    let n_levels = arrayLength(&args) / 4u - N_SIZES;
    for (var word = 0u; word < 4u * n_levels; word++) {
        args[word] = from_args[word];
    }
    for (var word = 0u; word < 4u * N_SIZES; word++) {
        args[4u * n_levels + word] = sizes[word];
    }
    // What couples adds one partial to those of the active quads.
    args[4u * (n_levels + PARTIALS) + 3u] = from_args[3] + 1u;
    var largest = from_args[0] * from_args[1] * from_args[2];
    for (var slot = 0u; slot <= WET; slot++) {
        if workgroups(slot) > largest {
            largest = workgroups(slot);
            args[0] = sizes[4u * slot];
            args[1] = sizes[4u * slot + 1u];
            args[2] = sizes[4u * slot + 2u];
        }
    }
}
