// Outer loop, before the first round: the free components of the unknowns start from zero, prescribed ones hold their value, and v*
// becomes the first correction on trial. One thread per node.
// rows. flags: see node_flags. velocity: v*, then the unknowns, m/s, in place. search: direction, then correction, m/s, out.
#import dispatch
#import node_flags
#import real
#import rows

@group(0) @binding(0) var<uniform> rows: Rows;
@group(0) @binding(1) var<storage, read> flags: array<u32>;
@group(0) @binding(2) var<storage, read_write> velocity: array<Real4>;
@group(0) @binding(3) var<storage, read_write> search: array<Real4>;

@compute @workgroup_size(WG_SIZE)
fn solid_guess(@builtin(workgroup_id) workgroup: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let node = linear_index(workgroup, lane);
    if node >= rows.n_nodes {
        return;
    }
    let free = is_free(flags[node]);
    let v = velocity[node].xyz;
    search[rows.n_nodes + node] = Real4(select(Real3(), v, free), Real(0.0));
    velocity[node] = Real4(select(v, Real3(), free), Real(0.0));
}
