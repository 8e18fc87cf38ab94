// extrapolate, before slip, with moving obstacles and without solids: the velocities of the obstacles beside cells.
// One thread per closest point.
// clipped: see cut_quad. places: NO_NODE, then bits of a velocity, m/s. walls: see moving_walls.
#import cut_quad
#import dispatch

@group(0) @binding(0) var<uniform> clipped: Clipped;
@group(0) @binding(1) var<storage, read> places: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> walls: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn obstacle_velocities(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let place = linear_index(workgroup, lane);
    if place >= clipped.n_places {
        return;
    }
    let bits = places[2u * place + 1u];
    let at = clipped.first + 3u * place;
    for (var axis = 0u; axis < 3u; axis++) {
        walls[at + axis] = bits[axis];
    }
}
