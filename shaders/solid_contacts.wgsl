// right_hand_side, for solids, second part: which walls nodes are near, and which hold them from the start: those that they touch and
// that their forces press them to. One thread per node.
// step. rest: m. flags: see node_flags. displacement: larger parts, then smaller, m. rhs: forces, N. gaps: see contact, first
// section, out. freedom: see freedom, out.
#import contact
#import dispatch
#import node_flags
#import pair
#import real
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> displacement: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> rhs: array<Real4>;
@group(0) @binding(5) var<storage, read_write> gaps: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> freedom: array<vec4<f32>>;

@compute @workgroup_size(WG_SIZE)
fn solid_contacts(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= step.n_nodes {
        return;
    }
    let rest_position = rest[node].xyz;
    let u = Pair(displacement[node].xyz, displacement[step.n_nodes + node].xyz);
    let x = Real3(rest_position) + pair_value(u);
    let above = Real3(step.size) - x;
    let is_low = x <= above;
    let gap = select(above, x, is_low);
    let free = is_free(flags[node]);
    let walls = vec4<f32>(vec3<f32>(gap), f32(flags_of(free) + 8u * flags_of(is_low)));
    let touches = gap <= Real3(Real(f32(SKIN) * step.dx));
    let pressed = outwards(walls) * rhs[node].xyz < Real3();
    gaps[node] = walls;
    freedom[node] = vec4<f32>(vec3<f32>(), f32(flags_of(free & !(touches & pressed))));
}
