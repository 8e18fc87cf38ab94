// advect_markers, first part: x1 = x + dt u(x + dt/2 u(x)) (explicit midpoint through the MAC field), kept 0.01 dx off the walls.
// One thread per marker; dropped markers (w = 0) stay.
// level, step. velocity: faces, m/s. markers: x, y, z (m), w = 1 alive, 0 dropped; in place.
#import dispatch
#import layout
#import step
#import sample_velocity
#import walls

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> velocity: array<f32>;
@group(0) @binding(3) var<storage, read_write> markers: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn advect_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let middle = marker.xyz + 0.5 * step.dt * sample_velocity(marker.xyz * step.inv_dx);
    let end = marker.xyz + step.dt * sample_velocity(middle * step.inv_dx);
    markers[index] = vec4<f32>(inside_walls(end, step), 1.0);
}
