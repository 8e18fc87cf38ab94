// forces with sources, last: sets the velocities of the running sources' faces, and closes these faces for the
// pressure. Closed faces are unchanged.
// One thread per face.
// source_step: state of the sources. faces: see source_face. open: apertures of all faces. solve_open: the
// same, but minus the aperture of the source's flux on its faces; in place. velocity_next: u*, m/s.
#import dispatch
#import source_face

@group(0) @binding(0) var<uniform> source_step: SourceStep;
@group(0) @binding(1) var<storage, read> faces: array<SourceFace>;
@group(0) @binding(2) var<storage, read> open: array<f32>;
@group(0) @binding(3) var<storage, read_write> solve_open: array<f32>;
@group(0) @binding(4) var<storage, read_write> velocity_next: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn hold_faces(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&faces) {
        return;
    }
    let face = faces[index].face;
    let carried = held(faces[index], source_step.running);
    if !carried.is || open[face] == 0.0 {
        return;
    }
    solve_open[face] = -min(open[face], carried.aperture);
    velocity_next[face] = carried.velocity;
}
