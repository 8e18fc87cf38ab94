// advect_velocity with a level and sources, first: subtracts half a sub-step of gravity from the velocities of the faces of running sources
// (reason in the twin, reference/exchange.rs). One thread per face.
// level, step. source_step: state of the sources. faces: see source_face. open: apertures of all faces. velocity: u, m/s; in place.
#import dispatch
#import layout
#import source_face
#import step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<uniform> source_step: SourceStep;
@group(0) @binding(3) var<storage, read> faces: array<SourceFace>;
@group(0) @binding(4) var<storage, read> open: array<f32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn rewind_sources(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&faces) {
        return;
    }
    let face = faces[index].face;
    let carried = held(faces[index], source_step.running);
    if carried.is && open[face] != 0.0 {
        velocity[face] = carried.velocity - 0.5 * step.dt * step.gravity[face / (4u * level.quads)];
    }
}
