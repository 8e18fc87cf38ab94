// Two-field operator, in the wet quads: q = q + J t, and per thread what that adds to s . q, r . q and q . q.
// coupling, words, quad_pairs, flags: see coupling_flux. x: t, m/s. search: direction s. r: residual. q: in place. partials: those of the wet
// quads, then of the nodes.
#import coupling_flux
#import dispatch
#import inner
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> x: array<Real4>;
@group(0) @binding(5) var<storage, read> search: array<Inner4>;
@group(0) @binding(6) var<storage, read> r: array<Inner4>;
@group(0) @binding(7) var<storage, read_write> q: array<Inner4>;
@group(0) @binding(8) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_apply(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let before = q[quad];
    let after = before + Inner4(flux(wet));
    q[quad] = after;
    let change = Real4(after) - Real4(before);
    partials[wet] = Real4(
        dot(Real4(search[quad]), change),
        dot(Real4(r[quad]), change),
        dot(change, Real4(after) + Real4(before)),
        Real(0.0),
    );
}
