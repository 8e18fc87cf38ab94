// Outer loop of the coupled solve, in the wet quads: the right-hand side of B phi = b - J v. A residual that took J v off afterwards would
// be the difference of squares that are equal in all digits. Closed components have it already (see couple_close).
// coupling, words, quad_pairs, flags: see coupling_flux. x: v, m/s. base: b, m/s. rhs: b - J v, out.
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
@group(0) @binding(5) var<storage, read> base: array<Real4>;
@group(0) @binding(6) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn couple_residual(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    rhs[quad] = base[wet] - select(flux(wet), Real4(), bit_lanes(flags[quad] >> CLOSED));
}
