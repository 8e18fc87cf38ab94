// advect_markers with obstacles, last of three: moves markers inside a solid to 0.1 dx outside its surface, along the
// gradient of the interpolated distance, at most twice. Markers still inside are dropped and counted.
// One thread per marker.
// level, step. distances: to obstacles, cell centres, m. markers: x, y, z (m), w = 1 alive, 0 dropped; in place.
// report: see report.
#import dispatch
#import layout
#import step
#import sample_distance
#import walls
#import report

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> distances: array<f32>;
@group(0) @binding(3) var<storage, read_write> markers: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> report: array<atomic<u32>>;

const TRIES = 2;
// Distance of a pushed marker from the surface, cells.
const CLEARANCE = 0.1;
// Gradient (dimensionless) below which there is no direction: the middle of a solid.
const SMALLEST_GRADIENT = 1e-6;

@compute @workgroup_size(WG_SIZE)
fn push_out(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= step.n_markers {
        return;
    }
    let marker = markers[index];
    if marker.w == 0.0 {
        return;
    }
    var x = marker.xyz;
    var solid = sample_distance(x * step.inv_dx);
    if solid.x >= 0.0 {
        return;
    }
    for (var t = 0; t < TRIES && solid.x < 0.0; t++) {
        let steepness = length(solid.yzw);
        if steepness >= SMALLEST_GRADIENT * step.dx {
            x += (CLEARANCE * step.dx - solid.x) / steepness * solid.yzw;
            x = inside_walls(x, step);
        }
        solid = sample_distance(x * step.inv_dx);
    }
    let alive = solid.x >= 0.0;
    markers[index] = vec4<f32>(x, f32(alive));
    if !alive {
        atomicAdd(&report[DROPPED], 1u);
    }
}
