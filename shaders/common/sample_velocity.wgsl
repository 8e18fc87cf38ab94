// Trilinear samples of the face velocities, clamped to the range of the faces of each axis. The importing kernel
// declares level: Layout and velocity: array<f32>, the x, y and z faces one after another, m/s.
#import corner
#import layout

// The faces of an axis around a position, see faces_around.
fn sample_corner(axis: u32, corner: Corner) -> f32 {
    let f = corner.f;
    let row = 4u * level.stride_y;
    let slab = 4u * level.stride_z;
    let i = 4u * axis * level.quads + corner.low;
    let near = mix(mix(velocity[i], velocity[i + 1u], f.x), mix(velocity[i + row], velocity[i + row + 1u], f.x), f.y);
    let k = i + slab;
    let far = mix(mix(velocity[k], velocity[k + 1u], f.x), mix(velocity[k + row], velocity[k + row + 1u], f.x), f.y);
    return mix(near, far, f.z);
}

// at: position in cells, x / dx.
fn sample_face(axis: u32, at: vec3<f32>) -> f32 {
    return sample_corner(axis, faces_around(axis, at));
}

fn sample_velocity(at: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(sample_face(0u, at), sample_face(1u, at), sample_face(2u, at));
}
