// advect_markers, first part: x1 = x + dt u(x + dt/2 u(x)) (explicit midpoint through the MAC field), kept 0.01 dx off the walls.
// What ends beyond an open side is gone, and counted. One thread per marker; markers that are gone (w = 0) stay.
// level, step. velocity: faces, m/s. markers: x, y, z (m), w = 1 alive, 0 gone; in place. report: see report.
#import dispatch
#import layout
#import step
#import sample_velocity
#import walls
#import report

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> velocity: array<f32>;
@group(0) @binding(3) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> report: array<atomic<u32>>;

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
    if beyond_open_side(end, step) {
        markers[index] = vec4<f32>(end, 0.0);
        atomicAdd(&report[LEAVING], 1u);
        return;
    }
    markers[index] = vec4<f32>(inside_walls(end, step), 1.0);
}
