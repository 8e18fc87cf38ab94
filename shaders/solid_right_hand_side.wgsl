// right_hand_side, for solids: M v*/dt - (K x* - b) + load on free components, 0 on prescribed ones. One thread per node.
// step, rows. flags: see node_flags. rest: position and mass, kg. velocity: v*, m/s. load: N. incidence: see gather.
// products: K x* - b of the elements, N. rhs: N, out; the fourth number is the squared norm of the magnitudes of what it sums, N^2,
// the scale of its rounding.
#import dispatch
#import gather
#import node_flags
#import real
#import rows
#import solid_step

@group(0) @binding(0) var<uniform> step: SolidStep;
@group(0) @binding(1) var<uniform> rows: Rows;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> rest: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> velocity: array<Real4>;
@group(0) @binding(5) var<storage, read> load: array<Real4>;
@group(0) @binding(6) var<storage, read> incidence: array<u32>;
@group(0) @binding(7) var<storage, read> products: array<Real4>;
@group(0) @binding(8) var<storage, read_write> rhs: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_right_hand_side(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let free = is_free(flags[node]);
    let momentum = (Real(rest[node].w) / Real(step.dt)) * velocity[node].xyz;
    let elastic = Real(step.elastic) * gather(node, rows.n_elements);
    let applied = Real(step.elastic) * load[node].xyz;
    let terms = select(Real3(), abs(momentum) + abs(elastic) + abs(applied), free);
    rhs[node] = Real4(select(Real3(), (momentum - elastic) + applied, free), dot(terms, terms));
}
