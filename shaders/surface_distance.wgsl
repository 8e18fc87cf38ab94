// advect_markers, first of three: signed distance to the surface at cell centres.
// In air it is the liquid distance phi. In liquid it is recomputed from the air. No liquid is within phi of an air
// centre, so a cell at a distance d from it is at phi - d < 0. The result is the largest over the 5 x 5 x 5 cells
// around, at least -2 dx. Cells with their centre in a solid are excluded as sources and recomputed too.
// One thread per quad of the band.
// level, step. band_args, band_list: the band of the last sub-step. occupied: see classes. liquid_distance, surface
// (signed distance to it): m.
#import dispatch
#import layout
#import lanes
#import step
#import classes

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: Step;
@group(0) @binding(2) var<storage, read> band_args: array<u32>;
@group(0) @binding(3) var<storage, read> band_list: array<u32>;
@group(0) @binding(4) var<storage, read> occupied: array<u32>;
@group(0) @binding(5) var<storage, read> liquid_distance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> surface: array<vec4<f32>>;

// Neighbour cells per direction, and largest known depth, cells.
const REACH = 2;

// phi in air, else the largest depth.
fn air(quad: u32, cell: vec3<i32>) -> vec4<f32> {
    let phi = liquid_distance[quad];
    let room = lanes_inside(cell, vec3<i32>(level.cells)) & !bit_lanes(lanes_of(occupied[quad], NO_ROOM));
    return select(vec4<f32>(-f32(REACH) * step.dx), phi, room & (phi > vec4<f32>()));
}

// Largest contribution of a row of cells to four lanes; without air the largest depth or less. quad, cell: position
// of the lanes shifted to the row, which is in the domain. away: square of the shift, cells^2.
fn told(quad: u32, cell: vec3<i32>, away: f32) -> vec4<f32> {
    let before = air(quad - 1u, cell - vec3<i32>(4, 0, 0));
    let own = air(quad, cell);
    let after = air(quad + 1u, cell + vec3<i32>(4, 0, 0));
    let ways = step.dx * sqrt(vec3<f32>(away, away + 1.0, away + 4.0));
    let next = max(shift_up(before, own), shift_down(own, after));
    let second = max(vec4<f32>(before.zw, own.xy), vec4<f32>(own.zw, after.xy));
    return max(own - ways.x, max(next - ways.y, second - ways.z));
}

@compute @workgroup_size(WG_SIZE)
fn surface_distance(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let index = linear_index(workgroup, lane);
    if index >= band_args[3] {
        return;
    }
    let quad = band_list[index];
    let cell = quad_cell(level, quad);
    let own = air(quad, cell);
    if all(own > vec4<f32>()) {
        surface[quad] = own;
        return;
    }
    let rows = vec2<i32>(level.cells.yz);
    var deep = vec4<f32>(-f32(REACH) * step.dx);
    for (var z = -REACH; z <= REACH; z++) {
        for (var y = -REACH; y <= REACH; y++) {
            let row = cell + vec3<i32>(0, y, z);
            if all(row.yz >= vec2<i32>()) && all(row.yz < rows) {
                let there = i32(quad) + z * i32(level.stride_z) + y * i32(level.stride_y);
                deep = max(deep, told(u32(there), row, f32(y * y + z * z)));
            }
        }
    }
    surface[quad] = select(deep, own, own > vec4<f32>());
}
