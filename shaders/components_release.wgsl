// Stage closed_components, where closed liquid opens, before the roots are counted for good: marks the roots of its components. The cells
// whose walls recede count as separated before. One thread per cell of the list.
// receding: scalar indices of these cells, NONE after the last. flags: see active. labels, state: see components. separated_before: see
// separation.
#import dispatch
#import find

@group(0) @binding(0) var<storage, read> receding: array<u32>;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read_write> labels: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> state: array<atomic<u32>>;
@group(0) @binding(4) var<storage, read_write> separated_before: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn components_release(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&receding) || receding[index] == NONE {
        return;
    }
    let cell = receding[index];
    let bit = 1u << (cell % 4u);
    atomicOr(&separated_before[cell / 4u], bit);
    if (flags[cell / 4u] & bit) == 0u {
        return;
    }
    let root = find(cell);
    if (atomicLoad(&labels[root]) & OPEN) == 0u && (atomicOr(&labels[root], OPEN) & OPEN) == 0u {
        // Modulo 2^32, as in components_open.
        atomicSub(&state[COUNTER], 1u);
    }
}
