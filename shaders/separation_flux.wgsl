// solve for liquid and solids with separation, after a round, in the wet quads: b - J v of the separated lanes, which the evaluations of the
// residual leave out. One thread per wet quad.
// coupling, words, quad_pairs, flags: see coupling_flux; flags: separated lanes (see separation). x: v, m/s. base: b, m/s. rhs: b - J v in
// these lanes; in place.
#import coupling_flux
#import dispatch
#import lanes
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> x: array<Real4>;
@group(0) @binding(5) var<storage, read> base: array<Real4>;
@group(0) @binding(6) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn separation_flux(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    if (flags[quad] & 15u) != 0u {
        rhs[quad] = select(rhs[quad], base[wet] - flux(wet), bit_lanes(flags[quad]));
    }
}
