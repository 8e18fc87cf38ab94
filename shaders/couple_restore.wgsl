// Two-field preconditioner, in the wet quads, after the V-cycle: g_p is put back, and r . z corrected by what the V-cycle had instead.
// coupling, words: see coupling. kept: g_p. z: z_p. r: out. partials: those of the wet quads, then of the nodes.
#import coupling
#import dispatch
#import inner
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> kept: array<Inner4>;
@group(0) @binding(3) var<storage, read> z: array<Inner4>;
@group(0) @binding(4) var<storage, read_write> r: array<Inner4>;
@group(0) @binding(5) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_restore(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let before = kept[wet];
    partials[wet] = Real4(dot(Real4(before) - Real4(r[quad]), Real4(z[quad])), Real(0.0), Real(0.0), Real(0.0));
    r[quad] = before;
}
