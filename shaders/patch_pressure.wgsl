// right_hand_side, for solids in liquid, second part: what pressure does beyond its value at the centres of cells, with a constant gradient
// in each: twin reference/patch_pressure.rs. Its forces add to those on free components. With separation again in each round, without
// the cells that separate in it, also if they are let back later. One thread per node.
// coupling, words, node_pairs, flags: see coupling_force. moments: per pair of a node, bits of the rows of the integral of n N_i (x - x_cell)^T,
// m^3, in place: 0 for cells that are inactive; fourth of the first row, which of the slopes. slopes: gradients in the wet cells, Pa/m. node_flags: see node_flags.
// rhs: N, in place; fourth number the squared norm of the magnitudes that it sums. correction: the forces
// that rhs has, N, in place: first 0.
#import coupling
#import dispatch
#import node_flags
#import real

@group(0) @binding(0) var<uniform> coupling: Coupling;
@group(0) @binding(1) var<storage, read> words: array<u32>;
@group(0) @binding(2) var<storage, read> node_pairs: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> flags: array<u32>;
@group(0) @binding(4) var<storage, read_write> moments: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> slopes: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> node_flags: array<u32>;
@group(0) @binding(7) var<storage, read_write> rhs: array<Real4>;
@group(0) @binding(8) var<storage, read_write> correction: array<Real4>;

fn row(at: u32) -> Real3 {
    return Real3(bitcast<vec3<f32>>(moments[at].xyz));
}

@compute @workgroup_size(WG_SIZE)
fn patch_pressure(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= coupling.n_nodes {
        return;
    }
    var sum = Real3();
    let last = words[coupling.node_starts + node + 1u];
    for (var at = words[coupling.node_starts + node]; at < last; at++) {
        let cell = node_pairs[at].w;
        if (flags[cell / 4u] >> (cell % 4u) & 1u) == 1u {
            let slope = Real3(slopes[moments[3u * at].w].xyz);
            sum += Real3(dot(row(3u * at), slope), dot(row(3u * at + 1u), slope), dot(row(3u * at + 2u), slope));
        } else {
            for (var n = 3u * at; n < 3u * at + 3u; n++) {
                moments[n] = vec4<u32>(vec3<u32>(), moments[n].w);
            }
        }
    }
    let change = sum - correction[node].xyz;
    correction[node] = Real4(sum, Real(0.0));
    let free = select(Real3(), change, is_free(node_flags[node]));
    let before = rhs[node];
    let terms = sqrt(before.w) + length(free);
    rhs[node] = Real4(before.xyz + free, terms * terms);
}
