// Two-field PCG, start of a refinement step, third, in the wet quads: g_p = r_p + J t with t = -Z1^-1 r_v, and per thread what that adds to |g_p|^2.
// coupling, words, quad_pairs, flags: see coupling_flux. x: t, m/s. r: r_p in, g_p out. partials: those of the wet quads, then of the nodes.
#import coupling_flux
#import dispatch
#import inner
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> x: array<Real4>;
@group(0) @binding(5) var<storage, read_write> r: array<Inner4>;
@group(0) @binding(6) var<storage, read_write> partials: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_begin(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let before = r[quad];
    let after = before + Inner4(flux(wet));
    r[quad] = after;
    partials[wet] = Real4(dot(Real4(after) - Real4(before), Real4(after) + Real4(before)), Real(0.0), Real(0.0), Real(0.0));
}
