// Coupled solve, before the first refinement step, in the wet quads: keeps the right-hand side, from which J v is taken in every evaluation.
// coupling, words: see coupling. rhs: b, m/s. base: out.
#import coupling
#import dispatch
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> rhs: array<Real4>;
@group(0) @binding(3) var<storage, read_write> base: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_keep(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    base[wet] = rhs[words[wet]];
}
