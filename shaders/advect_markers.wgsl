// advect_markers, second of three: x1 = x + dt v(x + dt/2 v(x)) (explicit midpoint), clamped to 0.01 dx from walls.
// v is the velocity of the MAC field. Near the surface it is extrapolated to the surface: plus h / dx of its
// difference over one cell along the normal. h = r - 0.2 dx is the height of the surface above the outermost markers,
// r the radius of their spheres. The addition decreases from one to two cells below the surface and is
// limited to half a cell per sub-step.
// Markers in liquid that touches nothing also fall by g dt^2 / 2.
// Markers beyond an open side are deleted and counted. One thread per marker; deleted markers (w = 0) are unchanged.
// level, step. velocity: faces, m/s. distances: signed distance to the surface, cell centres, m. markers: x, y, z
// (m), w = 1 alive, 0 deleted; in place. report: see report. flags: see active.
#import ballistic
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
@group(0) @binding(6) var<storage, read> flags: array<u32>;

// The constants of reference/advect_markers.rs.
// Mean difference between the radius of the spheres and the height of the surface above the outermost markers, cells.
const SPHERE_GAP = 0.2;
// Depth below which markers move with their own velocity, cells; up to one cell less they move with that of the
// surface.
const DEEPEST = 2.0;
// Largest additional displacement per sub-step, cells.
const MOST_AHEAD = 0.5;

// Velocity of the surface above a marker at a position (cells), m/s. up: vector out of the liquid, at most one cell
// long, cells. ahead: factor of the velocity difference over it.
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
    var end = marker.xyz + step.dt * velocity_below_surface(middle * step.inv_dx, surface.yzw, ahead);
    if is_ballistic(marker.xyz * step.inv_dx) {
        end += step.dx * fall();
    }
    if beyond_open_side(end, step) {
        markers[index] = vec4<f32>(end, 0.0);
        atomicAdd(&report[LEAVING], 1u);
        return;
    }
    markers[index] = vec4<f32>(inside_walls(end, step), 1.0);
}
