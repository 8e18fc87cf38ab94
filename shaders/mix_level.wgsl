// redistance, after the passes: the level where it is small, and the distance is or the cell is in a body or air beside it, else the distance
// with its sign. Sets cells in bodies that no pass of the extension reached to air. One thread per quad of the band.
// step. band_args, band_list: the band. solid_distance: m. distances: cells, see start_redistance. new_level: cells, in place. mixed: cells,
// out.
#import dispatch
#import level_values
#import step
#import unknown

@group(0) @binding(0) var<storage, read> band_args: array<u32>;
@group(0) @binding(1) var<storage, read> band_list: array<u32>;
@group(0) @binding(2) var<storage, read> distances: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> new_level: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> mixed: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> solid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<uniform> step: Step;

// The constants of reference/redistance.rs and liquid_distance.rs, cells.
// Distance to the interface or to a body within which the level is relaxed instead of replaced.
const NEAR = 2.5;
// Level beyond which it is replaced within that distance too.
const FAR = 3.5;

@compute @workgroup_size(WG_SIZE)
fn mix_level(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var phi = new_level[quad];
    let unknown = phi >= vec4<f32>(UNKNOWN);
    if any(unknown) {
        phi = select(phi, vec4<f32>(AIR_IN_BODIES), unknown);
        new_level[quad] = phi;
    }
    let distance = abs(distances[quad]);
    let of_bodies = solid_distance[min(quad, arrayLength(&solid_distance) - 1u)];
    let extended = of_bodies < vec4<f32>();
    let air_at_body = (phi >= vec4<f32>()) & (of_bodies < vec4<f32>(NEAR * step.dx));
    let near = ((distance < vec4<f32>(NEAR)) | extended | air_at_body) & (abs(phi) < vec4<f32>(FAR));
    mixed[quad] = select(select(distance, -distance, phi < vec4<f32>()), phi, near);
}
