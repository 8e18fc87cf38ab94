// extrapolate with solids, before slip: the velocities of the closest surface points beside cells. One thread per
// closest point.
// clipped: see cut_quad. places: nodes of a triangle, then bits of their weights; or of an obstacle. velocity: of the
// nodes, m/s. walls: see moving_walls.
#import cut_quad
#import dispatch
#import real

@group(0) @binding(0) var<uniform> clipped: Clipped;
@group(0) @binding(1) var<storage, read> places: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> velocity: array<Real4>;
@group(0) @binding(3) var<storage, read_write> walls: array<u32>;

@compute @workgroup_size(WG_SIZE)
fn wall_velocities(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let place = linear_index(workgroup, lane);
    if place >= clipped.n_places {
        return;
    }
    let nodes = places[2u * place];
    let bits = places[2u * place + 1u];
    let at = clipped.first + 3u * place;
    if nodes.x == NO_NODE {
        for (var axis = 0u; axis < 3u; axis++) {
            walls[at + axis] = bits[axis];
        }
        return;
    }
    let weights = bitcast<vec4<f32>>(bits);
    var sum = Real3();
    for (var corner = 0u; corner < 3u; corner++) {
        sum += Real(weights[corner]) * velocity[nodes[corner]].xyz;
    }
    for (var axis = 0u; axis < 3u; axis++) {
        walls[at + axis] = bitcast<u32>(f32(sum[axis]));
    }
}
