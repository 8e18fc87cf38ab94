// write_back with sources, last: restores the velocity of the faces of running sources, which are valid. One thread per face.
// level. source_step: state of the sources. faces: see source_face. open: apertures of all faces. valid: see valid;
// in place. velocity: u, m/s.
#import dispatch
#import layout
#import source_face
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> source_step: SourceStep;
@group(0) @binding(2) var<storage, read> faces: array<SourceFace>;
@group(0) @binding(3) var<storage, read> open: array<f32>;
@group(0) @binding(4) var<storage, read_write> valid: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn carry_faces(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= arrayLength(&faces) {
        return;
    }
    let face = faces[index].face;
    let carried = held(faces[index], source_step.running);
    if !carried.is || open[face] == 0.0 {
        return;
    }
    let axis = face / (4u * level.quads);
    let at = face - 4u * axis * level.quads;
    let bit = 4u * axis + at % 4u;
    velocity[face] = carried.velocity;
    atomicOr(&valid[at / 4u], 1u << bit);
}
