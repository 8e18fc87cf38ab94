// Stage closed_components, with solids only, before the means are removed: in closed components, whose patches belong to prescribed nodes
// alone, what these take up goes to the right-hand side for good. One thread per wet quad.
// coupling, words, quad_pairs, flags, x: see coupling_flux; flags also closed lanes (see active). rhs: b, m/s, in place.
#import active
#import coupling_flux
#import dispatch
#import lanes
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> x: array<Real4>;
@group(0) @binding(5) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_close(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    let closed = bit_lanes(flags[quad] >> CLOSED);
    if any(closed) {
        rhs[quad] -= select(Real4(), flux(wet), closed);
    }
}
