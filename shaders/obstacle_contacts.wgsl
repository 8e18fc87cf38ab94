// right_hand_side, for solids, third part, with obstacles: normal and gap at each node, and whether the obstacle
// initially constrains it.
// One thread per node.
// level, step. rest: m. displacement: larger parts, then smaller, m. distances: to obstacles, cell centres, m. rhs:
// forces, N. gaps: see contact, second section, out. freedom: see freedom, in place.
#import contact
#import dispatch
#import layout
#import pair
#import real
#import sample_distance
#import solid_step

@group(0) @binding(0) var<uniform> level: Layout;
@group(0) @binding(1) var<uniform> step: SolidStep;
@group(0) @binding(2) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> distances: array<f32>;
@group(0) @binding(5) var<storage, read> rhs: array<Real4>;
@group(0) @binding(6) var<storage, read_write> gaps: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> freedom: array<vec4<f32>>;

// Gradient (dimensionless) below which there is no normal: far from the obstacle, or in its middle.
const SMALLEST_GRADIENT = 1e-6;

@compute @workgroup_size(WG_SIZE)
fn obstacle_contacts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let u = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
    let x = Real3(rest[node].xyz) + pair_value(u);
    let distance = sample_distance(vec3<f32>(x) * step.inv_dx);
    let steepness = length(distance.yzw);
    var normal = vec3<f32>();
    if steepness >= SMALLEST_GRADIENT * step.dx {
        normal = distance.yzw / steepness;
    }
    gaps[step.n_nodes + node] = vec4<f32>(normal, distance.x);
    let force = free_part(freedom[node], rhs[node].xyz);
    if distance.x <= SKIN * step.dx && dot(force, Real3(normal)) < Real() {
        freedom[node] = held_along(freedom[node], normal);
    }
}
