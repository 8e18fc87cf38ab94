// liquid_distance with obstacles, after the extension: sets cells that no pass reached to air. One thread per quad of
// the band.
// step. band_args, band_list: the band. distance_in, distance_out: m.
#import dispatch
#import step
#import unknown

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> distance_in: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> distance_out: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn finish_extension(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let phi = distance_in[quad];
    distance_out[quad] = select(phi, vec4<f32>(step.dx), phi >= vec4<f32>(UNKNOWN));
}
