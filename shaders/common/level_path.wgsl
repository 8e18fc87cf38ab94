// Velocities of cell centres for the transport of a level (see reference/advect_level.rs), and their traces.
// The importing kernel declares level, step and velocity: array<f32>, faces, m/s.
#import layout
#import step
#import trace

// Velocity at the centre of a cell by its index, m/s.
fn velocity_in(cell: u32) -> vec3<f32> {
    let y = 4u * level.quads + cell;
    let z = 8u * level.quads + cell;
    let low = vec3<f32>(velocity[cell], velocity[y], velocity[z]);
    let high = vec3<f32>(velocity[cell + 1u], velocity[y + 4u * level.stride_y], velocity[z + 4u * level.stride_z]);
    return 0.5 * (low + high);
}
