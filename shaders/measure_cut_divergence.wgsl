// diagnose with solids, third of four: the largest |E u - J v| / dx^3 of an active cell in quads with patches, 1/s.
// One thread per such quad.
// level, step. coupling, words, quad_pairs, flags, x: see coupling_flux. velocity: faces, m/s. open: apertures. maxima:
// bits, second.
#import coupling_flux
#import dispatch
#import divergence
#import flux
#import layout
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> coupling: Coupling;
@group(0) @binding(3) var<storage, read> words: array<u32>;
@group(0) @binding(4) var<storage, read> quad_pairs: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> flags: array<u32>;
@group(0) @binding(6) var<storage, read> x: array<Real4>;
@group(0) @binding(7) var<storage, read> velocity: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> open: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> maxima: array<atomic<u32>>;

@compute @workgroup_size(WG_SIZE)
fn measure_cut_divergence(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let wet = linear_index(workgroup, lane);
    if wet >= coupling.n_wet {
        return;
    }
    let quad = words[wet];
    note_divergence(quad, net_inflow(quad) - flux(wet));
}
