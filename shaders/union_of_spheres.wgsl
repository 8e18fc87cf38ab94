// liquid_distance, fourth of five: phi = min(2 dx, distance to the nearest marker) - r (Zhu and Bridson 2005), - dx
// in cells surrounded by liquid, + dx outside the domain, unknown in solids.
// One thread per quad of the band.
// step. band_args, band_list: the band. occupied, classes: see classes. liquid_distance: squares (cells^2) in, m out.
#import dispatch
#import step
#import lanes
#import classes
#import unknown

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> occupied: array<u32>;
@group(0) @binding(5) var<storage, read> classes: array<u32>;
@group(0) @binding(6) var<storage, read_write> liquid_distance: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn union_of_spheres(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let near = bit_lanes(lanes_of(classes[quad], NEAR));
    var phi = select(vec4<f32>(-step.dx), step.dx * (sqrt(liquid_distance[quad]) - step.marker_radius), near);
    let no_room = lanes_of(occupied[quad], NO_ROOM);
    if no_room != 0u {
        let exists = lanes_inside(quad_cell(level, quad), vec3<i32>(level.cells));
        phi = select(phi, select(vec4<f32>(step.dx), vec4<f32>(UNKNOWN), exists), bit_lanes(no_room));
    }
    liquid_distance[quad] = phi;
}
