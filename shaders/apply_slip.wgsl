// extrapolate, after slip: copies the new velocities to the faces. One thread per quad of the band.
// level. band_args, band_list: the band. slipping: faces with a new velocity, bit 4 axis + lane. velocity_next: new
// velocities, m/s. velocity: faces, m/s.
#import dispatch
#import layout
#import valid

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<storage, read> band_args: array<u32>;
@group(0) @binding(2) var<storage, read> band_list: array<u32>;
@group(0) @binding(3) var<storage, read> slipping: array<u32>;
@group(0) @binding(4) var<storage, read> velocity_next: array<f32>;
@group(0) @binding(5) var<storage, read_write> velocity: array<f32>;

@compute @workgroup_size(WG_SIZE)
fn apply_slip(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    var faces = slipping[quad] & VALID;
    while faces != 0u {
        let bit = firstTrailingBit(faces);
        faces &= faces - 1u;
        let face = 4u * (bit / 4u * level.quads + quad) + bit % 4u;
        velocity[face] = velocity_next[face];
    }
}
