// advect_markers, second of three: x1 = x + dt v(x + dt/2 v(x)) (explicit midpoint), kept 0.01 dx off the walls. v is the velocity of
// the MAC field and, near the surface, what that is ahead up there: by h / dx of the difference over one cell along the normal, where
// the surface stands h = r - 0.2 dx above the outermost markers, r the radius of their spheres; less and less from one to two cells
// below it; half a cell per sub-step at most.
// What ends beyond an open side is gone, and counted. One thread per marker; markers that are gone (w = 0) stay.
// level, step. velocity: faces, m/s. distances: signed, to the surface, cell centres, m. markers: x, y, z (m), w = 1 alive, 0 gone; in
// place. report: see report.
#import dispatch
#import layout
#import step
#import sample_velocity
#import sample_distance
#import walls
#import report

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> velocity: array<f32>;
@group(0) @binding(3) var<storage, read> distances: array<f32>;
@group(0) @binding(4) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> report: array<atomic<u32>>;

// The same numbers as in reference/advect_markers.rs.
// By how much less than the radius of their spheres the surface stands above the outermost markers, in cells.
const SPHERE_GAP = 0.2;
// How deep below it markers know of it, in cells; all that it does they do from one cell less on.
const DEEPEST = 2.0;
// How much further than others they move in a sub-step at most, in cells.
const MOST_AHEAD = 0.5;

// Of a marker at a position (cells), m/s. up: a cell out of the liquid at most, cells. ahead: by which share of the difference over that way
// the surface is.
fn velocity_below_surface(at: vec3<f32>, up: vec3<f32>, ahead: f32) -> vec3<f32> {
    let here = sample_velocity(at);
    if ahead == 0.0 {
        return here;
    }
    let more = ahead * (here - sample_velocity(at - up));
    let most = MOST_AHEAD * step.dx / step.dt;
    return here + more * (most / max(length(more), most));
}

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
    let surface = step.inv_dx * sample_distance(marker.xyz * step.inv_dx);
    let ahead = clamp(surface.x + DEEPEST, 0.0, 1.0) * (step.marker_radius - SPHERE_GAP);
    let middle = marker.xyz + 0.5 * step.dt * velocity_below_surface(marker.xyz * step.inv_dx, surface.yzw, ahead);
    let end = marker.xyz + step.dt * velocity_below_surface(middle * step.inv_dx, surface.yzw, ahead);
    if beyond_open_side(end, step) {
        markers[index] = vec4<f32>(end, 0.0);
        atomicAdd(&report[LEAVING], 1u);
        return;
    }
    markers[index] = vec4<f32>(inside_walls(end, step), 1.0);
}
