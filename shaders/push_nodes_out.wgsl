// move_solid, second part, with obstacles only: nodes inside an obstacle move to its surface along the gradient of the
// interpolated distance, twice at most and as far as that is in the domain, and lose their velocity into it. Prescribed components stay,
// and so do nodes without a velocity, which were inside before: contact takes them out. One thread per node.
// level, step. rest: m. flags: see node_flags. distances: to obstacles, cell centres, m. displacement: larger parts, then smaller, m;
// velocity: m/s; both in place.
#import dispatch
#import domain_walls
#import layout
#import node_flags
#import pair
#import real
#import sample_distance
#import solid_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: SolidStep;
@group(0) @binding(2) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read> distances: array<f32>;
@group(0) @binding(5) var<storage, read_write> displacement: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> velocity: array<Real4>;

const TRIES = 2;
// Below this gradient (per unit length) there is no direction to go: the middle of an obstacle.
const SMALLEST_GRADIENT = 1e-6;

@compute @workgroup_size(WG_SIZE)
fn push_nodes_out(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    var v = velocity[node].xyz;
    if all(v == Real3()) {
        return;
    }
    let rest_position = Real3(rest[node].xyz);
    var u = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
    var distance = sample_distance(vec3<f32>(rest_position + pair_value(u)) * step.inv_dx);
    if distance.x >= 0.0 {
        return;
    }
    let free = is_free(flags[node]);
    for (var t = 0; t < TRIES && distance.x < 0.0; t++) {
        let steepness = length(distance.yzw);
        if steepness < SMALLEST_GRADIENT * step.dx {
            break;
        }
        let outwards = Real3(distance.yzw / steepness);
        u = pair_plus(u, select(Real3(), -Real(distance.x) * outwards, free), step.zero);
        v -= select(Real3(), min(dot(v, outwards), Real()) * outwards, free);
        let end = out_of_walls(rest[node].xyz, free, u, v, step.size, step.zero);
        u = end.displacement;
        v = end.velocity;
        distance = sample_distance(vec3<f32>(rest_position + pair_value(u)) * step.inv_dx);
    }
    displacement[node] = vec4<f32>(u.hi, 0.0);
    displacement[step.n_nodes + node] = vec4<f32>(u.lo, 0.0);
    velocity[node] = Real4(v, Real());
}
