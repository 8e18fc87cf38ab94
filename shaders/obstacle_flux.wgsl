// clip, last, with moving obstacles: scatters the prescribed boundary flux of the cut quads, and zero to quads no
// longer cut. One thread per quad.
// clipped, entries: see cut_quad. fluxes: of the entries. flux: J v over dx^2 per quad, m/s.
#import cut_quad
#import dispatch

@group(0) @binding(0) var<uniform> clipped: Clipped;
@group(0) @binding(1) var<storage, read> entries: array<CutQuad>;
@group(0) @binding(2) var<storage, read> fluxes: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> flux: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn obstacle_flux(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= clipped.n_quads {
        return;
    }
    flux[entries[index].quad] = fluxes[index];
}
