// advect_markers with a level, first of three: x1 = x + dt v(x + dt/2 v(x)) (explicit midpoint) in the velocity of the MAC field for markers of
// the liquid; in liquid that touches nothing they also fall by g dt^2 / 2. Spray flies: x1 = x + dt v + dt^2 g / 2, or to the first body on the way, v1 = v + dt g without the
// part of v1 into a wall or a body that stops it.
// All are clamped to 0.01 dx from walls. Markers beyond an open side are deleted and counted. One thread per used slot; deleted markers (w = 0)
// are unchanged.
// level, step. velocity: faces, m/s. distances: to bodies, cell centres, m; one quad in a scene without bodies. markers: x, y, z (m), w = 1 alive, 0
// deleted; in place. marker_velocity: of spray, m/s, w = 1 for spray; in place. report: see report. flags: see active. marker_counts: see
// marker_counts.
#import ballistic
#import dispatch
#import layout
#import step
#import sample_velocity
#import sample_distance
#import walls
#import report
#import marker_counts

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> velocity: array<f32>;
@group(0) @binding(3) var<storage, read> distances: array<f32>;
@group(0) @binding(4) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marker_velocity: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> report: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read> flags: array<u32>;
@group(0) @binding(8) var<storage, read_write> marker_counts: array<atomic<u32>>;

// Gradient (dimensionless) below which there is no direction: the middle of a solid. Also in push_out.
const SMALLEST_GRADIENT = 1e-6;

// A velocity at `end` (m) without its part into a wall or a body there, m/s.
fn stopped(end: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    let gap = vec3<f32>(WALL_GAP * step.dx);
    let kept = select(v, vec3<f32>(), (end < gap) | (end > step.size - gap));
    if arrayLength(&distances) <= 4u {
        return kept;
    }
    let solid = sample_distance(end * step.inv_dx);
    let steepness = length(solid.yzw);
    if solid.x >= 0.0 || steepness < SMALLEST_GRADIENT * step.dx {
        return kept;
    }
    let outwards = solid.yzw / steepness;
    return kept - min(dot(kept, outwards), 0.0) * outwards;
}

// Most pieces of a flight.
const MOST_PIECES = 256.0;

// End (m) of a flight from x (m) with v (m/s): where it first is in a body, looked for once a cell.
fn landing(x: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    let way = step.dt * v + step.dx * fall();
    if arrayLength(&distances) > 4u {
        let n = clamp(ceil(length(way) * step.inv_dx), 1.0, MOST_PIECES);
        for (var piece = 1.0; piece < n; piece += 1.0) {
            let t = step.dt * (piece / n);
            let at = x + t * v + (0.5 * t * t) * step.gravity;
            if sample_distance(at * step.inv_dx).x < 0.0 {
                return at;
            }
        }
    }
    return x + way;
}

@compute @workgroup_size(WG_SIZE)
fn advect_level_markers(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    let own = marker_velocity[index];
    var end: vec3<f32>;
    if own.w == 1.0 {
        end = landing(marker.xyz, own.xyz);
        marker_velocity[index] = vec4<f32>(stopped(end, own.xyz + step.dt * step.gravity), 1.0);
    } else {
        let middle = marker.xyz + 0.5 * step.dt * sample_velocity(marker.xyz * step.inv_dx);
        end = marker.xyz + step.dt * sample_velocity(middle * step.inv_dx);
        if is_ballistic(marker.xyz * step.inv_dx) {
            end += step.dx * fall();
        }
    }
    if beyond_open_side(end, step) {
        markers[index] = vec4<f32>(end, 0.0);
        atomicAdd(&report[LEAVING], 1u);
        if own.w == 1.0 {
            atomicAdd(&marker_counts[LEFT_SPRAY], 1u);
        }
        return;
    }
    markers[index] = vec4<f32>(inside_walls(end, step), 1.0);
}
